"""What supports leave of the displacement components: clamped pieces, rollers, planes of symmetry, rigid surfaces.

A support holds a node along some normals, n·x = 0. One that is driven by u along the unit vector d moves it there,
n·x = (n·d) u. Each node is solved for as many components as it has normals, x_f = W x + V u. As many of these as there
are driven supports stay unknowns in place of u = V⁻¹ (x_f - W x), and the others follow them. So a driven support moves
its nodes together; what moves it is a force on them like any other, and u is its stroke.
"""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import scipy.linalg
import scipy.sparse
from numpy import ndarray as Array

from fenics_rom.errors import SceneError
from fenics_rom.fem.nodes import Nodes, area_vectors
from fenics_rom.fem.places import held_nodes, patch_triangles
from fenics_rom.fem.rigid_surfaces import affine_ties, leaders, rigid_nodes, rigid_ties
from fenics_rom.scene.effects import DrivenSupport
from fenics_rom.scene.scene import Scene
from fenics_rom.system.body import Unknowns
from fenics_rom.system.rigid_modes import rigid_fields

SMOOTH = 0.8  # cosine of the angle between two triangles, 37°, up to which a surface bends smoothly
FLAT = 1e-3  # of its size: as near to a plane as that a place is flat
DEPENDENT = 1e-9  # length that is left of a normal of 1 beside others, below which it says what they say

Ties = list[tuple[int, int, float]]  # components that follow, what they follow, and its weight


class Condition(NamedTuple):
    """What a support says of a node: n·x = c·u of driven supports u (K,)."""

    normal: Array  # n (3,), of length 1
    driven: Array  # c (K,)


def unknowns_of(scene: Scene, nodes: Nodes) -> Unknowns:
    """The displacement components that supports leave free.

    Raises:
        MeshError, SceneError: a place that does not exist, or nothing can move.
    """
    count = len(nodes.coordinates)
    clamped = np.zeros(count, dtype=bool)
    for k, place in enumerate(scene.clamped):
        clamped[held_nodes(nodes, place, f"{scene.source}: supports.clamped[{k}]")] = True
    rest, conditions = np.zeros(len(scene.effects.driven_support)), defaultdict[int, list[Condition]](list)
    for k, held in enumerate(scene.held):
        where = f"{scene.source}: supports.held[{k}]"
        if held.sliding:
            for node, normal in node_normals(nodes, patch_triangles(nodes, held, where)):
                conditions[node].append(Condition(normal, rest))
        elif held.normal is None:
            clamped[held_nodes(nodes, held, where)] = True
        else:
            for node in held_nodes(nodes, held, where).tolist():
                conditions[node].append(Condition(_unit(held.normal), rest))
    if clamped.all():
        raise SceneError(f"{scene.source}: supports: every node of the mesh is clamped")
    is_free = np.repeat(~clamped[:, None], 3, axis=1)
    _add_driven(conditions, scene, nodes, clamped)
    ties, moved = Ties(), dict[int, Array]()
    for node, of_node in sorted(conditions.items()):
        if clamped[node]:
            continue
        normals, driven = map(np.array, zip(*of_node, strict=True))
        fixed, weights, shares, left = eliminate(normals, driven)
        if (left > DEPENDENT).any():
            name = list(scene.effects.driven_support)[int(left.argmax())]
            raise _refused(scene, name, nodes, node, "is held by another support along where it would move")
        is_free[node, fixed] = False
        ties += [(3 * node + i, 3 * node + j, w) for i, row in zip(fixed, weights, strict=True) for j, w in row.items()]
        moved |= {3 * node + i: row for i, row in zip(fixed, shares, strict=True) if row.any()}
    ties = _led(ties, moved, is_free.reshape(-1))
    is_large = scene.effects.large_deformation is not None
    for where, numbers in rigid_nodes(scene, nodes).items():
        if not is_free[numbers].all() or np.isin(3 * numbers, [leader - leader % 3 for _, leader, _ in ties]).any():
            raise SceneError(f"{where} has nodes that are held, or on another rigid surface: use free ones")
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


def supported_nodes(scene: Scene, nodes: Nodes) -> Array:
    """The nodes that supports hold, drive, or hold along a normal, ascending; errors as of `unknowns_of`."""
    parts = [np.empty(0, dtype=int)]
    parts += [
        held_nodes(nodes, place, f"{scene.source}: supports.clamped[{k}]") for k, place in enumerate(scene.clamped)
    ]
    for k, held in enumerate(scene.held):
        where = f"{scene.source}: supports.held[{k}]"
        if held.sliding:
            parts.append(nodes.triangle_nodes(patch_triangles(nodes, held, where)).ravel())
        else:
            parts.append(held_nodes(nodes, held, where))
    for name, support in scene.effects.driven_support.items():
        parts.append(held_nodes(nodes, support, f"effects.driven_support.{name}"))
    return np.unique(np.concatenate(parts))


