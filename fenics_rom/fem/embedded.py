"""Points of membranes and cables in the cells of a body: where they are, and what strains there.

They move as the cells do. The strain of a surface in its plane is that of the cell behind it. The strain of a line
along itself is that of the cells that it goes through. So there is nothing to tie, and nothing that locks beside cells.
Weights are areas and lengths, as if membranes were 1 m thick, and cables had a section of 1 m².
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError
from fenics_rom.fem.cell_kinds import tabulate
from fenics_rom.fem.facets import facet_nodes
from fenics_rom.fem.nodes import Nodes, facets_and_cells
from fenics_rom.fem.places import patch_triangles
from fenics_rom.mechanics.fibres import Fibres, structure_of
from fenics_rom.mechanics.voigt import VOIGT_PAIRS
from fenics_rom.scene.fibres import Directions, Helix, Membrane
from fenics_rom.scene.scene import Scene

SAME_PLACE = 1e-9  # of the size of the body, and of shares of a line
MIN_INCLINATION = 1e-3  # sine of the angle between a direction and a surface's normal below which it has no direction


@dataclass(frozen=True)
class EmbeddedPoints:
    """Points of cells.

    Attributes:
        cells: (E,) of the mesh file, ascending.
        places: (E, 3) in the reference cell.
        weights: (E,) area, m², or length, m.
        fibres: what is there, of these points.
        names: of the membrane or cable that each of them is of.
    """

    cells: Array
    places: Array
    weights: Array
    fibres: tuple[Fibres, ...] = ()
    names: tuple[str, ...] = ()

    def of_cells(self, cells: Array) -> "EmbeddedPoints":
        """Those in some of the cells."""
        rows = np.flatnonzero(np.isin(self.cells, cells))
        fibres = tuple(family.at(rows, len(self.cells)) for family in self.fibres)
        return EmbeddedPoints(self.cells[rows], self.places[rows], self.weights[rows], fibres, self.names)


NOTHING_EMBEDDED = EmbeddedPoints(np.empty(0, dtype=int), np.empty((0, 3)), np.empty(0))


def embedded_points(scene: Scene, nodes: Nodes) -> EmbeddedPoints:
    """Of a scene's membranes and cables.

    Raises:
        MeshError, SceneError: a surface does not exist, threads have no direction in it, or a cable leaves the body.
    """
    if scene.effects.cables and not nodes.is_straight:
        raise SceneError(
            f"{scene.source}: effects.cables.{next(iter(scene.effects.cables))}: cables are computed in straight "
            f"tetrahedra; cells of {nodes.mesh.source} are {'curved' if nodes.is_curved else 'hexahedra'}"
        )
    parts = [_membrane(nodes, each, f"effects.membranes.{name}") for name, each in scene.effects.membranes.items()]
    for name, cable in scene.effects.cables.items():
        parts.append(_cable(nodes, np.array(cable.points), cable.stiffness, f"effects.cables.{name}.points"))
    if not parts:
        return NOTHING_EMBEDDED
    first, fibres, names = 0, list[Fibres](), list[str]()
    all_names = [f"effects.membranes.{name}" for name in scene.effects.membranes]
    all_names += [f"effects.cables.{name}" for name in scene.effects.cables]
    for name, part in zip(all_names, parts, strict=True):
        names += [name] * len(part.fibres)
        fibres += [
            Fibres(each.law, first + each.points, each.structure, each.modulus, each.stiffening) for each in part.fibres
        ]
        first += len(part.cells)
    cells, places, weights = (
        np.concatenate([getattr(part, key) for part in parts]) for key in ("cells", "places", "weights")
    )
    return EmbeddedPoints(cells, places, weights, tuple(fibres), tuple(names))


def _membrane(nodes: Nodes, membrane: Membrane, where: str) -> EmbeddedPoints:
    """Points on each face, exact for products of two gradients where it is flat."""
    row, of_triangles = facets_and_cells(nodes, patch_triangles(nodes, membrane, where))
    facets, triangles = facet_nodes(nodes, nodes.surface[row])
    cells, facet, degree = of_triangles[triangles[:, 0]], nodes.kind.facet, 2 if len(nodes.edges) else 1
    rule = 2 * (degree - 1) if nodes.is_straight else 2 * degree
    φ, gradients, weights = tabulate(facet, degree, rule)
    of_corners, count = tabulate(facet, 1, rule)[0], len(weights)
    is_corner = facets[:, : of_corners.shape[1], None] == nodes.cells[cells][:, None, :]
    corners = np.einsum("fkv,vi->fki", is_corner.astype(float), nodes.kind.corners)
    at = np.einsum("qk,fki->fqi", of_corners, corners).reshape(-1, 3)
    N = np.cross(*np.einsum("qbt,fbi->tfqi", gradients, nodes.coordinates[facets])).reshape(-1, 3)
    places = np.einsum("qb,fbi->fqi", φ, nodes.coordinates[facets]).reshape(-1, 3)
    size = np.linalg.norm(N, axis=1)
    area, normals, cells = np.tile(weights, len(facets)) * size, N / size[:, None], np.repeat(cells, count)
    if membrane.poisson is not None:
        fibres = _sheet(normals, membrane.stiffness, membrane.poisson)
    else:
        along = [_in_plane(each, normals, places, where) for each in directions_at(membrane, places, where)]
        fibres = tuple(_threads("quadratic", structure_of(each), membrane.stiffness) for each in along)
    return EmbeddedPoints(cells, at, area, fibres)


def _sheet(normals: Array, stiffness: float, poisson: float) -> tuple[Fibres, ...]:
    """Plane stress of a sheet: ½ k (tr E)² of its plane, and ½ k' of its two shears squared."""
    aside = np.eye(3)[np.abs(normals).argmin(axis=1)]
    t = np.cross(normals, aside)
    t /= np.linalg.norm(t, axis=1)[:, None]
    s = np.cross(normals, t)
    first, second = structure_of(t), structure_of(s)
    i, j = VOIGT_PAIRS.T
    shear = (t[:, i] * s[:, j] + s[:, i] * t[:, j]).T
    sizes = stiffness / (2 * (1 - poisson)), stiffness / (2 * (1 + poisson)), stiffness / (2 * (1 + poisson))
    structures = first + second, first - second, shear
    return tuple(_threads("sheet", structure, size) for structure, size in zip(structures, sizes, strict=True))


