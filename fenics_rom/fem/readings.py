"""What a scene reads by name beside displacements, at full order: where, and by which operators.

All of it follows from the mesh, so every rank has the whole.
"""

import numpy as np
import scipy.sparse
from numpy import ndarray as Array
from scipy.sparse.csgraph import connected_components

from fenics_rom.errors import SceneError
from fenics_rom.fem.fibres import fibres_at
from fenics_rom.fem.full_order_body import FullOrderBody
from fenics_rom.fem.mesh_quality import CELL_EDGES, signed_volumes, volume_within
from fenics_rom.fem.nodes import Nodes, cell_at, facets_and_cells, rim_edges, shape_gradients, triangle_areas
from fenics_rom.fem.outputs import marker_reading
from fenics_rom.fem.places import patch_triangles
from fenics_rom.fem.taxels import touch_reading
from fenics_rom.mechanics.readable_body import ReadableBody
from fenics_rom.mechanics.readings import (
    ContactPressure,
    Reading,
    StressReading,
    StrokeReading,
    SurfaceReading,
    swept_volume,
)
from fenics_rom.mechanics.rubbing import rubbing_of
from fenics_rom.mechanics.tendon import cable_length
from fenics_rom.scene.outputs import OutputEntry
from fenics_rom.scene.scene import ReadingEntry, Scene
from fenics_rom.system.body import Unknowns
from fenics_rom.system.system import System

ROUND_OFF = 1e-9  # of sizes and directions
WHOLE = np.full((1, 3), 1 / 3)
# Middles of the four parts that a triangle with six nodes is drawn in, in the order of `Nodes.drawn_triangles`.
PARTS = np.vstack([np.full((3, 3), 1 / 6) + np.eye(3) / 2, WHOLE])


def readings_of(scene: Scene, nodes: Nodes, material: Array, unknowns: Unknowns) -> dict[str, Reading]:
    """The readings of a scene, with operators on the unknowns.

    Args:
        scene: what is read.
        nodes: of its mesh.
        material: λ, μ (Pa) and ρ of every cell, (C, 3).
        unknowns: what supports leave.

    Raises:
        MeshError, SceneError: a place that does not exist, or a surface that encloses no volume.
    """
    return {name: _reading(entry, scene, nodes, material, unknowns, name) for name, entry in scene.readings.items()}


def _reading(
    entry: "ReadingEntry | OutputEntry", scene: Scene, nodes: Nodes, material: Array, unknowns: Unknowns, name: str
) -> Reading:
    if isinstance(entry, OutputEntry):
        return touch_reading(entry, scene, nodes, unknowns, f"outputs.{name}")
    of, where = entry.of or "", f"readings.{name}"
    if entry.quantity == "length":
        return StrokeReading("length", of, cable_length(np.array(scene.effects.tendon[of].points)))
    if entry.quantity == "volume":
        triangles = patch_triangles(nodes, scene.effects.pressure[of], f"effects.pressure.{of}")
        return StrokeReading("volume", of, enclosed_volume(nodes, triangles, unknowns, where))
    if entry.quantity == "contact_pressure":
        triangles = patch_triangles(nodes, scene.contacts[of], f"contacts.{of}")
        touched, facets = np.unique(nodes.triangle_nodes(triangles), return_inverse=True)
        return ContactPressure(of, touched, facets.reshape(len(triangles), -1), triangle_areas(nodes, triangles))
    if entry.point is not None:
        return marker_reading(nodes, np.array(entry.point), unknowns, f"{where}.point")
    if entry.points is not None:
        return _point_stresses(nodes, np.array(entry.points), material, scene, unknowns, f"{where}.points")
    place = entry.place
    facets = nodes.surface if place is None else patch_triangles(nodes, place, where)
    samples, operator, cells = surface_gradients(nodes, facets)
    λ, μ, _ = material[cells].T
    fibres = fibres_at(scene, nodes.mesh, cells, nodes.coordinates[nodes.drawn_triangles()[samples]].mean(axis=1))
    return SurfaceReading(entry.quantity, of, samples, (operator @ unknowns.matrix).tocsr(), λ, μ, fibres)


