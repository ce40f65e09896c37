"""The pairs of points of a step, and what later steps begin with: forces of the same pairs, and what guided them."""

import math
from collections.abc import Sequence

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.complementarity.solution import largest
from fenics_rom.world.bodies import Body, Points
from fenics_rom.world.collision.contacts import Contacts, Spots
from fenics_rom.world.contact_step import Found, Guide, Pairs, Part
from fenics_rom.world.joints import JointPoints
from fenics_rom.world.meetings import PENETRATION_TOLERANCE, Meeting, Placed, is_still
from fenics_rom.world.soft import Soft

NEAR = 0.01  # of the smaller body: what is nearer is looked at in every step, besides what can be reached
SWERVES = 0.005  # of a body's size: so much farther than was foreseen it may go before others are looked for again
ROUND_OFF = 1e-12  # of the smaller body: gaps that are none
LARGEST = 1.0  # m: of a half-space, of how far it moves
GUIDES = 1e-9  # of arms, and rad: by so much bodies may have moved since W was found
RESTS = 2.5  # times as deep as two bodies are in one another: so far points may move in a step of what rests there
_ONES = np.ones(3)
MORE_SWEEPS = 1  # than at first: if there are more W is found anew


class StepPairs:
    """Finds the pairs of each step.

    Args:
        bodies: all of them.
        meetings: those that may touch.
        joints: theirs.
    """

    def __init__(self, bodies: Sequence[Body], meetings: Sequence[Meeting], joints: Sequence[JointPoints]):
        self._bodies, self._meetings, self._joints = bodies, meetings, joints
        self._touching = sorted({number for meeting in meetings for number in (meeting.first, meeting.second)})
        self._placed: list[Placed | None] = [None] * len(bodies)  # where what lies still was seen first
        self._sizes = [min(body.size, LARGEST) for body in bodies]
        self._contacts: list[tuple[int, Contacts]] = []
        self._pairs: Pairs | None = None
        self._middle_gaps = np.empty(0)
        self._joint_forces = np.zeros((sum(len(joint.points) for joint in joints), 3))
        self._guide: tuple[Guide, float, list[Array | tuple[Array, Array]]] | None = None
        self._fewest = 0  # sweeps, with the guide
        self._held: tuple[tuple[Part, ...], list[tuple[Body, Array, Array, Points]]] = (), []
        self._lie = list[Array | tuple[Array, Array]]()  # the bodies in the step, as `_where`
        self._start, self._swung = np.empty((0, 3)), np.empty(0, int)
        self._meeting_of = np.empty(0, dtype=int)  # of each pair
        self._none = np.empty(0)  # of each, m
        self._swerve = SWERVES * min((meeting.size for meeting in meetings), default=0.0)
        both = [(bodies[meeting.first], bodies[meeting.second]) for meeting in meetings]
        self._are_rigid = np.array([not any(isinstance(body, Soft) for body in pair) for pair in both], dtype=bool)
        self._yield_at_once = np.array([not all(body.has_inertia for body in pair) for pair in both], dtype=bool)
        self._deep = -PENETRATION_TOLERANCE * np.array([meeting.size for meeting in meetings])
        self._dissipated = np.zeros(len(meetings))  # by contact, of which what is let out may take, J

    def join(self, joints: Sequence[JointPoints]) -> None:
        """Goes on with other joints; those that stay keep their forces."""
        parts = np.split(self._joint_forces, np.cumsum([len(joint.points) for joint in self._joints])[:-1])
        known = {id(joint): forces for joint, forces in zip(self._joints, parts, strict=False)}
        forces = [known.get(id(joint), np.zeros((len(joint.points), 3))) for joint in joints]
        self._start = self._start[: len(self._start) - len(self._joint_forces)]
        self._joints, self._joint_forces = joints, np.concatenate([np.zeros((0, 3)), *forces])
        self._pairs, self._guide, self._held = None, None, ((), [])

    def of_step(self, h: float, far: bool = False) -> tuple[Pairs, Array, Guide | None]:
        """The pairs of a step of h s that all bodies have begun, forces to begin with, and what may guide.

        `far`: as the bodies go as they were tried last.
        """
        contacts = self._look(far)
        known = self._contacts
        if self._pairs is None or len(contacts) != len(known) or not all(map(_are_same, contacts, known)):
            self._gather(contacts)
        elif any(now[1] is not then[1] for now, then in zip(contacts, known, strict=True)):
            self._refresh(contacts)
        pairs = self._pairs
        assert pairs is not None
        places, C = pairs.places.copy(), len(pairs.normals)
        before = np.zeros(places.shape)
        gone = np.zeros(places.shape)
        for body, _, rows, signs, _, points in pairs.parts:
            before[rows] += signs * body.start_velocities(points, places[rows])
            if (lead := body.lead).any():
                gone[rows] += signs * lead
        gone += h / 2 * before
        gaps = self._middle_gaps - (pairs.normals * gone[:C]).dot(_ONES)
        gaps[np.abs(gaps) < self._none] = 0.0
        swung = self._swung if self._swung.any() else None
        pairs = pairs._replace(places=places, before=before, gaps=gaps, swung=swung)
        return pairs, self._start, self._known_guide(h)

    def let_out(self, pairs: Pairs, found: Found, guide: Guide, h: float) -> Pairs:
        """The same pairs, or with speeds of those that are to be let out of one another, as they rest there.

        Rests is what the forces of the step press without an impact. They leave no faster than these could stop.
        """
        C = len(pairs.gaps)
        if not C or pairs.gaps.item(pairs.gaps.argmin()) >= 0.0:
            return pairs
        n, depths = pairs.normals, -pairs.gaps
        is_deep = pairs.are_rigid & (pairs.gaps < self._deep[self._meeting_of])
        if not is_deep.any():
            return pairs
        a, pressure = (n * pairs.before[:C]).dot(_ONES), (n * found.forces[:C]).dot(_ONES)
        of_meetings = np.zeros((2, len(self._meetings)))
        np.maximum.at(of_meetings[0], self._meeting_of, h * np.abs(a) * (is_deep | (pressure > 0)))
        np.maximum.at(of_meetings[1], self._meeting_of, depths)
        rests = (of_meetings[0] <= RESTS * of_meetings[1]) & (self._dissipated > 0)
        own = np.einsum("ci,cicj,cj->c", n, guide.W[: 3 * C, : 3 * C].reshape(C, 3, C, 3), n)
        out = np.minimum(depths / h, np.maximum(a, 2 * own * pressure))
        return pairs._replace(out=np.where(is_deep & rests[self._meeting_of], np.maximum(out, 0.0), 0.0))

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
            if not is_still(now, placed[number], self._sizes[number]):
                placed[number] = now
        swerves = {number: self._bodies[number].swerve() for number in self._touching} if far else {}
        for number, meeting in enumerate(self._meetings):
            one, other = placed[meeting.first], placed[meeting.second]
            assert one is not None
            assert other is not None
            (whole, beside), (other_whole, other_beside) = travels[meeting.first], travels[meeting.second]
            nearer = 2 * math.hypot(*(whole - other_whole))
            if far:
                (more, beyond), (other_more, other_beyond) = swerves[meeting.first], swerves[meeting.second]
                nearer += 3 * math.hypot(*(more - other_more)) + beyond + other_beyond
                meeting.forget()
            meeting.look(one, other, nearer + beside + other_beside + NEAR * meeting.size)
            if meeting.contacts is not None:
                found.append((number, meeting.contacts))
        return found

    def _gather(self, contacts: list[tuple[int, Contacts]]) -> None:
        """Makes the pairs of these contacts, and takes over the forces of those that were there."""
        features = [(meeting, each) for meeting, seen in self._contacts for each in seen.first.feature.tolist()]
        before = dict(zip(features, zip(self._start, self._swung, strict=False), strict=False))
        rows = [list[tuple[Array, float, Points]]() for _ in self._bodies]
        normals, gaps, places, laws = [np.empty((0, 3))], [np.empty(0)], [np.empty((0, 3))], [np.empty((2, 0))]
        count = 0
        start = []
        for number, found in contacts:
            meeting, k = self._meetings[number], len(found.gaps)
            own = np.arange(count, count + k)
            rows[meeting.first].append((own, 1.0, _points(found.first)))
            both = self._bodies[meeting.first].takes_couples and self._bodies[meeting.second].takes_couples
            rows[meeting.second].append((own, -1.0, _points(found.second, both)))
            normals.append(found.normals)
            gaps.append(found.gaps)
            places.append(found.first.arms)
            laws.append(np.repeat([[meeting.law.restitution], [meeting.law.friction]], k, axis=1))
            start += [before.get((number, feature), (np.zeros(3), 0)) for feature in found.first.feature.tolist()]
            count += k
        for joint in self._joints:
            k = len(joint.points)
            own = np.arange(count, count + k)
            rows[joint.first].append((own, 1.0, joint.on_first))
            rows[joint.second].append((own, -1.0, joint.on_second))
            places.append(joint.points)
            count += k
        e, μ = np.concatenate(laws, axis=1)
        sizes = np.array([meeting.size for meeting in self._meetings])
        self._meeting_of = np.repeat([number for number, _ in contacts], [len(of.gaps) for _, of in contacts]).astype(
            int
        )
        self._none = ROUND_OFF * sizes[self._meeting_of] * self._are_rigid[self._meeting_of]
        parts = [_part(body, mine) for body, mine in zip(self._bodies, rows, strict=True)]
        self._contacts, self._middle_gaps, self._guide = contacts, np.concatenate(gaps), None
        parts = [part for part in parts if len(part.pairs) or not part.body.is_driven]
        soft_first = sorted(parts, key=lambda part: part.points.nodes.shape[1] == 0)
        everywhere = np.concatenate(places)
        self._pairs = Pairs(
            *(tuple(soft_first), everywhere, 0 * everywhere, np.concatenate(normals), self._middle_gaps, μ),
            *(e, self._are_rigid[self._meeting_of], self._yield_at_once[self._meeting_of]),
            *(np.zeros(len(e)), (μ > 0)[:, None] / 2),
        )
        forces = np.array([force for force, _ in start]).reshape(-1, 3)
        self._start = np.concatenate([forces, self._joint_forces])
        self._swung = np.array([swung for _, swung in start], dtype=int)

    def _refresh(self, contacts: list[tuple[int, Contacts]]) -> None:
        """The same pairs as before, where they are now."""
        assert self._pairs is not None
        found = [found for _, found in contacts]
        normals, self._middle_gaps = (np.concatenate([part[k] for part in found]) for k in (2, 3))
        places = np.concatenate([*(part.first.arms for part in found), *(joint.points for joint in self._joints)])
        self._contacts, self._pairs = contacts, self._pairs._replace(normals=normals, places=places)

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
            known = body.known_delassus(points)
            if known is None:
                pose = body.pose
                lie.append((self._pairs.places[rows] - pose.position, pose.rotation))
            else:
                lie.append(known)
        return lie

    def keep(self, found: Found, guide: Guide, h: float) -> None:
        """Takes note of the forces of a step of h s that was taken, and of what guided them."""
        C = len(found.forces) - len(self._joint_forces)
        self._start, self._joint_forces = found.forces, found.forces[C:]
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
        size = len(self._joint_forces)
        u, left, W = np.zeros((size, 3)), np.zeros((size, 3)), np.zeros((size, 3, size, 3))
        stopped, parts = np.ones(size, dtype=bool), list[tuple[Body, Array, Array, Points]]()
        for body, rows, signs, points in self._parts_of_joints():
            own = body.inverse_mass(points)
            if own is None:
                stopped[rows] = False
                continue
            parts.append((body, rows, signs, points))
            u[rows] += signs * body.end_velocities(points)
            W[_block(rows)] += signs[:, :, None, None] * own.reshape(len(rows), 3, len(rows), 3) * signs[:, 0][:, None]
        u[~stopped] = W[~stopped] = W[:, :, ~stopped] = 0.0
        if not u.any():
            return 0.0
        W = W.reshape(3 * size, 3 * size)
        impulses = -np.linalg.lstsq(W, u.ravel(), rcond=1e-12)[0].reshape(-1, 3)
        for body, rows, signs, points in parts:
            body.kick(points, signs * impulses[rows])
            left[rows] += signs * body.end_velocities(points)
        return -float(impulses.ravel().dot((u + left).ravel())) / 2

    def _parts_of_joints(self) -> list[tuple[Body, Array, Array, Points]]:
        """Of each body that joints hold: which of their points, its signs, and where they are on it."""
        assert self._pairs is not None
        if self._held[0] is not self._pairs.parts:
            C, found = len(self._pairs.normals), []
            for body, rows, _, signs, _, points in self._pairs.parts:
                held = (rows >= C).nonzero()[0]
                if len(held):
                    kept = points._replace(
                        nodes=points.nodes[held],
                        weights=points.weights[held],
                        follows=points.follows[held],
                        couples=np.searchsorted(held, points.couples),
                    )
                    found.append((body, rows[held] - C, signs[held], kept))
            self._held = self._pairs.parts, found
        return self._held[1]

    def force_between(self, first: int, second: int, forces: Array) -> Array:
        """Of a step on the first, (3,), N."""
        force, row = np.zeros(3), 0
        for number, contacts in self._contacts:
            force += _sign(self._meetings[number], first, second) * forces[row : row + len(contacts.gaps)].sum(axis=0)
            row += len(contacts.gaps)
        for joint in self._joints:
            force += _sign(joint, first, second) * forces[row : row + len(joint.points)][joint.are_forces].sum(axis=0)
            row += len(joint.points)
        return force

    def of_joint(self, joint: JointPoints, values: Array) -> Array:
        """Of values (C + J, 3) of all pairs those of the points of a joint that holds, (k, 3)."""
        number = next(k for k, each in enumerate(self._joints) if each is joint)
        start = len(values) - sum(len(each.points) for each in self._joints[number:])
        return values[start : start + len(joint.points)].copy()

    def touching(self, forces: Array) -> int:
        """How many pairs of points push, by more than round-off."""
        if self._pairs is None or not len(self._pairs.normals):
            return 0
        pressure = (forces[: len(self._pairs.normals)] * self._pairs.normals).sum(axis=1)
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
    return a is b or (a.shape == b.shape and bool((a == b).all()))


