"""The arrays of a world, of which compiled steps get a table (`world.compiled.tables`)."""

from collections.abc import Mapping, Sequence
from itertools import chain

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.compiled.shapes import MOST_NUMBERS, shape_rows
from fenics_rom.mechanics.triangle_surface import MORE_PLANES
from fenics_rom.runtime.compiled.arrays_at import table_of
from fenics_rom.world import shapes
from fenics_rom.world.compiled.operators import MOST
from fenics_rom.world.compiled.rigid_bodies import RigidBodies
from fenics_rom.world.compiled.soft_bodies import ROWS, TURNS
from fenics_rom.world.compiled.tables import (
    FREE,
    GIVEN,
    JOINED,
    SLIDES,
    SOFT_BOTH,
    SOFT_FIRST,
    SOFT_SECOND,
    Bodies,
    Driven,
    Freedoms,
    GivenContacts,
    Joined,
    Kept,
    Meetings,
    Near,
    Operators,
    Owed,
    World,
)
from fenics_rom.world.driven import Driven as DrivenBody
from fenics_rom.world.free_soft import FreeSoft
from fenics_rom.world.joint_rows import JointRows
from fenics_rom.world.joints import JointPoints
from fenics_rom.world.make_bodies import AnyBody
from fenics_rom.world.meetings import Meeting
from fenics_rom.world.rigid import Rigid
from fenics_rom.world.row_arrays import row_arrays
from fenics_rom.world.soft import Soft
from fenics_rom.world.soft_tables import SoftTable
from fenics_rom.world.tolerances import NO_GAP

KNOWN_SHAPES = shapes.HalfSpace, shapes.Sphere, shapes.Capsule, shapes.Box
MOST_GIVEN = 64  # contacts of two rigid bodies
BOOKED_TOGETHER = 64  # steps
FEWEST_NODES = 3  # of a soft body, that carry a point: corners of a triangle


def world_arrays(
    bodies: Sequence[AnyBody],
    meetings: Sequence[Meeting],
    joints: Sequence[JointPoints],
    tables: Mapping[int, SoftTable],
    dissipated: Array,
    rows: JointRows | None,
) -> World:
    """Those of bodies by their numbers.

    Args:
        bodies, meetings: all of them.
        joints: that hold.
        tables: of the soft bodies, by number.
        dissipated: by each meeting, J, which steps add to.
        rows: of joints, where these are not all points alone.
    """
    rigid = [n for n, body in enumerate(bodies) if isinstance(body, Rigid)]
    driven = [n for n, body in enumerate(bodies) if isinstance(body, DrivenBody)]
    of_meetings = _meetings(bodies, meetings, tables)
    F, B, S = int(of_meetings.slots[-1]), len(bodies), len(tables)
    fewest = max([FEWEST_NODES, *(table.step.nodes.shape[1] for table in tables.values())])
    joined = _joined(bodies, joints, fewest)
    J = len(joined.ends)
    most = min(MOST, F + J)
    return World(
        np.array([table.table for table in tables.values()], dtype=np.int64).reshape(S, ROWS, 4),
        _bodies(bodies, rigid, driven, tables),
        *_rigid([bodies[n] for n in rigid]),  # type: ignore[misc]
        _driven([bodies[n] for n in driven]),  # type: ignore[misc]
        of_meetings,
        Kept(np.full(F, -1), np.zeros((F, 3)), np.zeros(F, dtype=np.int64), dissipated),
        _near(F + J, joined.nodes.shape[2]),
        Operators(np.zeros(3), *_kept_pairs(most, fewest), np.zeros((S, TURNS)), *np.zeros((3, 9 * most * most))),
        Owed(np.zeros((BOOKED_TOGETHER, B, 3)), np.zeros((BOOKED_TOGETHER, 5))),
        joined,
        _near(F + J, joined.nodes.shape[2]),
        row_arrays(rows, joints, {n: b for b, n in enumerate(rigid)}, {n: s for s, n in enumerate(tables)}),
    )


def table_of_world(arrays: World) -> Array:
    """What compiled steps find these by."""
    return table_of([arrays.softs, *chain.from_iterable(arrays[1:])])


def given_contacts(parts: Sequence[tuple[Array, ...]]) -> GivenContacts:
    """Contacts of several meetings, as of GivenContacts each."""
    if parts:
        return GivenContacts(*(np.ascontiguousarray(np.concatenate(of)) for of in zip(*parts, strict=True)))
    whole, nodes, vectors = np.zeros(0, dtype=np.int64), np.zeros((0, 2, 3), dtype=np.int64), np.zeros((0, 3))
    return GivenContacts(whole, whole, nodes, np.zeros((0, 2, 3)), vectors, vectors, np.zeros(0))


def _bodies(
    bodies: Sequence[AnyBody], rigid: Sequence[int], driven: Sequence[int], tables: Mapping[int, SoftTable]
) -> Bodies:
    B, carriers = len(bodies), list[int]()
    kind, index = np.zeros((2, B), dtype=np.int64)
    for of_kind, numbers in enumerate((rigid, driven, list(tables))):
        kind[list(numbers)], index[list(numbers)] = of_kind, np.arange(len(numbers))
    kind[[n for n in tables if isinstance(bodies[n], FreeSoft)]] = FREE
    rows, radii = np.zeros((B, 1 + MOST_NUMBERS)), np.zeros(B)
    for n in (*rigid, *driven):
        if (shape := bodies[n].shape) is not None:  # type: ignore[union-attr]
            radii[n] = shape.radius_around
            if isinstance(shape, KNOWN_SHAPES):
                rows[n] = shape_rows([shape.obstacle])
    for n in tables:
        carrier = bodies[n].carrier  # type: ignore[union-attr]
        carriers.append(-1 if carrier is None else next(d for d, m in enumerate(driven) if bodies[m] is carrier))
    return Bodies(kind, index, rows, radii, np.zeros((B, 12)), np.zeros((B, 4)), np.array(carriers, dtype=np.int64))