def surface_gradients(nodes: Nodes, facets: Array) -> tuple[Array, scipy.sparse.csr_matrix, Array]:
    """∇u in the middle of surface triangles as they are drawn, in the cell that adjoins each.

    Args:
        nodes: all nodes.
        facets: (F, 3) of `nodes.surface`.

    Returns:
        Which of the drawn triangles, (P,); the operator from displacements of all nodes (3 N,) to H (3, 3, P), as
        (9 P, 3 N), 1/m; and the cells (P,).
    """
    row, cell = facets_and_cells(nodes, facets)
    parts = PARTS if len(nodes.edges) else WHOLE
    vertices, facet_vertices = nodes.cells[cell], nodes.surface[row]
    corner = facet_vertices[:, :, None] == vertices[:, None, :]
    λ = np.einsum("pk,fkv->pfv", parts, corner).reshape(-1, 4)
    triangles = (np.arange(len(parts))[:, None] * len(nodes.surface) + row).ravel()
    cell = np.tile(cell, len(parts))
    return triangles, _gradient_operator(nodes, cell, λ), cell


def _gradient_operator(nodes: Nodes, cells: Array, λ: Array) -> scipy.sparse.csr_matrix:
    """From displacements of all nodes (3 N,) to H (3, 3, P), 1/m, at barycentric coordinates λ (P, 4) of cells (P,)."""
    gradients = shape_gradients(nodes, cells, λ)
    P, A = gradients.shape[:2]
    corners = nodes.cells[cells]
    cell_nodes = np.hstack([corners, nodes.on_edges(corners[:, CELL_EDGES])]) if len(nodes.edges) else corners
    i, j, p, a = np.meshgrid(range(3), range(3), range(P), range(A), indexing="ij")
    rows, columns = (3 * i + j) * P + p, 3 * cell_nodes[p, a] + i
    entries = gradients[p, a, j].ravel(), (rows.ravel(), columns.ravel())
    return scipy.sparse.coo_matrix(entries, shape=(9 * P, 3 * len(nodes.coordinates))).tocsr()


def _point_stresses(
    nodes: Nodes, points: Array, material: Array, scene: Scene, unknowns: Unknowns, where: str
) -> StressReading:
    """Stress at points (G, 3), from the cells around the corners of theirs.

    With selective integration a cell has its change of volume, and so λ, in its middle alone.

    Raises:
        SceneError: a point is outside the body.
    """
    volumes = signed_volumes(nodes.coordinates, nodes.cells)
    corners, cells, at, shares = [], [], [], []
    for k, point in enumerate(points):
        home, λ = cell_at(nodes, point, where)
        λ = np.where(λ > ROUND_OFF, λ, 0.0)
        for vertex, weight in zip(nodes.cells[home][λ > 0], (λ / λ.sum())[λ > 0], strict=True):
            is_there = nodes.cells == vertex
            around = np.flatnonzero(is_there.any(axis=1) & (material[:, :2] == material[home, :2]).all(axis=1))
            corners.append((k, weight))
            cells.append(around)
            at.append(is_there[around].astype(float))
            shares.append(volumes[around] / volumes[around].sum())
    of_point, weights = zip(*corners, strict=True)
    cell, places = np.concatenate(cells), np.concatenate(at)
    λ, μ, _ = material[cell].T
    corners_of = nodes.coordinates[nodes.cells[cell]]
    fibres = fibres_at(scene, nodes.mesh, cell, np.einsum("pv,pvi->pi", places, corners_of))
    if scene.integration == "selective":
        none = np.zeros(len(cell))
        cell, places = np.tile(cell, 2), np.concatenate([places, np.full((len(cell), 4), 1 / 4)])
        λ, μ = np.concatenate([none, λ]), np.concatenate([μ, none])
    operator = (_gradient_operator(nodes, cell, places) @ unknowns.matrix).tocsr()
    of_corner = np.repeat(np.arange(len(cells)), [len(around) for around in cells])
    return StressReading(
        points, np.array(of_point), np.array(weights), of_corner, np.concatenate(shares), operator, λ, μ, fibres
    )


