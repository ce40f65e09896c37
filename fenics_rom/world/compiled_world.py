"""Whole steps of a world by compiled functions, where they know all of its bodies; what they do not take is NumPy's."""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import or_numpy
from fenics_rom.mechanics.base_path import base_in
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.runtime.compiled.arrays_at import table_of
from fenics_rom.runtime.steppers.free_frame import FreeFrame
from fenics_rom.world.collision.contacts import Contacts, Placed, PlacedShape, Spots
from fenics_rom.world.compiled.many_steps import exchange_pairs, take_steps
from fenics_rom.world.compiled.tables import ENDED, GIVEN, IS_DUE, PAIRS, SINCE, SWUNG, TAKEN, GivenContacts, Near
from fenics_rom.world.compiled.world_step import NEEDS_CONTACTS, NEEDS_ROWS, OTHERWISE, count_pushing, force_on
from fenics_rom.world.contact_step import Found
from fenics_rom.world.drive_law import TARGET
from fenics_rom.world.driven import Driven
from fenics_rom.world.drives import State
from fenics_rom.world.joints import JointPoints
from fenics_rom.world.meetings import Meeting, is_still
from fenics_rom.world.pushes import Pushes
from fenics_rom.world.rigid import Rigid
from fenics_rom.world.row_arrays import order_of_tries
from fenics_rom.world.soft import Soft
from fenics_rom.world.soft_tables import SoftTable, soft_table
from fenics_rom.world.step_count import next_time
from fenics_rom.world.step_inputs import SoftOne, StepInputs
from fenics_rom.world.tolerances import LARGEST
from fenics_rom.world.world_arrays import BOOKED_TOGETHER, given_contacts, table_of_world, world_arrays

if TYPE_CHECKING:
    from fenics_rom.world.make_bodies import AnyBody
    from fenics_rom.world.step_pairs import StepPairs

MOST_ASKED = 3  # times in a step for rows of residual compliance: the first may leave no room for those of others
LONGEST_PAUSE = 64  # steps, in which what compiled functions did not take again and again is not asked of them