def _threads(law: str, structure: Array, size: float) -> Fibres:
    count = structure.shape[1]
    return Fibres(law, np.arange(count), structure, np.full(count, size), np.zeros(count))


def _in_plane(directions: Array, normals: Array, places: Array, where: str) -> Array:
    """Unit directions (K, 3) in planes of these normals."""
    in_plane = directions - (directions * normals).sum(axis=1)[:, None] * normals
    length = np.linalg.norm(in_plane, axis=1)
    refuse_without_direction(length < MIN_INCLINATION, places, where, "points of the surface", "along its normal")
    unit: Array = in_plane / length[:, None]
    return unit


def directions_at(given: Directions, places: Array, where: str) -> list[Array]:
    """Unit directions (K, 3) of each family at places (K, 3), by vectors or about an axis."""
    if given.helix is not None:
        return _wound(given.helix, places, where)
    vectors = [np.array(each) / np.linalg.norm(each) for each in given.directions or ()]
    return [np.broadcast_to(vector, places.shape) for vector in vectors]


def _wound(helix: Helix, places: Array, where: str) -> list[Array]:
    axis = np.array(helix.axis) / np.linalg.norm(helix.axis)
    around = np.cross(axis, places - np.array(helix.point))
    radius = np.linalg.norm(around, axis=1)
    is_on_axis = radius <= SAME_PLACE * np.abs(places).max(initial=1.0)
    refuse_without_direction(is_on_axis, places, f"{where}.helix", "places", "on its axis")
    around /= radius[:, None]
    angles = (helix.angle, -helix.angle) if helix.both else (helix.angle,)
    return [np.cos(angle) * around + np.sin(angle) * axis for angle in angles]