def enclosed_volume(nodes: Nodes, triangles: Array, unknowns: Unknowns, where: str) -> float:
    """Volume that a surface encloses, m³; openings are closed from their middles.

    The rim of an opening must be held, or move in its plane: then what closes it sweeps no volume, and a pressure does
    the work of the enclosed volume.

    Args:
        nodes: all nodes.
        triangles: (F, 3) outward of the body, so inward of the chamber.
        unknowns: what supports leave.
        where: name of the reading in messages.

    Raises:
        SceneError: the surface has an opening that moves otherwise, or encloses the body instead of a chamber.
    """
    count = len(nodes.coordinates)
    middle = nodes.coordinates[triangles].mean(axis=(0, 1))
    closed = [nodes.coordinates[triangles] - middle]
    rim = rim_edges(triangles)
    graph = scipy.sparse.coo_array((np.ones(len(rim)), rim.T), shape=(count, count))
    _, opening = connected_components(graph, directed=False)
    for one in np.unique(opening[rim[:, 0]]):
        around = rim[opening[rim[:, 0]] == one]
        ends = nodes.coordinates[around] - middle
        tip = ends.mean(axis=(0, 1))
        cap = np.stack([ends[:, 1], ends[:, 0], np.broadcast_to(tip, ends[:, 0].shape)], axis=1)
        if _can_sweep(nodes, around, cap, unknowns):
            raise SceneError(f"{where}: the surface has an opening whose rim moves, so that it encloses no volume")
        closed.append(cap)
    volume = -volume_within(np.concatenate(closed))
    if volume <= 0:
        raise SceneError(f"{where}: the surface is around the body, not around a chamber in it")
    return volume


def _can_sweep(nodes: Nodes, rim: Array, cap: Array, unknowns: Unknowns) -> bool:
    """Whether triangles (r, 3, 3) that close an opening with the rim (r, 2) can sweep a volume."""
    on_rim = np.unique(np.concatenate([rim.ravel(), nodes.on_edges(rim)])) if len(nodes.edges) else np.unique(rim)
    motions = [unknowns.matrix[3 * on_rim + axis] for axis in range(3)]
    if not any(along.count_nonzero() for along in motions):
        return False
    normal = np.cross(cap[:, 1] - cap[:, 0], cap[:, 2] - cap[:, 0]).sum(axis=0)
    normal /= np.linalg.norm(normal)
    heights = (cap - cap[0, 2]) @ normal
    is_flat = np.abs(heights).max() <= ROUND_OFF * np.abs(cap).max()
    across = sum(component * along for component, along in zip(normal, motions, strict=True))
    return not is_flat or bool(np.abs(across.data).max(initial=0.0) > ROUND_OFF)


def readable(system: System, body: FullOrderBody, touched: Array) -> ReadableBody:
    """A body at full order, as readings ask for it, by its unknowns (n,); every rank must make every call.

    `touched`: velocities (P, 3) of the contact points in the middle of the last step, m/s.
    """
    deformation, algebra, interface = system.deformation, system.algebra, body.interface

    def coordinates() -> Array:
        return algebra.gather(body.x)[:, 0]

    def stroke(actuator: str) -> float:
        if deformation is None:
            return float(algebra.inner(system.unit_forces(actuator), body.x)[0, 0])
        if actuator in deformation.tendons:
            points, shapes = deformation.tendons[actuator]
            return cable_length(points) - cable_length(points + algebra.inner(shapes, body.x).reshape(-1, 3))
        return swept_volume(
            lambda x: algebra.gather(deformation.follower(x[algebra.rows()])[actuator])[:, 0], coordinates()
        )

    law, contact = None if deformation is None else deformation.law, body.contact
    if interface is None or contact is None:
        return ReadableBody(law, coordinates, stroke, None if interface is None else interface.points)
    return ReadableBody(
        law,
        coordinates,
        stroke,
        interface.points,
        contact.normal_forces,
        contact.forces,
        lambda: rubbing_of(contact, touched, interface.solver.law.friction),
        lambda: system.body.nodes + body.displacement(),
    )
