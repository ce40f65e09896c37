"""The pairs of points of a step, and what later steps begin with: forces of the same pairs, and what guided them."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.complementarity.solution import largest
from fenics_rom.world.bodies import Body, Part, places_alone, rigid_points
from fenics_rom.world.collision.contacts import Contacts, Placed, no_contacts
from fenics_rom.world.contact_step import Found, Pairs, add_operator
from fenics_rom.world.guide import Guide
from fenics_rom.world.joint_rows import JointRows
from fenics_rom.world.joints import JointPoints
from fenics_rom.world.meetings import Meeting, is_still
from fenics_rom.world.normal_law import speeds_out
from fenics_rom.world.parts import End, part_of, points_of, relative_points
from fenics_rom.world.soft import Soft
from fenics_rom.world.tolerances import LARGEST, NEAR, NO_GAP, PENETRATION_TOLERANCE, SWERVES

GUIDES = 1e-9  # of arms, and rad: by so much bodies may have moved since W was found
_ONES = np.ones(3)
MORE_SWEEPS = 1  # than at first: if there are more W is found anew
_NONE = no_contacts()


class StepPairs:
    """Finds the pairs of each step.

    Args:
        bodies: all of them.
        meetings: those that may touch.

    Attributes:
        joint_forces: at all points of joints in the last step, (J, 3), N.
        contacts: of each meeting, by its number, in the last step.
    """

    def __init__(self, bodies: Sequence[Body], meetings: Sequence[Meeting]):
        self._bodies, self._meetings = bodies, meetings
        self._touching = sorted({number for meeting in meetings for number in (meeting.first, meeting.second)})
        self._placed = dict[int, Placed]()  # where what lies still was seen first
        self._sizes = [min(body.size, LARGEST) for body in bodies]
        self.contacts: list[tuple[int, Contacts]] = []
        self._pairs: Pairs | None = None
        self._middle_gaps = np.empty(0)
        self._joints = dict[JointPoints, slice]()  # and their rows among all points of joints
        self._joint_ends: list[list[End]] = [[] for _ in bodies]  # of them on each body
        self._held = list[Part]()  # the bodies with these
        self.joint_forces = np.empty((0, 3))
        self.rows: JointRows | None = None  # of joints, where they are not all points alone
        self._guide: tuple[Guide, float, list[Array | tuple[Array, Array]]] | None = None
        self._fewest = 0  # sweeps, with the guide
        self._lie = list[Array | tuple[Array, Array]]()  # the bodies in the step, as `_where`
        self._start, self._swung = np.empty((0, 3)), np.empty(0, int)
        self._meeting_of = np.empty(0, dtype=int)  # of each pair
        self._sizes_met = np.array([meeting.size for meeting in meetings])
        self._laws = np.array([(each.law.restitution, each.law.friction) for each in meetings]).reshape(-1, 2)
        self._swerve = SWERVES * self._sizes_met.min(initial=np.inf)
        both = [(bodies[meeting.first], bodies[meeting.second]) for meeting in meetings]
        self._are_rigid = np.array([not any(isinstance(body, Soft) for body in pair) for pair in both], dtype=bool)
        self._none = NO_GAP * np.where(self._are_rigid, self._sizes_met, 0.0)  # gaps that are none, m
        self._yield_at_once = np.array([not all(body.has_inertia for body in pair) for pair in both], dtype=bool)
        self._are_static = np.array([all(b.is_driven or not b.has_inertia for b in pair) for pair in both], dtype=bool)
        self._dissipated = np.zeros(len(meetings))  # by contact, of which what is let out may take, J

    def join(self, by_name: Mapping[str, JointPoints]) -> None:
        """Goes on with other joints, by name; those that stay keep their forces."""
        known, forces, joints = self._joints, [np.empty((0, 3))], by_name.values()
        held: list[list[End]] = [[] for _ in self._bodies]
        self._start = self._start[: len(self._start) - len(self.joint_forces)]
        self._joints, self._joint_ends, count = {}, [[] for _ in self._bodies], 0
        for joint in joints:
            rows = np.arange(count, count := count + len(joint.points))
            self._joints[joint] = slice(count - len(rows), count)
            for ends in (self._joint_ends, held):
                ends[joint.first].append((rows, 1.0, joint.on_first))
                ends[joint.second].append((rows, -1.0, joint.on_second))
            if len(joint.on_second.tells):  # the first body is pushed where the second one's point is
                at, first = joint.on_second.tells, self._joint_ends[joint.first]
                stays = np.setdiff1d(np.arange(len(rows)), at)
                couples = np.flatnonzero(np.isin(stays, joint.on_first.couples))
                first[-1] = rows[stays], 1.0, rigid_points(joint.on_first.arms[stays], couples)
                first.insert(0, (rows[at], 1.0, places_alone(len(at))))
            forces.append(self.joint_forces[known[joint]] if joint in known else np.zeros((len(rows), 3)))
        self.joint_forces = np.concatenate(forces)
        self._held = [part_of(*each) for each in zip(self._bodies, held, strict=True) if each[1]]
        self.rows = JointRows(by_name, self._joints, self._bodies) if any(each.axes for each in joints) else None
        for body in self._bodies:
            body.is_exact = self.rows is not None
        self._pairs = self._guide = None

    @property
    def dissipated(self) -> Array:
        """By contact of each meeting, J; what takes steps adds to it."""
        return self._dissipated

    def kept_contacts(self, slot_of: Callable[[int, int, int], int]) -> Iterator[tuple[int, int, Array, int]]:
        """Of each contact of the last step where it is to be kept, its feature, force (3,), and as of `Pairs.swung`.

        `slot_of` gives the place, of a meeting, which of its contacts it is, and its feature.
        """
        row = 0
        for number, contacts in self.contacts:
            for place, feature in enumerate(contacts.first.feature.tolist()):
                yield slot_of(number, place, feature), feature, self._start[row], int(self._swung[row])
                row += 1

    def go_on(self, contacts: list[tuple[int, Contacts]], forces: Array, swung: Array) -> None:
        """Goes on from contacts and forces (C + J, 3) of a step that compiled functions took."""
        self.contacts, self._start, self._swung = contacts, forces, swung
        self.joint_forces = forces[len(swung) :]
        self._pairs = self._guide = None

    def of_step(self, h: float, far: bool) -> tuple[Pairs, Array, Guide | None]:
        """The pairs of a step of h s that all bodies have begun, forces to begin with, and what may guide.

        `far`: as the bodies go as they were tried last.
        """
        contacts = self._look(far)
        known = self.contacts
        if self._pairs is None or len(contacts) != len(known) or not all(map(_are_same, contacts, known)):
            self._gather(contacts)
        elif any(now[1] is not then[1] for now, then in zip(contacts, known, strict=True)):
            self._refresh(contacts)
        pairs = self._pairs
        assert pairs is not None
        places, C = pairs.places.copy(), len(pairs.normals)
        if self.rows is not None:
            self.rows.expect(places[C:], h)
        before = np.zeros(places.shape)
        gone = np.zeros(places.shape)
        for body, _, rows, signs, _, points in pairs.parts:
            before[rows] += signs * body.start_velocities(points, places[rows])
            if (lead := body.lead).any():
                gone[rows] += signs * lead
        if self.rows is not None:
            self.rows.begin(h, before[C:])
        gone += h / 2 * before
        gaps = self._middle_gaps - (pairs.normals * gone[:C]).dot(_ONES)
        gaps[np.abs(gaps) < self._none[self._meeting_of]] = 0.0
        swung = self._swung if self._swung.any() else None
        pairs = pairs._replace(places=places, before=before, gaps=gaps, swung=swung)
        return pairs, self._start, self._known_guide(h)

    def are_deep(self, pairs: Pairs) -> Array | None:
        """Which contacts are of two rigid bodies that are in one another, (C,); None where none is."""
        if not len(pairs.gaps) or pairs.gaps.item(pairs.gaps.argmin()) >= 0.0:
            return None
        are_deep = pairs.are_rigid & (-pairs.gaps > PENETRATION_TOLERANCE * self._sizes_met[self._meeting_of])
        return are_deep if are_deep.any() else None

    def let_out(self, pairs: Pairs, found: Found, guide: Guide, h: float) -> Pairs:
        """The same pairs, or with speeds of those that are to be let out of one another: see `speeds_out`."""
        is_deep = self.are_deep(pairs)
        if is_deep is None:
            return pairs
        C, n = len(pairs.gaps), pairs.normals
        a, pressure = (n * pairs.before[:C]).dot(_ONES), (n * found.forces[:C]).dot(_ONES)
        own = np.einsum("ci,cicj,cj->c", n, guide.W[: 3 * C, : 3 * C].reshape(C, 3, C, 3), n)
        out = speeds_out(h, pairs.gaps, a, pressure, own, is_deep, self._meeting_of, self._dissipated)
        return pairs._replace(out=out) if out.any() else pairs

    def overdraws(self, found: Found, h: float) -> bool:
        """Whether contact of two bodies would have done more work in a step of h s than it has dissipated before."""
        return bool((self._dissipated + self._dissipation(found, h) < 0).any())

    def _dissipation(self, found: Found, h: float) -> Array:
        """Of a step of h s by each meeting, J."""
        C = len(self._meeting_of)
        work = (found.forces[:C] * found.velocities[:C]).dot(_ONES)
        return -h * np.bincount(self._meeting_of, work, len(self._meetings))

    def lacks_pairs(self, pairs: Pairs, found: Found, h: float) -> bool:
        """Whether some bodies go much farther than what was looked for is near, under the forces of a step of h s.

        Others have hit them, and they may hit others in turn.
        """
        if not len(pairs.gaps) or h * largest(np.abs(found.velocities - pairs.before)) <= self._swerve:
            return False
        for number in self._touching:
            body = self._bodies[number]
            whole, beside = body.swerve()
            if math.hypot(*whole) + beside > SWERVES * min(body.size, LARGEST) + body.travel()[1]:
                return True
        return False

    def _look(self, far: bool) -> list[tuple[int, Contacts]]:
        placed, travels, found = self._placed, dict[int, tuple[Array, float]](), []
        for number in self._touching:
            body = self._bodies[number]
            now, travels[number] = body.placed(), body.travel()
            if not is_still(now, placed.get(number), self._sizes[number]):
                placed[number] = now
        swerves = {number: self._bodies[number].swerve() for number in self._touching} if far else {}
        for number, meeting in enumerate(self._meetings):
            (whole, beside), (other_whole, other_beside) = travels[meeting.first], travels[meeting.second]
            nearer = 2 * math.hypot(*(whole - other_whole))
            if far:
                (more, beyond), (other_more, other_beyond) = swerves[meeting.first], swerves[meeting.second]
                nearer += 3 * math.hypot(*(more - other_more)) + beyond + other_beyond
            margin = nearer + beside + other_beside + NEAR * meeting.size
            meeting.look(placed[meeting.first], placed[meeting.second], margin, anew=far)
            if meeting.contacts is not None:
                found.append((number, meeting.contacts))
        return found

    def _gather(self, contacts: list[tuple[int, Contacts]]) -> None:
        """Makes the pairs of these contacts, and takes over the forces of those that were there."""
        features = [(meeting, each) for meeting, seen in self.contacts for each in seen.first.feature.tolist()]
        before = dict(zip(features, zip(self._start, self._swung, strict=False), strict=False))
        ends: list[list[End]] = [[] for _ in self._bodies]
        start, C = list[tuple[Array, int]](), 0
        for number, found in contacts:
            meeting = self._meetings[number]
            own = np.arange(C, C := C + len(found.gaps))
            start += [before.get((number, feature), (np.zeros(3), 0)) for feature in found.first.feature.tolist()]
            if meeting.own is not None:
                ends[meeting.first].append((own, 1.0, relative_points(found)))
                continue
            both = self._bodies[meeting.first].takes_couples and self._bodies[meeting.second].takes_couples
            ends[meeting.first].append((own, 1.0, points_of(found.first)))
            ends[meeting.second].append((own, -1.0, points_of(found.second, both)))
        for mine, joined in zip(ends, self._joint_ends, strict=True):
            mine += [(C + rows, sign, points) for rows, sign, points in joined]
        counts = [len(found.gaps) for _, found in contacts]
        self._meeting_of = np.repeat([number for number, _ in contacts], counts).astype(int)
        (e, μ), are_static = self._laws[self._meeting_of].T, self._are_static[self._meeting_of]
        parts = [part_of(*each) for each in zip(self._bodies, ends, strict=True) if each[1] or not each[0].is_driven]
        soft_first = sorted(parts, key=lambda part: (part.points.nodes.shape[1] == 0, not len(part.points.tells)))
        self.contacts, self._guide = contacts, None
        normals, self._middle_gaps, places = self._where_they_are(contacts)
        self._pairs = Pairs(
            *(tuple(soft_first), places, 0 * places, normals, self._middle_gaps, μ),
            *(e, self._are_rigid[self._meeting_of], self._yield_at_once[self._meeting_of]),
            *(are_static, np.zeros(C), ((μ > 0) & ~are_static)[:, None] / 2),
            rows=self.rows,
        )
        self._start = np.concatenate([np.array([force for force, _ in start]).reshape(-1, 3), self.joint_forces])
        self._swung = np.array([swung for _, swung in start], dtype=int)

    def _refresh(self, contacts: list[tuple[int, Contacts]]) -> None:
        """The same pairs as before, where they are now."""
        assert self._pairs is not None
        normals, self._middle_gaps, places = self._where_they_are(contacts)
        self.contacts, self._pairs = contacts, self._pairs._replace(normals=normals, places=places)

    def _where_they_are(self, contacts: list[tuple[int, Contacts]]) -> tuple[Array, Array, Array]:
        """Normals (C, 3), gaps (C,) and places (C + J, 3) of contacts, and of joints."""
        found = [_NONE, *(found for _, found in contacts)]
        places = np.concatenate([*(each.first.arms for each in found), *(joint.points for joint in self._joints)])
        return np.concatenate([each.normals for each in found]), np.concatenate([each.gaps for each in found]), places

    def _known_guide(self, h: float) -> Guide | None:
        """What guided the same pairs, which knows whether bodies lie as they did then."""
        self._lie = self._where()
        if self._guide is None or self._guide[1] != h:
            return None
        self._guide[0].is_right = all(map(_lies_as, self._lie, self._guide[2]))
        return self._guide[0]

    def _where(self) -> list[Array | tuple[Array, Array]]:
        """What the operator of each body that others move depends on: itself, if it is known, or arms and rotation."""
        assert self._pairs is not None
        lie = list[Array | tuple[Array, Array]]()
        for body, pairs, rows, _, _, points in self._pairs.parts:
            if body.is_driven or not len(pairs):
                continue
            known = body.known_answer(points, self._pairs.places[rows])
            if known is None or known[1] is None:
                pose = body.pose
                lie.append((self._pairs.places[rows] - pose.position, pose.rotation))
            else:
                lie.append(known[1])
        return lie

    def keep(self, found: Found, guide: Guide, h: float) -> None:
        """Takes note of the forces of a step of h s that was taken, and of what guided them."""
        C = len(found.forces) - len(self.joint_forces)
        self._start, self.joint_forces = found.forces, found.forces[C:]
        self._swung = np.zeros(C, int) if found.swung is None else found.swung
        if C:
            self._dissipated += self._dissipation(found, h)
        if self._guide is None or self._guide[0] is not guide:
            self._guide, self._fewest = (guide, h, self._lie), found.sweeps
        elif found.sweeps > self._fewest + MORE_SWEEPS:
            self._guide = None

    def stop_joints(self) -> float:
        """Stops by impulses what joints still move by when a step ends; what that takes, J.

        Joints of a body that takes none go on as they move.
        """
        u, left = np.zeros((2, *self.joint_forces.shape))
        W, stopped, parts = np.zeros((u.size, u.size)), np.ones(u.shape, dtype=bool), list[Part]()
        if self.rows is not None:
            self.rows.meet(self._held)
        for part in self._held:
            own = part.body.inverse_mass(part.points)
            if own is None:
                stopped[part.rows] = False
                continue
            parts.append(part)
            u[part.rows] += part.signs * part.body.end_velocities(part.points)
            add_operator(W, part, own)
        u[~stopped] = W[~stopped.ravel()] = W[:, ~stopped.ravel()] = 0.0
        if not u.any():
            return 0.0
        by_rotors = 0.0
        if self.rows is not None:
            impulses, by_rotors = self.rows.stop(W, u, stopped)
        else:
            impulses = -np.linalg.lstsq(W, u.ravel(), rcond=1e-12)[0].reshape(-1, 3)
        for part in parts:
            part.body.kick(part.points, part.signs * impulses[part.rows])
            left[part.rows] += part.signs * part.body.end_velocities(part.points)
        return by_rotors - float(impulses.ravel().dot((u + left).ravel())) / 2

    def force_between(self, first: int, second: int, forces: Array) -> Array:
        """Of a step on the first, (3,), N."""
        force, row = np.zeros(3), 0
        for number, contacts in self.contacts:
            force += _sign(self._meetings[number], first, second) * forces[row : row + len(contacts.gaps)].sum(axis=0)
            row += len(contacts.gaps)
        for joint in self._joints:
            force += _sign(joint, first, second) * self.of_joint(joint, forces)[joint.are_forces].sum(axis=0)
        return force

    def contact_forces(self, first: int, second: int, forces: Array) -> tuple[Array, Array]:
        """Where two bodies touch, or one itself, (k, 3), m, and forces of a step on the first there, (k, 3), N."""
        row = 0
        for number, contacts in self.contacts:
            own, row = forces[row : row + len(contacts.gaps)], row + len(contacts.gaps)
            if {first, second} == {self._meetings[number].first, self._meetings[number].second}:
                return contacts.first.arms.copy(), own.copy() if first == self._meetings[number].first else -own
        return np.empty((0, 3)), np.empty((0, 3))

    def of_joint(self, joint: JointPoints, values: Array) -> Array:
        """Of values (C + J, 3) of all pairs those of the points of a joint that holds, (k, 3)."""
        return values[len(values) - len(self.joint_forces) :][self._joints[joint]].copy()

    def touching(self, forces: Array) -> int:
        """How many pairs of points push, by more than round-off."""
        normals = np.concatenate([_NONE.normals, *(contacts.normals for _, contacts in self.contacts)])
        if not len(normals):
            return 0
        pressure = (forces[: len(normals)] * normals).sum(axis=1)
        return int(np.count_nonzero(pressure > 1e-9 * pressure.max()))


def _are_same(now: tuple[int, Contacts], then: tuple[int, Contacts]) -> bool:
    """Whether contacts of a meeting are of the same points of the bodies."""
    if now[0] != then[0] or now[1] is then[1]:
        return now[0] == then[0]
    sides = (now[1].first, then[1].first), (now[1].second, then[1].second)
    return _equal(now[1].first.feature, then[1].first.feature) and all(
        _equal(a.nodes, b.nodes) and _equal(a.weights, b.weights) for a, b in sides
    )


def _equal(a: Array, b: Array) -> bool:
    return a is b or (a.shape == b.shape and a.tobytes() == b.tobytes())


def _lies_as(now: Array | tuple[Array, Array], then: Array | tuple[Array, Array]) -> bool:
    """Whether the operator of a body, or its arms and rotation, are those of before."""
    if not (isinstance(now, tuple) and isinstance(then, tuple)):
        return now is then
    (arms, rotation), (arms_then, rotation_then) = now, then
    if np.abs(rotation - rotation_then).max() > GUIDES:
        return False
    return bool(np.abs(arms - arms_then).max() <= GUIDES * np.abs(arms_then).max())


def _sign(of: Meeting | JointPoints, first: int, second: int) -> float:
    """1 where the first of a pair is asked for, -1 where the second is, 0 where neither."""
    return float((of.first, of.second) == (first, second)) - float((of.second, of.first) == (first, second))
