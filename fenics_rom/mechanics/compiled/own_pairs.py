"""Pairs of a body with itself and with obstacles, compiled: how they move by what its points do, and their forces.

Each moves with up to four points (`self_contact`), by maps (3, 3) of their velocities. To the law a pair is a point of
its own, with the operator that follows from that of the points.
"""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit, jit_part
from fenics_rom.mechanics.compiled.contact_law import FOUND, Found, Law, Pairs, ask, find_forces
from fenics_rom.mechanics.compiled.copying import add_row, fill, put
from fenics_rom.mechanics.compiled.newton import in_one_piece
from fenics_rom.mechanics.compiled.obstacle_motion import Beside
from fenics_rom.mechanics.compiled.springs import ask_springs


@jit
def set_corner_maps(points: Array, row: Array, nodes: Array, weights: Array, maps: Array) -> None:
    """Sets what corners add to the velocity of places, (k, 3 corners, 3, 3), as `own_surface.corner_maps` has it.

    Args:
        points: (n, 3), m.
        row, nodes, weights: of k points, corners (k, 3) of what they meet, and weights (k, 3) of these there.
        maps: set.
    """
    arms, J, turns = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for k in range(len(row)):
        x, y, z = points[row[k], 0], points[row[k], 1], points[row[k], 2]
        for c in range(3):
            corner, share = points[nodes[k, c]], weights[k, c]
            x, y, z = x - share * corner[0], y - share * corner[1], z - share * corner[2]
            for j in range(3):
                whole = points[nodes[k, 0], j] + points[nodes[k, 1], j] + points[nodes[k, 2], j]
                arms[c, j] = corner[j] - whole / 3
        _set_inverse_inertia(arms, J)
        for c in range(3):
            u, v, w = arms[c, 0], arms[c, 1], arms[c, 2]
            for i in range(3):
                put(turns[i], J[i, 1] * w - J[i, 2] * v, J[i, 2] * u - J[i, 0] * w, J[i, 0] * v - J[i, 1] * u)
            for j in range(3):
                maps[k, c, 0, j] = z * turns[1, j] - y * turns[2, j]
                maps[k, c, 1, j] = x * turns[2, j] - z * turns[0, j]
                maps[k, c, 2, j] = y * turns[0, j] - x * turns[1, j]
                maps[k, c, j, j] += weights[k, c]


@jit_part
def _set_inverse_inertia(arms: Array, inverse: Array) -> None:
    """Sets J⁻¹ (3, 3) of corners at arms (3, 3) from their middle."""
    xx = yy = zz = xy = xz = yz = 0.0
    for k in range(3):
        x, y, z = arms[k, 0], arms[k, 1], arms[k, 2]
        xx, yy, zz = xx + y * y + z * z, yy + x * x + z * z, zz + x * x + y * y
        xy, xz, yz = xy - x * y, xz - x * z, yz - y * z
    a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    d, e, f = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    whole = 1 / (xx * a + xy * b + xz * c)
    put(inverse[0], whole * a, whole * b, whole * c)
    put(inverse[1], whole * b, whole * d, whole * e)
    put(inverse[2], whole * c, whole * e, whole * f)


@jit
def set_operator(W: Array, nodes: Array, maps: Array, between: Array) -> None:
    """Sets how pairs move by forces of one another, (3C, 3C), m/s/N, as `delassus.operator_between` has it.

    Args:
        W: symmetric operator of all points, (3P, 3P), m/s/N.
        nodes, maps: points (C, m) that pairs move with, and what the velocity of each adds, (C, m, 3, 3).
        between: set.
    """
    C, m, rows = len(nodes), nodes.shape[1], np.empty((3, len(W)))
    for c in range(C):
        fill(rows, 0.0)
        for k in range(m):
            at, by = 3 * nodes[c, k], maps[c, k]
            for i in range(3):
                a, b, d = by[i, 0], by[i, 1], by[i, 2]
                if a != 0.0 or b != 0.0 or d != 0.0:
                    first, second, third, row = W[at], W[at + 1], W[at + 2], rows[i]
                    for j in range(len(row)):
                        row[j] += a * first[j] + b * second[j] + d * third[j]
        for other in range(c + 1):
            for i in range(3):
                for j in range(3):
                    moved = 0.0
                    for k in range(m):
                        at, by = 3 * nodes[other, k], maps[other, k, j]
                        moved += by[0] * rows[i, at] + by[1] * rows[i, at + 1] + by[2] * rows[i, at + 2]
                    between[3 * c + i, 3 * other + j] = between[3 * other + j, 3 * c + i] = moved