class CompiledWorld:
    """Steps of h s of bodies, by their numbers.

    Args:
        bodies: all of them, by name.
        meetings: those that may touch.
        joints: that hold.
        tables: of the soft bodies, by number.
        pairs: contacts of NumPy's steps.
        met: the account of what contacts dissipate.
        h: s.

    Attributes:
        is_ahead: whether the last step was one of these, so that others do not know of it.
        sweeps: of that step.
        misfits: in how many steps in a row a soft body was in another contact mode.
    """

    def __init__(
        self,
        bodies: Mapping[str, "AnyBody"],
        meetings: Sequence[Meeting],
        joints: Sequence[JointPoints],
        tables: Mapping[int, SoftTable],
        pairs: "StepPairs",
        met: EnergyLedger,
        h: float,
    ):
        self._names, self._bodies, self._meetings = list(bodies), list(bodies.values()), meetings
        self._tables, self._pairs, self._met, self._h = tables, pairs, met, h
        self.is_ahead, self.sweeps, self._count, self._row = False, 0, 0, 0
        self._pause = self._waits = self.misfits = 0
        self._rigid = [(n, body) for n, body in enumerate(self._bodies) if isinstance(body, Rigid)]
        self._driven = [(n, body) for n, body in enumerate(self._bodies) if isinstance(body, Driven)]
        soft = [(n, name, body) for n, (name, body) in enumerate(bodies.items()) if isinstance(body, Soft)]
        self._soft = [SoftOne(n, name, body, tables[n]) for n, name, body in soft]
        self._free = any(isinstance(each.kernel, FreeFrame) or len(each.kernel.reactions) for each in tables.values())
        self._bends = any(table.frame.bent is not None for table in tables.values())
        self._switching = [each for each in self._soft if len(each.body.rom.contact_models) > 1]
        orders = [each.order for each in self._soft]
        self._watched, self._told = np.zeros((len(orders), 6)), np.zeros(4, dtype=np.int64)
        self._looked_at = np.zeros((len(orders), max(orders, default=0)))
        self._placed = dict[int, Placed]()  # where what lies still was seen first
        self._arrays = world_arrays(self._bodies, meetings, joints, tables, pairs.dissipated, pairs.rows)
        self._table, self._none = table_of_world(self._arrays), given_contacts([])
        self._first = int(self._table[PAIRS, 0])
        self._no_contacts = table_of(self._none)
        self._hooks: list[tuple[EnergyLedger, Callable[[], None]]] = []
        for ledger in [met, *(body.account for body in self._bodies)]:
            self._hooks.append((ledger, ledger.flush))
            ledger.flush = partial(_both, self.book, ledger.flush)
        self._drives = [] if pairs.rows is None else pairs.rows.driven
        self._soft_ones = [isinstance(body, Soft) for body in self._bodies]
        self._are_told = self._soft_ones.copy()
        rigid = [(b, name, body) for b, (name, body) in enumerate((self._names[n], body) for n, body in self._rigid)]
        motors = {each.name: q for q, each in enumerate(self._drives) if each.drive.motor is not None}
        given = self._arrays.freedoms.given, self._arrays.rows.states[:, TARGET]
        self._given = StepInputs(self._soft, rigid, [body for _, body in self._driven], motors, *given, h)
        self._load()

    # From objects, and back.

    def _load(self) -> None:
        """Takes over what is kept of contacts in NumPy's steps, and where rigid bodies are."""
        self._arrays.kept.features[:] = -1
        for slot, feature, force, swung in self._pairs.kept_contacts(self._slot_of):
            self._arrays.kept.features[slot], self._arrays.kept.forces[slot], self._arrays.kept.swung[slot] = (
                feature,
                force,
                swung,
            )
        self._arrays.joined.forces[:] = self._pairs.joint_forces
        for state, each in zip(self._arrays.rows.states, self._drives, strict=True):
            state[:] = each.joint.state
        rigid, freedoms, driven = self._arrays.rigid, self._arrays.freedoms, self._arrays.driven
        for b, (_, body) in enumerate(self._rigid):
            rigid.rotation[b], rigid.motion[b], _ = body.begun
            freedoms.quaternion[b], freedoms.momentum[b], freedoms.acceleration[b] = body.turning
        for d, (_, moved) in enumerate(self._driven):
            driven.start[d] = driven.end[d] = self._given.ends[:, d] = np.concatenate(moved.pose)
            driven.misfit[d] = moved.misfit

    def _slot_of(self, meeting: int, place: int, feature: int) -> int:
        """Where a contact, the so-many-th of its meeting, is kept."""
        first = int(self._arrays.meetings.slots[meeting])
        return first + (place if self._arrays.meetings.kinds[meeting] == GIVEN else feature)

    def tell(self, number: int) -> None:
        """Has a body know of the last step, if it is rigid and does not."""
        if self._are_told[number]:
            return
        self._are_told[number] = True
        arrays, body = self._arrays, self._bodies[number]
        index = int(arrays.bodies.numbers[number])
        if type(body) is Rigid:  # `isinstance` of a class with a protocol takes 3 us where it is another one
            turning = (of[index] for of in arrays.freedoms[2:5])
            body.go_on(arrays.rigid.motion[index], arrays.rigid.rotation[index], *turning)
        elif type(body) is Driven:
            body.go_on(base_in(arrays.driven.start[index].copy()), tuple(arrays.driven.misfit[index].tolist()))

    def tell_drives(self) -> None:
        """Has joints know of the last step."""
        for state, each in zip(self._arrays.rows.states.tolist(), self._drives, strict=True):
            each.joint.state = State(*state)

    def tell_all(self) -> None:
        """Has all bodies, and NumPy's steps, know of the last step."""
        for number in range(len(self._bodies)):
            self.tell(number)
        self.tell_drives()
        C, near = self._count, self._near
        contacts = []
        for m in np.unique(near.meetings[:C]).tolist():
            rows = (near.meetings[:C] == m).nonzero()[0]
            places, features = near.places[rows], near.features[rows]
            first, second = (Spots(places, near.nodes[rows, k], near.weights[rows, k], features) for k in (0, 1))
            contacts.append((m, Contacts(first, second, near.normals[rows], near.gaps[rows])))
        self._pairs.go_on(contacts, self.found.forces, near.numbers[:C, SWUNG].astype(int))
        self.is_ahead = False

    def leave(self) -> None:
        """Is asked for no more steps: what it knows is handed over."""
        self.book()
        if self.is_ahead:
            self.tell_all()
        for ledger, flush in self._hooks:
            ledger.flush = flush

    # Steps.

    @or_numpy
    def take(self, inputs: Mapping[str, Mapping[str, Any]], time: float, most: int) -> int | None:
        """Takes steps, the first of which begins at a time, s, under the same inputs: how many, so many at most.

        None where the first one is NumPy's, and nothing is changed.
        """
        if self._waits:
            self._waits -= 1
            return None
        if not all(each.body.stays_in(each.kernel) for each in self._switching):
            self.misfits += 1
            return None
        self.misfits = 0
        if not self.is_ahead:
            self._load()
        if most > 1:
            most = 1 if self._switching or self._bends else min(most, BOOKED_TOGETHER - self._row)
        if not (self._given.set(inputs, time) and (most := self._given.set_ends(most))):
            return None
        for each, watched, looked_at in zip(self._soft, self._watched, self._looked_at, strict=True):
            each.body.watch_in_loops(watched, looked_at)
        taken, ended = self._take_steps(most)
        if taken:
            self._end(taken)
        if ended == OTHERWISE:
            for each in self._soft:  # what was begun of a step
                self._tables[each.number].frame.forget()
            self._pause = 1 if taken else min(2 * self._pause + 1, LONGEST_PAUSE)
            self._waits = self._pause + (taken > 0)
        return taken or None

    def _end(self, taken: int) -> None:
        """Ends steps that were taken."""
        self._pause, self.is_ahead, self._row, self._are_told = 0, True, self._row + taken, self._soft_ones.copy()
        if self._row == BOOKED_TOGETHER:
            self.book()
        for _, moved in self._driven:
            moved.time = next_time(moved.time, self._h, taken)
        for each, watched in zip(self._soft, self._watched.tolist(), strict=True):
            twice, within = each.told[:2].tolist()
            each.kernel.contact = each.contact
            if each.beside is not None:
                each.beside.end_in_world(each.u, twice, within)
            each.body.end_compiled(twice, each.u, taken, watched[SINCE], watched[IS_DUE])
        for each in self._switching:
            each.body.note_near(*self._nearest_to(each.number))

    def _take_steps(self, most: int) -> tuple[int, int]:
        """Takes so many steps at most, of which all is set: how many, and as of `take_steps` why they end."""
        taken, given, told, goes_on, asked = 0, self._no_contacts, self._told, False, 0
        while True:
            ends, told[TAKEN] = self._given.ends[taken:most], 0
            try:
                take_steps(
                    *(self._table, given, self._h, self._row + taken, goes_on, self._free, ends),
                    *(self._watched, self._looked_at, told),
                )
            except np.linalg.LinAlgError:
                exchange_pairs(self._table)
                told[ENDED] = OTHERWISE
            of_these, C, sweeps, ended = told.tolist()
            if of_these:
                taken, self._count, self.sweeps = taken + of_these, C, sweeps
            asked = asked + 1 if ended == NEEDS_ROWS and not of_these else 0
            if asked > MOST_ASKED:  # there is no room for them
                exchange_pairs(self._table)
                return taken, OTHERWISE
            if ended not in (NEEDS_CONTACTS, NEEDS_ROWS):
                return taken, ended
            goes_on = True
            if ended == NEEDS_ROWS:
                for table in self._tables.values():
                    table.keep_rows()
                continue
            contacts = self._find_contacts()  # kept, as the table is of its arrays
            given = table_of(contacts)

    def _nearest_to(self, number: int) -> tuple[Array, Array]:
        """Contact points (k,) of a soft body that others are near to, and the gaps when the step began, m."""
        C, near = self._count, self._near
        c, side = (near.ends[:C] == number).nonzero()
        nodes, gaps = near.nodes[c, side], np.repeat(near.gaps[c, None], near.nodes.shape[2], axis=1)
        there = near.weights[c, side] != 0
        return nodes[there], gaps[there]

    def _find_contacts(self) -> GivenContacts:
        """Contacts of the meetings that compiled functions do not look at."""
        placed, of_step, parts = self._placed, dict[int, Placed](), list[tuple[Any, ...]]()
        arrays = self._arrays.meetings
        for m in (arrays.are_near != 0).nonzero()[0].tolist():
            meeting, both = self._meetings[m], (self._meetings[m].first, self._meetings[m].second)
            for number in both:
                if number not in of_step:
                    now, size = self._placed_now(number), min(self._bodies[number].size, LARGEST)
                    of_step[number] = placed[number] = (
                        placed[number] if is_still(now, placed.get(number), size) else now
                    )
            meeting.look(*(of_step[number] for number in both), float(arrays.margins[m]))
            if (found := meeting.contacts) is None:
                continue
            k = len(found.gaps)
            shape = k, *self._arrays.near.nodes.shape[1:]
            nodes, weights = np.zeros(shape, dtype=np.int64), np.zeros(shape)
            places = found.first.arms
            for side, spots in enumerate((found.first, found.second)):
                if wide := spots.nodes.shape[1]:
                    nodes[:, side, :wide], weights[:, side, :wide], places = spots.nodes, spots.weights, spots.arms
            numbers = np.full(k, m), found.first.feature, nodes, weights
            parts.append((*numbers, places, found.normals, found.gaps))
        return given_contacts(parts)

    def _placed_now(self, number: int) -> Placed:
        """A body as it is expected in the middle of the step."""
        body = self._bodies[number]
        if isinstance(body, Soft):
            step = self._tables[number].step
            places = step.places + self._h / 2 * step.velocities
            return body.surface._replace(points=places)
        placed = self._arrays.bodies.placed[number]
        assert body.shape is not None
        return PlacedShape(body.shape, placed[:3].copy(), placed[3:].reshape(3, 3).copy())

    # What is told.

    def book(self) -> None:
        """Books what the steps so far are to be booked for."""
        rows, self._row = self._row, 0
        if not rows:
            return
        works = self._arrays.owed.bodies[:rows].transpose(1, 2, 0).tolist()
        for body, of_body in zip(self._bodies, works, strict=True):
            supplied, dissipated, by_others = map(math.fsum, of_body)
            body.account.book(supplied=supplied, dissipated=dissipated)
            body.account.book_contact(by_others, 0.0, 0.0, 0.0)
        by_impacts, by_friction, by_joints, numerical, by_motors = map(
            math.fsum, self._arrays.owed.met[:rows].T.tolist()
        )
        self._met.book_contact(0.0, by_impacts, by_friction, 0.0)
        self._met.book(supplied=by_motors, dissipated=by_joints, numerical=numerical)

    def force_between(self, first: int, second: int) -> Array:
        """Of the last step on the first of two bodies, (3,), N."""
        return force_on(self._table, self._count, first, second)

    def contact_forces(self, first: int, second: int) -> tuple[Array, Array]:
        """Where two bodies touched in the last step (k, 3), m, and forces on the first there (k, 3), N."""
        near, (one, other) = self._near, self._near.ends[: self._count].T
        forward = (one == first) & (other == second)
        rows = (forward | ((one == second) & (other == first))).nonzero()[0]
        return near.places[rows], np.where(forward[rows, None], 1.0, -1.0) * near.forces[rows]

    def pushes(self, number: int) -> Pushes:
        """What contacts did to a soft body in the last step."""
        C, near = self._count, self._near
        c, end = (near.ends[:C] == number).nonzero()
        signs = np.where(end, -1.0, 1.0)[:, None]
        n, f, u = (signs * of[c] for of in (near.normals, near.forces, near.u))
        return Pushes(near.nodes[c, end], near.weights[c, end], n, f, u, near.numbers[c, 1])

    @property
    def _near(self) -> Near:
        """Pairs of the last step that was taken."""
        return self._arrays.near if self._table[PAIRS, 0] == self._first else self._arrays.before

    @property
    def touching(self) -> int:
        """How many pairs of points push, by more than round-off."""
        C, near = self._count, self._near
        return count_pushing(near.forces[:C], near.normals)

    @property
    def found(self) -> Found:
        """Forces of the last step."""
        near = self._near
        forces, velocities = (of[: self._pairs_found].copy() for of in (near.forces, near.u))
        return Found(forces, velocities, self.sweeps, 0.0)

    @property
    def _pairs_found(self) -> int:
        """How many contacts and points of joints the last step had."""
        return self._count + len(self._arrays.joined.ends)


def _both(first: Callable[[], None], second: Callable[[], None]) -> None:
    first()
    second()


def compiled_world(
    bodies: Mapping[str, "AnyBody"],
    meetings: Sequence[Meeting],
    joints: Sequence[JointPoints],
    pairs: "StepPairs",
    met: EnergyLedger,
    h: float,
) -> CompiledWorld | None:
    """What takes whole steps of h s of bodies; None where one of them is none that it knows."""
    tables = dict[int, SoftTable]()
    rigid = [number for number, body in enumerate(bodies.values()) if isinstance(body, Rigid)]
    if order_of_tries(joints, {number: b for b, number in enumerate(rigid)}) is None:
        return None
    for number, body in enumerate(bodies.values()):
        if isinstance(body, Soft):
            table = soft_table(body)
            if table is None:
                return None
            tables[number] = table
    pulled = {number for number, table in tables.items() if len(table.kernel.reactions)}
    if any(len(joint.on_first.couples) and joint.first in pulled for joint in joints):
        return None  # how such a surface turns is known in a try alone
    return CompiledWorld(bodies, meetings, joints, tables, pairs, met, h)
