"""Taxels: a grid that is mapped onto a piece of the surface, and which share of each node's force is in which of them.

A surface whose normals all look to the side of their mean is seen along this mean: u along its longer principal axis,
v at right angles. Others, as a sleeve or the whole of a finger, are unrolled: u along the principal axis whose two
others are most alike, v the angle about it. The grid spans the surface in u and v. Each facet is divided into many
parts alike, which are counted by the taxels that their middles are in.

On facets of three nodes a node's force is spread as its shape function is. On those of six the middle of a side has
the third of the facet that is nearest to the side, as a uniform pressure leaves nothing to the corners; what these
have is spread as if there were three nodes.
"""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError
from fenics_rom.fem.contact_points import contact_points_of, points_between
from fenics_rom.fem.nodes import Nodes, face_keys, triangle_areas
from fenics_rom.fem.places import patch_triangles
from fenics_rom.mechanics.readings import Reading
from fenics_rom.mechanics.sensor import Sensor
from fenics_rom.mechanics.touch import TaxelMap, TouchReading
from fenics_rom.scene.outputs import OutputEntry
from fenics_rom.scene.scene import Scene
from fenics_rom.system.body import Unknowns

FINENESS = 4  # parts of a facet's edge in that of a taxel
FEWEST, MOST = 6, 32  # parts of a facet's edge
FLATTEST = 0.2  # cosine of what a normal may be off the mean one on a surface that is seen along this
ALIKE = 0.8  # ratio of second moments from which on no axis is the longer one
STEEP = 1e-3  # share of a direction that lies in the surface, at least
ROUND_OFF = 1e-6  # of components of a unit vector, and of barycentric coordinates
WHOLE_TURN = 0.3  # rad that a surface may leave open about its axis, and is all around it


class _Samples(NamedTuple):
    """Middles of the parts that facets are divided into."""

    facets: Array  # (q,)
    weights: Array  # (q, 3) barycentric
    areas: Array  # (q,) m²


def touch_reading(entry: OutputEntry, scene: Scene, nodes: Nodes, unknowns: Unknowns, where: str) -> TouchReading:
    """A sense of touch of a scene.

    Raises:
        MeshError, SceneError: its surface does not exist, or has no contact points.
    """
    rows = np.flatnonzero(
        np.isin(face_keys(nodes, nodes.surface), face_keys(nodes, patch_triangles(nodes, entry, where)))
    )
    triangles = nodes.surface[rows]
    own, facets = np.unique(nodes.triangle_nodes(triangles), return_inverse=True)
    facets, areas, places = facets.reshape(len(triangles), -1), triangle_areas(nodes, triangles), nodes.coordinates[own]
    if not _touchable(scene, nodes, unknowns)[own].any():
        raise SceneError(
            f"{where}: its surface has no contact points; use one with nodes of a contact mode that can move: "
            f"of {', '.join(scene.contacts)}"
        )
    grid, corners = np.array([0, 0]), places[facets[:, :3]]
    if entry.taxels is not None:
        grid = np.array([entry.taxels.rows, entry.taxels.columns])
    count = int(grid.prod())
    samples, taxel = _Samples(np.empty(0, int), np.empty((0, 3)), np.empty(0)), np.empty(0, int)
    if entry.taxels is not None:
        taxel, samples = _sampled(corners, areas, grid, entry.taxels.along, f"{where}.taxels")
    seen = _shown(nodes, rows, samples, taxel, max(count, 1))
    at = np.einsum("qc,qcx->qx", samples.weights, corners[samples.facets])
    of_taxels = np.bincount(taxel, samples.areas, minlength=count)
    centres = np.stack([np.bincount(taxel, samples.areas * x, minlength=count) for x in at.T], axis=1)
    centres = np.divide(centres, of_taxels[:, None], out=np.zeros((count, 3)), where=of_taxels[:, None] > 0)
    middle = areas @ corners.mean(axis=1) / areas.sum()
    return TouchReading(
        own,
        facets,
        areas,
        places,
        middle if entry.point is None else np.array(entry.point),
        entry.patches,
        TaxelMap(grid, of_taxels, centres, *seen),
        *_felt(facets, samples, taxel, len(own), max(count, 1)),
        Sensor() if entry.sensor is None else Sensor(**vars(entry.sensor)),
    )