def _lies_as(now: Array | tuple[Array, Array], then: Array | tuple[Array, Array]) -> bool:
    """Whether the operator of a body, or its arms and rotation, are those of before."""
    if not (isinstance(now, tuple) and isinstance(then, tuple)):
        return now is then
    (arms, rotation), (arms_then, rotation_then) = now, then
    if np.abs(rotation - rotation_then).max() > GUIDES:
        return False
    return bool(np.abs(arms - arms_then).max() <= GUIDES * np.abs(arms_then).max())


def _points(spots: Spots, follows: bool = False) -> Points:
    return Points(spots.nodes, spots.weights, np.empty((0, 3)), np.full(len(spots.arms), follows))


def _part(body: Body, mine: list[tuple[Array, float, Points]]) -> Part:
    if not mine:
        none = Points(np.empty((0, 0), int), np.empty((0, 0)), np.empty((0, 3)), np.empty(0, bool))
        return Part(body, np.empty(0, int), slice(0, 0), np.empty((0, 1)), True, none)
    pairs = np.concatenate([pairs for pairs, _, _ in mine])
    signs = np.concatenate([np.full((len(own), 1), sign) for own, sign, _ in mine])
    points = _concatenated([points for _, _, points in mine])
    first, last = int(pairs[0]), int(pairs[-1])
    in_one_piece = last - first == len(pairs) - 1
    return Part(
        body, pairs, slice(first, last + 1) if in_one_piece else pairs, signs, bool((signs == signs[0]).all()), points
    )


