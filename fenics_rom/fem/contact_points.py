"""Where obstacles can touch a mesh: the nodes of contact surfaces, and where one is smaller than a triangle, more."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.fem.nodes import Nodes
from fenics_rom.fem.places import patch_nodes, patch_triangles
from fenics_rom.mechanics.contact_points import MOST_BETWEEN, PointsBetween
from fenics_rom.mechanics.obstacles import smallest_radius
from fenics_rom.mechanics.triangles import covering_radius
from fenics_rom.scene.scene import Scene
from fenics_rom.system.body import Unknowns

GAP_SHARE = 0.9  # of the radius of the smallest obstacle: as far may the surface be from a contact point


def contact_points_of(scene: Scene, nodes: Nodes, unknowns: Unknowns) -> dict[str, Array]:
    """Nodes (P,) of each contact mode that can move, where the scene has contact."""
    if scene.effects.contact is None:
        return {}
    movable = np.zeros(unknowns.components, dtype=bool)
    movable[unknowns.moving] = True
    movable = movable.reshape(-1, 3).any(axis=1)
    patches = {name: patch_nodes(nodes, patch, f"contacts.{name}") for name, patch in scene.contacts.items()}
    return {name: numbers[movable[numbers]] for name, numbers in patches.items()}


def points_between(scene: Scene, nodes: Nodes, unknowns: Unknowns) -> PointsBetween | None:
    """Points between nodes of the contact surfaces, where a scene wants them and an obstacle would pass; or None.

    Each triangle that is too wide is divided into n² alike, and touched at their corners.
    """
    radius = min((smallest_radius(o.shape) for o in scene.environment.obstacles.values()), default=np.inf)
    if radius == np.inf or scene.effects.contact is None or scene.effects.contact.points != "surface":
        return None
    patches = [patch_triangles(nodes, patch, f"contacts.{name}") for name, patch in scene.contacts.items()]
    triangles = np.unique(np.concatenate(patches), axis=0)
    widest = covering_radius(nodes.coordinates[triangles])
    wanted = np.ceil(widest / (GAP_SHARE * radius))
    divisions = np.where(widest / scene.degree > radius, wanted, scene.degree).astype(int)
    facets, weights = [np.empty((0, 3 * scene.degree), dtype=int)], [np.empty((0, 3 * scene.degree))]
    for n in np.unique(divisions[divisions > scene.degree]):
        if n > MOST_BETWEEN:
            return None
        shapes = _shape_functions(_lattice(n), scene.degree)
        shapes = shapes[(shapes < 1.0).all(axis=1)]  # nodes are contact points already
        chosen = nodes.triangle_nodes(triangles[divisions == n])
        facets.append(np.repeat(chosen, len(shapes), axis=0))
        weights.append(np.tile(shapes, (len(chosen), 1)))
    carriers, shares = np.concatenate(facets), np.concatenate(weights)
    places = np.einsum("bc,bcx->bx", shares, nodes.coordinates[carriers])
    size = np.ptp(nodes.coordinates, axis=0).max()
    keys = np.round(places / (1e-9 * size)).astype(np.int64)
    _, once = np.unique(keys, axis=0, return_index=True)  # triangles share their edges
    once = np.sort(once[np.isin(carriers[once], unknowns.moving // 3).any(axis=1)])
    if not 0 < len(once) <= MOST_BETWEEN:
        return None
    return PointsBetween(carriers[once], shares[once], float((widest / divisions).max()))


def _lattice(n: int) -> Array:
    """Barycentric coordinates (any, 3) of the corners of n² triangles that a triangle is divided into."""
    i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
    inside = i + j <= n
    return np.stack([i[inside], j[inside], n - i[inside] - j[inside]], axis=1) / n


def _shape_functions(λ: Array, degree: int) -> Array:
    """Of the nodes of a triangle, in the order of `Nodes.triangle_nodes`, at barycentric coordinates (B, 3)."""
    if degree == 1:
        return λ
    return np.hstack([λ * (2 * λ - 1), 4 * λ * np.roll(λ, -1, axis=1)])