def _rigid(bodies: Sequence[Rigid]) -> tuple[RigidBodies, Freedoms]:
    B = len(bodies)
    mass, size = (np.array([getattr(body, name) for body in bodies], dtype=float) for name in ("mass", "size"))
    inertia = np.array([body.inertia for body in bodies], dtype=float).reshape(-1, 3, 3)
    gravity = np.array([body.gravity for body in bodies], dtype=float).reshape(-1, 3)
    rigid = RigidBodies(mass, inertia, np.zeros((B, 3, 3)), np.zeros((B, 3, 3)), np.zeros((B, 2, 3)))
    moving = np.zeros((B, 2, 3)), np.zeros((B, 4)), np.zeros((B, 3)), np.zeros((B, 3))
    off = np.array([np.concatenate([body.off[0], body.off[1].ravel()]) for body in bodies], dtype=float).reshape(-1, 12)
    return rigid, Freedoms(gravity, *moving, np.linalg.inv(inertia), size, np.zeros((B, 4, 3)), off)


def _driven(bodies: Sequence[DrivenBody]) -> Driven:
    D, sizes = len(bodies), np.array([body.size for body in bodies], dtype=float)
    return Driven(np.zeros((D, 13)), np.zeros((D, 13)), np.zeros((D, 30)), np.zeros((D, 2)), sizes)


def _meetings(bodies: Sequence[AnyBody], meetings: Sequence[Meeting], tables: Mapping[int, SoftTable]) -> Meetings:
    M, counts = len(meetings), list[int]()
    kind, numbers = np.zeros(M, dtype=np.int64), np.zeros((M, 5))
    for m, meeting in enumerate(meetings):
        both, law = (meeting.first, meeting.second), meeting.law
        soft = [n for n in both if n in tables]
        none = 0.0 if soft else NO_GAP * meeting.size
        numbers[m] = meeting.size, law.restitution, law.friction, none, not soft
        rigid = [bodies[n].shape for n in both if n not in tables]  # type: ignore[union-attr]
        if not meeting.is_on:
            kind[m] = JOINED
            counts.append(0)
            continue
        planes = 1 + MORE_PLANES if any(isinstance(shape, shapes.Mesh) for shape in rigid) else 1
        counts.append(planes * max(MOST_GIVEN, sum(len(tables[n].points.rest) for n in soft)))
        if any(bodies[n].surface.faces is not None for n in soft):  # type: ignore[union-attr]
            counts[-1] *= 2  # and contacts are found elsewhere
        elif len(soft) == 2:
            kind[m] = SOFT_BOTH
        elif soft and isinstance(bodies[sum(both) - soft[0]].shape, KNOWN_SHAPES):  # type: ignore[union-attr]
            kind[m] = SOFT_FIRST if soft[0] == meeting.first else SOFT_SECOND
    assert GIVEN == 0
    slots = np.cumsum([0, *counts]).astype(np.int64)
    pairs = np.array([(meeting.first, meeting.second) for meeting in meetings], dtype=np.int64).reshape(-1, 2)
    return Meetings(pairs, kind, numbers, slots, np.zeros(M), np.zeros(M))


def _joined(bodies: Sequence[AnyBody], joints: Sequence[JointPoints], fewest: int) -> Joined:
    J = sum(len(joint.points) for joint in joints)
    sides = [side for joint in joints for side in (joint.on_first, joint.on_second)]
    c = max([fewest, *(side.nodes.shape[1] for side in sides)])
    ends, nodes = np.zeros((J, 2), dtype=np.int64), np.zeros((J, 2, c), dtype=np.int64)
    weights, arms, row = np.zeros((J, 2, c)), np.zeros((J, 2, 3)), 0
    couples, count = np.full(J, -1), 0
    for joint in joints:
        rows = slice(row, row := row + len(joint.points))
        ends[rows] = joint.first, joint.second
        for couple in joint.on_first.couples.tolist():
            couples[rows.start + couple], count = count, count + 1
        couples[rows.start + joint.on_second.tells] = SLIDES
        for side, points in enumerate((joint.on_first, joint.on_second)):
            wide = points.nodes.shape[1]
            nodes[rows, side, :wide], weights[rows, side, :wide] = points.nodes, points.weights
            arms[rows, side] = points.arms
    swing = [n for n, body in enumerate(bodies) if isinstance(body, Soft) and not body.takes_impulses]
    are_stopped = 1.0 - np.isin(ends, swing).any(axis=1)
    return Joined(ends, nodes, weights, arms, np.zeros((J, 3)), are_stopped, couples, np.zeros((count, 3 + c, 3)))


def _kept_pairs(most: int, wide: int) -> tuple[Array, Array, Array]:
    whole = np.zeros((most, 2, wide), dtype=np.int64)
    return np.zeros(most, dtype=np.int64), whole, np.zeros(whole.shape)


def _near(F: int, wide: int) -> Near:
    def whole(*shape: int) -> Array:
        return np.zeros((F, *shape), dtype=np.int64)

    def real(*shape: int) -> Array:
        return np.zeros((F, *shape))

    ends = whole(), whole(), whole(), whole(2), whole(2), whole(2, wide)
    return Near(*ends, real(2, wide), real(3), real(3), real(), real(3), real(6), real(), real(3), real(3), real(2, 3))
