"""What the surfaces of chambers enclose, and where they leak."""

from contextlib import suppress

import numpy as np
import scipy.sparse
from numpy import ndarray as Array
from scipy.sparse.csgraph import connected_components

from fenics_rom.errors import SceneError
from fenics_rom.fem.facets import volume_within_surface
from fenics_rom.fem.nodes import Nodes, rim_edges
from fenics_rom.fem.places import patch_triangles
from fenics_rom.scene.scene import Scene
from fenics_rom.system.body import Unknowns

ROUND_OFF = 1e-9  # of the size of an opening, or of a normal


def chambers_of(scene: Scene, nodes: Nodes, unknowns: Unknowns) -> dict[str, float]:
    """Volumes at rest behind those pressures of a scene whose surface encloses one, m³, by name.

    Raises:
        MeshError, SceneError: a place that does not exist, or a chamber that is to hold gas and is not closed.
    """
    volumes, gases = dict[str, float](), scene.environment.gases
    for name, pressure in scene.effects.pressure.items():
        where = f"effects.pressure.{name}"
        triangles = patch_triangles(nodes, pressure, where)
        if name in gases and not gases[name].volume:
            volumes[name] = enclosed_volume(nodes, triangles, unknowns, where)
        else:
            with suppress(SceneError):
                volumes[name] = enclosed_volume(nodes, triangles, unknowns, where)
    return volumes


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
    volume = -volume_within_surface(nodes, triangles, middle)
    rim = rim_edges(triangles)
    graph = scipy.sparse.coo_array((np.ones(len(rim)), rim.T), shape=(count, count))
    _, opening = connected_components(graph, directed=False)
    for one in np.unique(opening[rim[:, 0]]):
        around = rim[opening[rim[:, 0]] == one]
        sides = around
        if nodes.is_curved:
            between = nodes.on_edges(around)
            sides = np.concatenate([np.stack([around[:, 0], between], 1), np.stack([between, around[:, 1]], 1)])
        ends = nodes.coordinates[sides] - middle
        tip = ends.mean(axis=(0, 1))
        cap = np.stack([ends[:, 1], ends[:, 0], np.broadcast_to(tip, ends[:, 0].shape)], axis=1)
        if _can_sweep(nodes, around, cap, unknowns):
            place, across = np.round(middle + tip, 6).tolist(), np.linalg.norm(ends - tip, axis=-1).max() * 2
            raise SceneError(
                f"{where}: the surface has an opening whose rim moves, so that it encloses no volume: {len(around)} "
                f"open edges around {place}, about {across:.3g} m across; use closed surfaces, and openings "
                "whose rim is held, or moves in its plane"
            )
        volume -= float(np.linalg.det(cap).sum()) / 6
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