def refuse_without_direction(lacks: Array, places: Array, where: str, of: str, why: str) -> None:
    """Raises SceneError where something (K,) at places (K, 3) has no direction."""
    if lacks.any():
        raise SceneError(
            f"{where}: fibres of {np.count_nonzero(lacks)} of {len(lacks)} {of} have no direction ({why}), e.g. at "
            f"{places[lacks.argmax()].round(9).tolist()}"
        )


def _cable(nodes: Nodes, line: Array, stiffness: float, where: str) -> EmbeddedPoints:
    """Points that are exact for products of two gradients, on each part of a line that is in one cell."""
    corners = nodes.coordinates[nodes.cells]
    inner = np.linalg.inv(corners[:, 1:] - corners[:, :1])
    reference, shares = np.polynomial.legendre.leggauss(2 if len(nodes.edges) else 1)
    cells, places, weights, along = [], [], [], []
    for piece, (start, end) in enumerate(pairwise(line)):
        λ = np.stack([_barycentric(corners, inner, place) for place in (start, end)])
        for cell, first, last in _parts(λ, start, end, f"{where}[{piece}]"):
            t = (first + last + (last - first) * reference) / 2
            cells.append(np.full(len(t), cell))
            places.append((1 - t)[:, None] * λ[0, cell, 1:] + t[:, None] * λ[1, cell, 1:])
            weights.append((last - first) / 2 * np.linalg.norm(end - start) * shares)
            along.append(np.broadcast_to((end - start) / np.linalg.norm(end - start), (len(t), 3)))
    fibres = (_threads("quadratic", structure_of(np.concatenate(along)), stiffness),)
    return EmbeddedPoints(np.concatenate(cells), np.concatenate(places), np.concatenate(weights), fibres)


def _barycentric(corners: Array, inner: Array, place: Array) -> Array:
    """Of a place in all cells, (C, 4)."""
    λ = np.einsum("ck,ckj->cj", place - corners[:, 0], inner)
    return np.column_stack([1 - λ.sum(axis=1), λ])


def _parts(λ: Array, start: Array, end: Array, where: str) -> list[tuple[int, float, float]]:
    """Cells that a straight line goes through, with the shares of it where it enters and leaves each.

    A line along faces or edges of cells is in one of those around. `λ` (2, C, 4) are those of its ends.

    Raises:
        SceneError: it leaves the body.
    """
    rate = λ[1] - λ[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = (-SAME_PLACE - λ[0]) / rate
    enters = np.where(rate > 0, crossing, np.where((rate == 0) & (λ[0] < -SAME_PLACE), np.inf, 0.0)).max(axis=1)
    leaves = np.where(rate < 0, crossing, 1.0).min(axis=1)
    enters, leaves = np.clip(enters, 0.0, None), np.clip(leaves, None, 1.0)
    met = np.flatnonzero(leaves - enters > 4 * SAME_PLACE)
    ends = np.unique(np.concatenate([[0.0, 1.0], enters[met], leaves[met]]))
    ends = np.concatenate([ends[:1], ends[1:][np.diff(ends) > 4 * SAME_PLACE]])
    ends[-1] = 1.0
    parts = []
    for first, last in pairwise(ends.tolist()):
        middle = (first + last) / 2
        there = met[(enters[met] <= middle) & (leaves[met] >= middle)]
        if not len(there):
            places = [(start + t * (end - start)).round(9).tolist() for t in (first, last)]
            raise SceneError(f"{where}: the line leaves the body from {places[0]} to {places[1]}")
        parts.append((int(there[0]), first, last))
    return parts
