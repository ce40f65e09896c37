"""The rows of joints as arrays, of which compiled steps get a table (`world.compiled.row_tables`)."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy import ndarray as Array

from fenics_rom.world.compiled.row_tables import ALONG, AT_START, FIXED, FOLLOWING, TURNING, Rows
from fenics_rom.world.drive_law import MOST_PIECES
from fenics_rom.world.joint_rows import JointRows
from fenics_rom.world.joints import JointPoints

BODIES_OF_ROW = 4
NOBODY = np.zeros(3)


def order_of_tries(joints: Sequence[JointPoints], rigid: Mapping[int, int]) -> list[int] | None:
    """Rigid bodies such that what slides along another one is tried before that; None: some slide in a circle.

    Args:
        joints: that hold.
        rigid: which body, by its number, is which of those that move freely.
    """
    slides = [(rigid.get(j.first, -1), rigid.get(j.second, -1)) for j in joints if len(j.on_second.tells)]
    left, order = list(range(len(rigid))), list[int]()
    while left:
        waits = {first for first, second in slides if second in left}
        ready = [b for b in left if b not in waits]
        if not ready:
            return None
        order, left = order + ready, [b for b in left if b in waits]
    return order


def row_arrays(
    rows: JointRows | None, joints: Sequence[JointPoints], rigid: Mapping[int, int], soft: Mapping[int, int]
) -> Rows:
    """Those of joints that hold.

    Args:
        rows: theirs; None where all are points alone.
        joints: in the order of their points.
        rigid: which body, by its number, is which of those that move freely.
        soft: the same of soft ones.
    """
    turns = np.array(order_of_tries(joints, rigid) or range(len(rigid)), dtype=np.int64)
    ends = [(joint.first, joint.second) for joint in joints for _ in joint.points]
    tells = [k in joint.on_second.tells for joint in joints for k in range(len(joint.points))]
    slides = np.flatnonzero(np.array(tells, dtype=bool)).astype(np.int64)
    if rows is None:
        return _arrays([], [], [], slides, turns, [], len(rigid))
    entries = _entries(rows)
    moved = [{b for pair, *_ in of for b in ends[pair] if b in rigid or b in soft} for of in entries]
    order, islands = _in_order(rows, entries, moved, ends)
    new = np.argsort(order)
    driven = [(int(new[of.row]), of.drive.numbers) for of in rows.driven]
    for of in entries:
        of[:] = [(pair, kind, basis, int(new[leader])) for pair, kind, basis, leader in of]
    own = [[rigid[b] for b in sorted(moved[row]) if b in rigid] for row in order]
    arrays = _arrays([entries[row] for row in order], own, islands, slides, turns, driven, len(rigid))
    reach, at_soft = arrays.reach, list[tuple[int, int]]()
    for begin, end in zip(arrays.islands[:-1], arrays.islands[1:], strict=True):
        last = begin
        for row in range(begin, end):
            last = max(last, max(s for s in range(row, end) if s == row or moved[order[row]] & moved[order[s]]))
            reach[row] = last
    for row in range(len(order)):
        for e in range(arrays.begins[row], arrays.begins[row + 1]):
            if any(b in soft for b in ends[arrays.pairs[e]]):
                at_soft.append((row, e))
    return arrays._replace(soft=np.array(at_soft, dtype=np.int64).reshape(-1, 2))


Entry = tuple[int, int, Array, int]  # pair, kind, basis, and which row it follows


def _entries(rows: JointRows) -> list[list[Entry]]:
    entries: list[list[Entry]] = [[] for _ in rows.D]
    for row, column in rows.fixed:
        entries[row].append((column // 3, FIXED, np.eye(3)[column % 3], 0))
    for of, basis, pairs, _ in rows.together:
        for row, directions in zip(of.tolist(), basis, strict=True):
            entries[row] += [(pair, AT_START, d, 0) for pair, d in zip(pairs.tolist(), directions, strict=True)]
    for framed in rows.framed:
        kind = TURNING if framed.turns else ALONG
        for row, axis in zip(framed.rows, framed.axes, strict=True):
            entries[row].append((framed.pair, kind, axis, 0))
    for row, follower, leader, ratio in rows.following:
        for driven, share in ((follower, 1.0), (leader, -ratio)):
            entries[row].append((driven.pair, FOLLOWING, np.array([share, 0.0, 0.0]), driven.row))
    return entries


def _in_order(
    rows: JointRows, entries: Sequence[Sequence[Entry]], moved: Sequence[set[int]], ends: Sequence[tuple[int, int]]
) -> tuple[list[int], list[int]]:
    """Rows island after island, neighbours near to one another; how many there are in each."""
    order, counts = list[int](), list[int]()
    for island in rows.islands:
        own = island.rows.tolist()
        groups: dict[frozenset[int], list[int]] = {}
        for row in own:  # those of a joint, or of joints that go with one another
            groups.setdefault(frozenset(moved[row]), []).append(row)
        near = {one: [other for other in groups if other != one and one & other] for one in groups}
        begun, found = list[frozenset[int]](), sorted(groups, key=lambda one: (len(near[one]), min(one)))
        while len(begun) < len(groups):
            waits = [next(one for one in found if one not in begun)]
            while waits:
                one = waits.pop(0)
                if one not in begun:
                    begun.append(one)
                    waits += [other for other in near[one] if other not in begun]
        order += [row for one in begun for row in groups[one]]
        counts.append(len(own))
    return order, counts


def _arrays(
    entries: Sequence[Sequence[Entry]],
    own: Sequence[Sequence[int]],
    counts: Sequence[int],
    slides: Array,
    turns: Array,
    driven: Sequence[tuple[int, tuple[float, ...]]],
    B: int,
) -> Rows:
    R, Q, N = len(entries), len(driven), sum(n * n for n in counts)
    begins = np.cumsum([0, *map(len, entries)]).astype(np.int64)
    flat = [entry for of in entries for entry in of]
    pairs, kinds = (np.array([entry[k] for entry in flat], dtype=np.int64) for k in (0, 1))
    leaders = np.array([begins[entry[3]] for entry in flat], dtype=np.int64)
    basis = np.array([entry[2] for entry in flat], dtype=float).reshape(-1, 3)
    bodies = np.full((R, BODIES_OF_ROW), -1)
    for row, of in enumerate(own):
        bodies[row, : len(of)] = of
    of_body = [[(row, of.index(b)) for row, of in enumerate(own) if b in of] for b in range(B)]
    of_bodies = np.cumsum([0, *map(len, of_body)]).astype(np.int64)
    rows_of_bodies = np.array([each for of in of_body for each in of], dtype=np.int64).reshape(-1, 2)
    numbers = np.zeros((5, R))
    numbers[0] = 1.0
    islands, squares = (np.cumsum([0, *of]).astype(np.int64) for of in (counts, [n * n for n in counts]))
    whole = np.zeros(R, dtype=np.int64)
    laws = np.array([each[1] for each in driven]).reshape(Q, 11), np.zeros((Q, 6)), np.zeros((Q, MOST_PIECES, 7))
    none, no_rows = np.zeros((0, 2), dtype=np.int64), np.zeros(R)
    of_rows = begins, pairs, kinds, leaders, basis, basis.copy(), bodies, of_bodies, rows_of_bodies, none
    ranks = np.zeros((len(counts), 2), dtype=np.int64)
    factors = islands, whole, squares, np.zeros(N), np.zeros(N), whole.copy(), ranks
    rows = np.array([each[0] for each in driven], dtype=np.int64)
    of_drives = rows, *laws, np.full((Q, 2), -1), slides, turns
    return Rows(*of_rows, *factors, no_rows, numbers, np.zeros((2, R, 24)), *of_drives)