def unreached(readings: Mapping[str, Reading], scene: Scene, nodes: Nodes, unknowns: Unknowns) -> Iterator[str]:
    """What to say of taxels that no contact point can press."""
    for name, reading in readings.items():
        if not isinstance(reading, TouchReading):
            continue
        touchable, there = _touchable(scene, nodes, unknowns)[reading.nodes], reading.map.areas > 0
        reached = np.zeros(len(there), dtype=bool)
        reached[reading.taxels[touchable[reading.felt]]] = True
        if (count := int((~reached & there).sum())) > 0:
            first = reading.map.centres[int(np.flatnonzero(~reached & there)[0])]
            yield (
                f"outputs.{name}: {count} of {int(there.sum())} taxels have no contact points, so that nothing presses "
                f"them, as the one at [{', '.join(f'{x:.4g}' for x in first)}] m; a contact mode there is the cure"
            )


def _touchable(scene: Scene, nodes: Nodes, unknowns: Unknowns) -> Array:
    """Which nodes contact can press, (N,)."""
    touchable = np.zeros(len(nodes.coordinates), dtype=bool)
    for numbers in contact_points_of(scene, nodes, unknowns).values():
        touchable[numbers] = True
    between = points_between(scene, nodes, unknowns)
    if between is not None:
        touchable[between.nodes] = True
    return touchable