@jit
def find_pair_forces(
    law: Law,
    own_law: Law,
    W: Array,
    motion: Array,
    nodes: Array,
    maps: Array,
    obstacles: int,
    gaps: Array,
    beside: Beside,
    before: Array,
    outwards: Array,
    settled: tuple[Array, Array, Array],
    swung: Array,
    pairs: Pairs,
    forces: Array,
) -> Found:
    """Contact forces of pairs that are near; first those with obstacles, then those of the body with itself.

    Args:
        law, own_law: of these.
        W: symmetric operator of all points, (3P, 3P), m/s/N.
        motion: velocities of these in the middle of the step without contact, and at its start, (2, P, 3), m/s.
        nodes, maps: points (C, m) that pairs move with, and what the velocity of each adds, (C, m, 3, 3).
        obstacles: how many pairs are with these.
        gaps: (C,), m.
        beside: how obstacles move, at each of their pairs.
        before: forces of the step before (C, 3), N.
        outwards: as of `ask`.
        settled: of sweeps before, which pairs take part, which friction is not asked to stop, and shares that they are
            asked for, (C,) each; (0,) where nothing is decided.
        swung: as of `find_forces`.
        pairs: with normals, and forces to begin with; set.
        forces: set, on the points (P, 3), N.
    """
    C = len(gaps)
    ask_pairs(law, own_law, motion, nodes, maps, obstacles, gaps, beside, before, outwards, settled, pairs)
    operator = np.empty((3 * C, 3 * C))
    set_operator(W, nodes, maps, operator)
    found = find_forces(law, operator, in_one_piece(np.empty((0, 0))), C, swung, pairs)
    add_up_pairs(found, nodes, maps, pairs, forces)
    return found


@jit_part
def ask_pairs(
    law: Law,
    own_law: Law,
    motion: Array,
    nodes: Array,
    maps: Array,
    obstacles: int,
    gaps: Array,
    beside: Beside,
    before: Array,
    outwards: Array,
    settled: tuple[Array, Array, Array],
    pairs: Pairs,
) -> None:
    """Sets what the law asks of pairs; arguments as of `find_pair_forces`."""
    C, n, still = len(gaps), obstacles, np.zeros((1, 3))
    free, velocity, rests = np.empty((C, 3)), np.empty((C, 3)), Beside(still, still, still[:0])
    _set_moved(nodes, maps, motion[0], free)
    _set_moved(nodes, maps, motion[1], velocity)
    near, own = _some(pairs, 0, n), _some(pairs, n, C)
    ask(law, gaps[:n], free[:n], velocity[:n], beside, before[:n], outwards[:n], near, np.inf)
    ask(own_law, gaps[n:], free[n:], velocity[n:], rests, before[n:], outwards[n:], own, np.inf)
    ask_springs(law, gaps, np.inf, pairs)
    chosen, helped, shares = settled
    for c in range(len(chosen)):
        pairs.chosen[c] = pairs.chosen[c] or chosen[c]
    for c in range(len(helped)):
        pairs.helped[c] = helped[c]
        pairs.target[c, 1], pairs.target[c, 2] = shares[c] * pairs.target[c, 1], shares[c] * pairs.target[c, 2]


@jit_part
def add_up_pairs(found: Found, nodes: Array, maps: Array, pairs: Pairs, forces: Array) -> None:
    """Sets forces on points (P, 3), N, of pairs that are found; arguments as of `find_pair_forces`."""
    fill(forces, 0.0)
    if found.status == FOUND:
        for c in range(len(nodes)):
            if pairs.chosen[c]:
                for k in range(nodes.shape[1]):
                    for i in range(3):
                        add_row(maps[c, k, i], pairs.forces[c, i], forces[nodes[c, k]])


@jit_part
def _set_moved(nodes: Array, maps: Array, velocities: Array, moved: Array) -> None:
    """Sets velocities of pairs (C, 3) by those of points (P, 3)."""
    fill(moved, 0.0)
    for c in range(len(nodes)):
        for k in range(nodes.shape[1]):
            by, of = maps[c, k], velocities[nodes[c, k]]
            for i in range(3):
                moved[c, i] += by[i, 0] * of[0] + by[i, 1] * of[1] + by[i, 2] * of[2]


@jit_part
def _some(pairs: Pairs, begin: int, end: int) -> Pairs:
    """Those of some pairs in a row."""
    asked = pairs.axes[begin:end], pairs.free[begin:end], pairs.relative[begin:end], pairs.target[begin:end]
    taken = pairs.level[begin:end], pairs.chosen[begin:end], pairs.helped[begin:end], pairs.friction[begin:end]
    return Pairs(*asked, *taken, pairs.forces[begin:end])