def support_column(nodes: Nodes, support: DrivenSupport, where: str) -> Array:
    """Forces (3 N, 1) of 1 N of a driven support on its nodes: their stroke is how far it moves."""
    numbers, push = held_nodes(nodes, support, where), np.zeros_like(nodes.coordinates)
    push[numbers] = _unit(support.direction) / len(numbers)
    return push.reshape(-1, 1)


def node_normals(nodes: Nodes, triangles: Array) -> Iterator[tuple[int, Array]]:
    """Nodes of triangles (F, 3) with normals: the mean one by angle; several where they lie on a sharp edge."""
    units, of_each = area_vectors(nodes, triangles), nodes.triangle_nodes(triangles)
    units /= np.linalg.norm(units, axis=1)[:, None]
    corners, angles = nodes.coordinates[triangles], np.full(of_each.shape, np.pi)  # of nodes in the middle of a side
    for k in range(3):
        one, other = (corners[:, (k + step) % 3] - corners[:, k] for step in (1, 2))
        angles[:, k] = np.arctan2(np.linalg.norm(np.cross(one, other), axis=1), np.einsum("fi,fi->f", one, other))
    order = np.argsort(of_each, axis=None, kind="stable")
    numbers, first = np.unique(of_each.ravel()[order], return_index=True)
    for node, around in zip(numbers.tolist(), np.split(order, first[1:]), strict=True):
        beside, weights = units[around // of_each.shape[1]], angles.ravel()[around]
        while len(beside):
            smooth = beside @ beside[0] >= SMOOTH
            yield node, _unit(weights[smooth] @ beside[smooth])
            beside, weights = beside[~smooth], weights[~smooth]


def borne_by_base(nodes: Nodes, unknowns: Unknowns, forces: Array) -> Array:
    """Forces (3 N, 1) on nodes that a base holds, in balance at rest with forces (3 N, 1) on the others."""
    count = len(nodes.coordinates)
    held, borne = np.setdiff1d(np.arange(count), unknowns.moving // 3), np.zeros_like(nodes.coordinates)
    motions = rigid_fields(nodes.coordinates, np.ones(count))
    of_held = motions.reshape(count, 3, -1)[held].reshape(3 * len(held), -1)
    borne[held] = np.linalg.lstsq(of_held.T, -motions.T @ forces[:, 0], rcond=None)[0].reshape(-1, 3)
    return borne.reshape(-1, 1)


def _unit(direction: Sequence[float] | Array) -> Array:
    unit: Array = np.array(direction) / np.linalg.norm(direction)
    return unit


def check_drives(scene: Scene, nodes: Nodes) -> None:
    """Refuses (SceneError) a run that moves a driven support in one step by more than the body's size."""
    run, supports = scene.run, scene.effects.driven_support
    size = float(np.linalg.norm(np.ptp(nodes.coordinates, axis=0)))
    for k, load in enumerate(() if run is None else run.loads):
        support = supports.get(load.actuator or "")
        if run is None or support is None or support.control != "displacement":
            continue
        times = load.signal.times
        jump, at = float(np.abs(load.signal(load.start)).max()), load.start
        if times is not None:
            steps = np.abs(np.diff(load.signal.values, axis=0))[:, 0] * np.minimum(1.0, run.dt / np.diff(times))
            within = (times[1:] > load.start) & (times[:-1] < load.stop)
            steps = np.where(within, steps, 0.0)
            if steps.max() > jump:
                jump, at = float(steps.max()), float(times[steps.argmax()])
        if jump > size:
            raise SceneError(
                f"{scene.source}: run.load[{k}]: driven support {load.actuator!r} moves by {jump:.3g} m within a step, "
                f"at {at:g} s, more than the size of the body, {size:.3g} m; displacements are in m"
            )


def _add_driven(conditions: dict[int, list[Condition]], scene: Scene, nodes: Nodes, clamped: Array) -> None:
    """Adds those of driven supports, none of whose nodes may be clamped."""
    supports = scene.effects.driven_support
    for k, (name, support) in enumerate(supports.items()):
        numbers, direction = held_nodes(nodes, support, f"effects.driven_support.{name}"), _unit(support.direction)
        normals = [direction] if support.sliding else np.eye(3)
        if support.sliding:
            _check_flat(scene, name, nodes.coordinates[numbers])
        of_each = [Condition(normal, (normal @ direction) * np.eye(len(supports))[k]) for normal in normals]
        for node in numbers.tolist():
            if clamped[node]:
                raise _refused(scene, name, nodes, node, "is clamped by supports")
            conditions[node] += of_each


def _check_flat(scene: Scene, name: str, places: Array) -> None:
    """Refuses (SceneError) a plate whose nodes, at places (n, 3), are not in a plane."""
    arms = places - places.mean(axis=0)
    off = float(np.abs(arms @ np.linalg.eigh(arms.T @ arms)[1][:, 0]).max())
    if off > FLAT * np.abs(arms).max():
        raise SceneError(
            f"{scene.source}: effects.driven_support.{name}: sliding = true is of a plate, and its nodes are up to "
            f"{off:.3g} m off a plane; use a flat place, sliding = false, or an obstacle that moves"
        )


def _refused(scene: Scene, name: str, nodes: Nodes, node: int, why: str) -> SceneError:
    return SceneError(
        f"{scene.source}: effects.driven_support.{name}: node at {nodes.coordinates[node].round(9).tolist()} {why}; "
        "use a place without it, or with sliding = true supports that hold across the direction"
    )


def _led(ties: Ties, moved: dict[int, Array], is_free: Array) -> Ties:
    """Ties with components x_f = W x + V u of driven supports in terms of those that lead, which become free.

    Args:
        ties: W, as far as it is not 0.
        moved: V, rows (K,) by component f.
        is_free: (3 N,), to which those that lead are added.
    """
    if not moved:
        return ties
    own = defaultdict[int, list[tuple[int, float]]](list)
    for follower, leader, weight in ties:
        own[follower].append((leader, weight))
    components, V = np.array(list(moved)), np.array(list(moved.values()))
    chosen = scipy.linalg.qr(V.T, mode="r", pivoting=True)[1][: V.shape[1]]
    shares, leading = np.linalg.solve(V[chosen].T, V.T).T, components[chosen].tolist()
    is_free[leading] = True
    led = [tie for tie in ties if tie[0] not in leading]
    for follower, row in zip(components.tolist(), shares, strict=True):
        for leader, share in zip(leading, row, strict=True):
            if follower not in leading and share:
                led.append((follower, leader, float(share)))
                led += [(follower, beside, -float(share) * weight) for beside, weight in own[leader]]
    return led


def of_whole_nodes(unknowns: Unknowns) -> Unknowns:
    """These, where all that they are and all that follows is of whole nodes; else all of the nodes that can move."""
    if unknowns.node_shares is not None:
        return unknowns
    components = 3 * np.unique(unknowns.moving // 3)[:, None] + np.arange(3)
    return Unknowns(unknowns.components, components.ravel())


def eliminate(normals: Array, driven: Array) -> tuple[list[int], list[dict[int, float]], Array, Array]:
    """Solves N x = C u for as many components of x (3,) as N (any, 3) has independent rows of length 1.

    Gauss-Jordan elimination with complete pivoting, so that no weight is above 1 where one normal is given.

    Returns:
        The components that are solved for, for each the weights of those that remain, without zeros, and of u (K,);
        and what rows of N that depend on others ask of u (K,), at most: 0 where they say the same.
    """
    N, C, pivots = np.array(normals, dtype=float), np.array(driven, dtype=float), []
    for row in range(min(len(N), 3)):
        k, j = np.unravel_index(np.abs(N[row:]).argmax(), N[row:].shape)
        if abs(N[row + k, j]) <= DEPENDENT:
            break
        for part in (N, C):
            part[[row, row + k]] = part[[row + k, row]]
        pivot, others = N[row, j], np.arange(len(N)) != row
        N[row], C[row] = N[row] / pivot, C[row] / pivot
        C[others] -= np.outer(N[others, j], C[row])
        N[others] -= np.outer(N[others, j], N[row])
        N[others, j] = 0.0
        pivots.append(int(j))
    rest = [j for j in range(3) if j not in pivots]
    weights = [{j: -N[row, j] for j in rest if N[row, j] != 0.0} for row in range(len(pivots))]
    return pivots, weights, C[: len(pivots)], np.abs(C[len(pivots) :]).max(axis=0, initial=0.0)