def _sampled(
    corners: Array, areas: Array, grid: Array, along: tuple[float, ...] | None, where: str
) -> tuple[Array, _Samples]:
    """The taxel of each sample, (q,), and the samples of facets with these corners (F, 3, 3), m."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normals.sum(axis=0))
    mean = normals.sum(axis=0) / size if size > 0 else np.zeros(3)
    is_seen = bool((normals @ mean > FLATTEST * np.linalg.norm(normals, axis=1)).all())
    middle, moments = _moments(corners, areas)
    frame = _plane(moments, mean, along, where) if is_seen else _unrolled(moments, along)

    def coordinates(places: Array) -> Array:
        inside = (places - middle) @ frame.T
        return inside[..., :2] if is_seen else np.stack([inside[..., 0], np.arctan2(*inside.T[:0:-1]).T], axis=-1)

    at_corners, radius, start = coordinates(corners).reshape(-1, 2), 1.0, 0.0
    low, high = at_corners.min(axis=0), at_corners.max(axis=0)
    if not is_seen:
        start, turn = _open_side(at_corners[:, 1])
        low[1], high[1], radius = 0.0, turn, np.linalg.norm(((corners - middle) @ frame.T)[..., 1:], axis=-1).mean()
    spans = (high - low) / grid[::-1]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    parts = np.clip(np.ceil(FINENESS * edges / min(spans[0], spans[1] * radius)), FEWEST, MOST).astype(int)
    samples = _samples(parts, areas)
    at = coordinates(np.einsum("qc,qcx->qx", samples.weights, corners[samples.facets]))
    if not is_seen:
        at[:, 1] = np.mod(at[:, 1] - start, 2 * np.pi)
    column, row = np.clip(((at - low) / spans).astype(int), 0, grid[::-1] - 1).T
    return row * grid[1] + column, samples


def _moments(corners: Array, areas: Array) -> tuple[Array, Array]:
    """Middle (3,) of a surface, and its second moments about it, (3, 3), m⁴."""
    middle = areas @ corners.mean(axis=1) / areas.sum()
    arms = corners - middle
    sums = arms.sum(axis=1)  # ∫ x xᵀ over a triangle is A/12 (Σ xᵢ xᵢᵀ + s sᵀ), s = Σ xᵢ
    moments = np.einsum("f,fcx,fcy->xy", areas, arms, arms) + np.einsum("f,fx,fy->xy", areas, sums, sums)
    return middle, moments / 12


def _plane(moments: Array, normal: Array, along: tuple[float, ...] | None, where: str) -> Array:
    """Directions of u, v and the normal, (3, 3), of what is seen along it."""
    if along is not None:
        u = np.array(along) - (normal @ along) * normal
        if np.linalg.norm(u) < STEEP * np.linalg.norm(along):
            raise SceneError(f"{where}.along: is normal to the surface; use a direction that lies in it")
        u /= np.linalg.norm(u)
    else:
        first = _across(normal)
        sides = np.stack([first, np.cross(normal, first)])
        (short, long), vectors = np.linalg.eigh(sides @ moments @ sides.T)
        u = first if short > ALIKE * long else _signed(vectors[:, 1] @ sides)
    return np.stack([u, np.cross(normal, u), normal])


def _unrolled(moments: Array, along: tuple[float, ...] | None) -> Array:
    """The axis about which a surface goes, and two directions across it, (3, 3).

    Unless it is given, the principal axis whose two others are most alike.
    """
    values, vectors = np.linalg.eigh(moments)
    axis = vectors[:, 2 if values[2] - values[1] >= values[1] - values[0] else 0]
    axis = _signed(axis) if along is None else np.array(along) / np.linalg.norm(along)
    first = _across(axis)
    return np.stack([axis, first, np.cross(axis, first)])


def _across(normal: Array) -> Array:
    """A unit vector (3,) at right angles to a normal, near the first axis that is nearly so."""
    size = np.abs(normal)
    axis = np.eye(3)[int(np.argmax(size <= size.min() + ROUND_OFF))]
    across: Array = axis - (axis @ normal) * normal
    return across / np.linalg.norm(across)


def _signed(axis: Array) -> Array:
    """An axis (3,) whose largest component is positive."""
    return axis if axis[np.abs(axis).argmax()] > 0 else -axis


def _open_side(angles: Array) -> tuple[float, float]:
    """Where a surface begins about its axis, and how far it goes, rad, from angles of its nodes."""
    angles = np.unique(np.mod(angles, 2 * np.pi))
    gaps = np.diff(angles, append=angles[0] + 2 * np.pi)
    widest = int(gaps.argmax())
    several = np.sort(gaps)[-2] if len(gaps) > 1 else 0.0
    if gaps[widest] < max(WHOLE_TURN, 1.5 * several):
        return 0.0, 2 * np.pi
    return float(angles[(widest + 1) % len(angles)]), float(2 * np.pi - gaps[widest])


def _samples(parts: Array, areas: Array) -> _Samples:
    """Facets whose edges are divided into so many parts, (F,) each."""
    facets, weights = [np.empty(0, dtype=int)], [np.empty((0, 3))]
    for n in np.unique(parts):
        i, j = (index.ravel() for index in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
        up, down = i + j < n, i + j < n - 1
        inner = np.concatenate([np.stack([i, j])[:, up] + 1 / 3, np.stack([i, j])[:, down] + 2 / 3], axis=1) / n
        own, some = np.flatnonzero(parts == n), np.vstack([1 - inner.sum(axis=0), inner]).T
        facets.append(np.repeat(own, len(some)))
        weights.append(np.tile(some, (len(own), 1)))
    of_facets = np.concatenate(facets)
    return _Samples(of_facets, np.concatenate(weights), (areas / parts**2)[of_facets])


def _shown(nodes: Nodes, rows: Array, samples: _Samples, taxel: Array, count: int) -> tuple[Array, Array, Array, Array]:
    """Triangles as they are drawn, (G,), and which of them shows which taxel by which share of its area."""
    if not len(taxel):
        return tuple(np.empty(0, dtype=kind) for kind in (int, int, int, float))  # type: ignore[return-value]
    part = np.zeros(len(taxel), dtype=int)
    if len(nodes.edges):
        part = np.where(samples.weights.max(axis=1) > 0.5, samples.weights.argmax(axis=1), 3)
    triangles, place = np.unique(part * len(nodes.surface) + rows[samples.facets], return_inverse=True)
    seen, taxels, areas = _summed(place, taxel, samples.areas, count)
    return triangles, seen, taxels, areas / np.bincount(seen, areas)[seen]


def _felt(facets: Array, samples: _Samples, taxel: Array, size: int, count: int) -> tuple[Array, Array, Array]:
    """Which node (h,) of `size` shares its force with which taxel by which share."""
    if not len(taxel):
        return np.empty(0, dtype=int), np.empty(0, dtype=int), np.empty(0)
    of, λ = facets[samples.facets], samples.weights
    node, value, where = of[:, :3].ravel(), λ.ravel(), np.repeat(np.arange(len(taxel)), 3)
    if facets.shape[1] == 6:
        nearest = λ <= λ.min(axis=1, keepdims=True) + ROUND_OFF
        thirds = np.roll(nearest / nearest.sum(axis=1, keepdims=True), 1, axis=1)  # sides 01, 12, 20 face 2, 0, 1
        node, value = np.concatenate([node, of[:, 3:].ravel()]), np.concatenate([value, thirds.ravel()])
        where = np.tile(where, 2)
    felt, taxels, parts = _summed(node, taxel[where], value * samples.areas[where], count)
    return felt, taxels, parts / np.bincount(felt, parts, minlength=size)[felt]


def _summed(first: Array, second: Array, values: Array, count: int) -> tuple[Array, Array, Array]:
    """Sums of values over alike pairs of numbers, of which the second is below a count."""
    keys, place = np.unique(first * count + second, return_inverse=True)
    return keys // count, keys % count, np.bincount(place, values)
