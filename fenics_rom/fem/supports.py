"""What supports leave of the displacement components: clamped pieces, rollers, planes of symmetry, rigid surfaces."""

from collections import defaultdict

import numpy as np
import scipy.sparse

from fenics_rom.errors import SceneError
from fenics_rom.fem.nodes import Nodes
from fenics_rom.fem.places import held_nodes
from fenics_rom.fem.rigid_surfaces import affine_ties, leaders, rigid_nodes, rigid_ties
from fenics_rom.scene.scene import Scene
from fenics_rom.system.body import Unknowns

DEPENDENT = 1e-9  # length that is left of a normal of 1 beside others, below which it says what they say


def unknowns_of(scene: Scene, nodes: Nodes) -> Unknowns:
    """The displacement components that supports leave free.

    Raises:
        MeshError, SceneError: a place that does not exist, or nothing can move.
    """
    count = len(nodes.coordinates)
    clamped, normals = np.zeros(count, dtype=bool), defaultdict[int, list[np.ndarray]](list)
    for k, place in enumerate(scene.clamped):
        clamped[held_nodes(nodes, place, f"{scene.source}: supports.clamped[{k}]")] = True
    for k, held in enumerate(scene.held):
        numbers = held_nodes(nodes, held, f"{scene.source}: supports.held[{k}]")
        if held.normal is None:
            clamped[numbers] = True
        else:
            for node in numbers.tolist():
                normals[node].append(np.array(held.normal) / np.linalg.norm(held.normal))
    if clamped.all():
        raise SceneError(f"{scene.source}: supports: every node of the mesh is clamped")
    is_free = np.repeat(~clamped[:, None], 3, axis=1)
    ties = []
    for node, along in sorted(normals.items()):
        if clamped[node]:
            continue
        fixed, weights = eliminate(np.array(along))
        is_free[node, fixed] = False
        ties += [(3 * node + i, 3 * node + j, w) for i, row in zip(fixed, weights, strict=True) for j, w in row.items()]
    is_large = scene.effects.large_deformation is not None
    for where, numbers in rigid_nodes(scene, nodes).items():
        if not is_free[numbers].all():
            raise SceneError(f"{where} has nodes that are held, or on another rigid surface: allowed are free ones")
        places = nodes.coordinates[numbers]
        ties_of = affine_ties(places, leaders(places, where)) if is_large else rigid_ties(places)
        components, leading, shares = ties_of
        components, leading = (3 * numbers[part // 3] + part % 3 for part in (components, leading))
        is_free.ravel()[components] = False
        ties += [
            (i, j, w) for i, row in zip(components, shares, strict=True) for j, w in zip(leading, row, strict=True) if w
        ]
    free = np.flatnonzero(is_free)
    if not ties:
        return Unknowns(3 * count, free)
    follower, leader, weight = (np.array(part) for part in zip(*ties, strict=True))
    tied, row = np.unique(follower, return_inverse=True)
    places = row, np.searchsorted(free, leader)
    return Unknowns(3 * count, free, tied, scipy.sparse.csr_array((weight, places), shape=(len(tied), len(free))))


def of_whole_nodes(unknowns: Unknowns) -> Unknowns:
    """These, where all that they are and all that follows is of whole nodes; else all of the nodes that can move."""
    if unknowns.node_shares is not None:
        return unknowns
    components = 3 * np.unique(unknowns.moving // 3)[:, None] + np.arange(3)
    return Unknowns(unknowns.components, components.ravel())


def eliminate(normals: np.ndarray) -> tuple[list[int], list[dict[int, float]]]:
    """Solves N x = 0 for as many components of x (3,) as N (any, 3) has independent rows of length 1.

    Gauss-Jordan elimination with complete pivoting, so that no weight is above 1 where one normal is given.

    Returns:
        The components that are solved for, and for each the weights of those that remain, without zeros.
    """
    N, pivots = np.array(normals, dtype=float), []
    for row in range(min(len(N), 3)):
        k, j = np.unravel_index(np.abs(N[row:]).argmax(), N[row:].shape)
        if abs(N[row + k, j]) <= DEPENDENT:
            break
        N[[row, row + k]] = N[[row + k, row]]
        N[row] /= N[row, j]
        others = np.arange(len(N)) != row
        N[others] -= np.outer(N[others, j], N[row])
        N[others, j] = 0.0
        pivots.append(int(j))
    rest = [j for j in range(3) if j not in pivots]
    return pivots, [{j: -N[row, j] for j in rest if N[row, j] != 0.0} for row in range(len(pivots))]