def _concatenated(points: list[Points]) -> Points:
    """Points of a body in several meetings and joints."""
    wide = max(part.nodes.shape[1] for part in points)
    starts = np.cumsum([0, *(len(part.nodes) for part in points)])
    nodes, weights, arms, follows, _ = (
        list(rows) for rows in zip(*(_widened(part, wide) for part in points), strict=True)
    )
    couples = [part.couples + start for part, start in zip(points, starts[:-1], strict=True)]
    return Points(*map(np.concatenate, (nodes, weights, arms, follows, couples)))


def _widened(points: Points, wide: int) -> Points:
    """The same with so many nodes to a point, some of them without weight."""
    more = ((0, 0), (0, wide - points.nodes.shape[1]))
    if not more[1][1]:
        return points
    return points._replace(nodes=np.pad(points.nodes, more, mode="edge"), weights=np.pad(points.weights, more))


def _block(rows: Array) -> tuple[Array, Array, Array, Array]:
    return rows[:, None, None, None], np.arange(3)[:, None, None], rows[:, None], np.arange(3)


def _sign(of: Meeting | JointPoints, first: int, second: int) -> float:
    """1 where the first of a pair is asked for, -1 where the second is, 0 where neither."""
    return float((of.first, of.second) == (first, second)) - float((of.second, of.first) == (first, second))
