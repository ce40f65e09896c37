"""Joints as rows: what is held, or driven, of the relative motion of pairs, as their bodies go in a step.

A row has a direction d in the velocities of the pairs of joints, a force z along it, and the speed s = d·u. Its bodies
get z d, so that z s is its power. Directions are those of the step itself, as it was tried last:

    point       each axis; s is how the second body's point goes from the first one's
    slide       R̄ e of the first body, R̄ = (R + R⁺)/2, where the point of the second one is: that goes by h s along e
    turn        each axis of ω̂, or of a hinge ā/(|ā|² ρ), ā = R̄ e: the joint turns by h s

With w = h ω̂ of the first body and c ā of the second from it, ρ = X y/atan y, X = 1 + w²/4 + c w·ā/4, y = c/2X (Cayley).
So joints do not drift, and a position is the sum of what it went by.

A row is held, s + compliance z = speed, or has a force that is known, as the piece of its law says (`drives.py`).
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.mechanics.frame_geometry import crossed, vector
from fenics_rom.world.bodies import Body, Part, PointsOfRigid
from fenics_rom.world.drive_law import motor_force
from fenics_rom.world.drives import Drive, Piece, State, law_of, piece_at
from fenics_rom.world.joints import JointPoints
from fenics_rom.world.tolerances import MISSES, MOST_CHANGES
from fenics_rom.world.turning import turning_along


class FramedRows(NamedTuple):
    """Rows of a pair whose directions turn with the bodies."""

    rows: list[int]
    axes: Array  # (k, 3) in the axes of the first body
    turns: bool  # whether the pair is how the bodies turn
    pair: int
    first: PointsOfRigid
    second: PointsOfRigid
    arm: Array  # (3,) of the pair on the second one, in its axes, m


class Together(NamedTuple):
    """Rows of the points of a joint, no more than it holds."""

    rows: Array
    directions: Array  # (r, k, 3) of k points, in the axes of the first body
    pairs: Array
    first: PointsOfRigid


class Island(NamedTuple):
    """Rows that move one another, by joints alone, and the columns of their pairs."""

    rows: Array
    columns: Array


class DrivenRow(NamedTuple):
    """A row that a drive acts along."""

    name: str
    row: int
    pair: int
    joint: JointPoints
    drive: Drive


class JointRows:
    """The rows of joints that hold.

    Args:
        joints: by name.
        pairs: of each, where its pairs are among all J of joints.
        bodies: by number.

    Attributes:
        D: (m, 3J) directions.
        held: (m,) whether a row is, and
        compliance, speed: (m,) of those that are.
        known: (m,) forces of those that are not, else 0.
        z: (m,) forces in the last try.
        islands: rows that move one another, by joints alone.
        fixed, framed, together, driven, following: rows along axes of the world, and their columns; along axes that
            turn with bodies; of points of a joint; those that drives act along; those by which these go with others.
    """

    def __init__(self, joints: Mapping[str, JointPoints], pairs: Mapping[JointPoints, slice], bodies: Sequence[Any]):
        self.framed, self.driven, row = list[FramedRows](), list[DrivenRow](), 0
        self.fixed = list[tuple[int, int]]()
        of_row, self.together = list[JointPoints](), list[Together]()
        for name, joint in joints.items():
            both = bodies[joint.first], bodies[joint.second]
            points = np.flatnonzero(joint.are_forces & ~np.isin(np.arange(len(joint.points)), list(joint.axes)))
            together = joint.is_rigid and len(points) > 1
            if together:
                basis = _independent(joint.on_first.arms[points])
                self.together.append(
                    Together(np.arange(row, row + len(basis)), basis, pairs[joint].start + points, both[0])
                )
                row += len(basis)
                of_row += [joint] * len(basis)
            for k, pair in enumerate(range(pairs[joint].start, pairs[joint].stop)):
                axes, begin = joint.axes.get(k), row
                if together and k in points:
                    continue
                if axes is None:
                    self.fixed += [(row + axis, 3 * pair + axis) for axis in range(3)]
                    row += 3
                else:
                    row += len(axes)
                    self.framed.append(
                        FramedRows(
                            list(range(begin, row)),
                            axes,
                            k in joint.on_first.couples,
                            pair,
                            *both,
                            joint.on_second.arms[k],
                        )
                    )
                    if joint.drive is not None:
                        self.driven.append(DrivenRow(name, row - 1, pair, joint, joint.drive))
                of_row += [joint] * (row - begin)
        by_name, groups = {each.name: each for each in self.driven}, _groups(joints.values(), bodies)
        self.following = list[tuple[int, DrivenRow, DrivenRow, float]]()
        for each in self.driven:
            if each.drive.follows is not None and each.drive.follows[0] in by_name:
                self.following.append((row, each, by_name[each.drive.follows[0]], each.drive.follows[1]))
                row += 1
        of_group = [groups[joint] for joint in of_row]
        for _, each, leader, _ in self.following:
            mine, other = groups[each.joint], groups[leader.joint]
            of_group = [mine if group == other else group for group in [*of_group, mine]]
            groups = {joint: mine if group == other else group for joint, group in groups.items()}
        self.D, self.held = np.zeros((row, 3 * sum(of.stop - of.start for of in pairs.values()))), np.ones(row, bool)
        for of, column in self.fixed:
            self.D[of, column] = 1.0
        self.compliance, self.speed, self.known, self.z = np.zeros((4, row))
        self.islands = list[Island]()
        for group in sorted(set(of_group)):
            own = [range(pairs[each].start, pairs[each].stop) for each in joints.values() if groups[each] == group]
            columns = 3 * np.concatenate([*map(np.array, own)])[:, None] + np.arange(3)
            self.islands.append(Island(np.flatnonzero(np.array(of_group) == group), columns.ravel()))
        self._laws, self._on, self._changes = dict[int, list[Piece]](), dict[int, int](), 0
        self.h = 0.0

    @property
    def is_driven(self) -> bool:
        """Whether a drive acts along any."""
        return bool(self.driven)

    def begin(self, h: float, before: Array) -> None:
        """Begins a step of h s; before: u (J, 3) of the pairs then, m/s."""
        self.h, self._changes = h, 0
        self._direct(begins=True)
        speeds = self.D.dot(before.ravel())
        for each in self.driven:
            law = law_of(each.drive, each.joint.state, float(speeds[each.row]), h)
            known = self._laws.get(each.row, [])
            if len(law) != len(known):
                self._on[each.row] = piece_at(law, float(speeds[each.row]))
            self._laws[each.row] = law
            self._set(each.row)

    def expect(self, places: Array, h: float) -> None:
        """Sets where sliding points are expected among places (J, 3) of the pairs."""
        for each in self.framed:
            if not each.turns:
                places[each.pair] = each.second.expected_place(each.arm, h)

    def meet(self, parts: Sequence[Part]) -> None:
        """Has first bodies be held where sliding points are now; parts: the bodies with all points of joints."""
        for each in self.framed:
            if not each.turns:
                (part,) = (part for part in parts if part.body is each.first)
                pose, first = each.second.pose, each.first.pose
                place = pose.position + each.second.tried_turn(True)[1].dot(each.arm)
                row = np.flatnonzero((part.pairs == each.pair) & (part.signs[:, 0] > 0))
                part.points.arms[row] = each.first.tried_turn(True)[1].T.dot(place - first.position)

    def look(self) -> float:
        """Has directions be those of the last try: by how much that changes one of them, at most."""
        return self._direct()

    def _direct(self, begins: bool = False) -> float:
        changed = 0.0
        if begins:
            for held, basis, of, body in self.together:
                directions = basis.dot(body.tried_turn(True)[1].T)
                for k, pair in enumerate(of.tolist()):
                    self.D[held, 3 * pair : 3 * pair + 3] = directions[:, k]
        for rows, axes, turns, pair, first, second, _ in self.framed:
            turn, R = first.tried_turn(begins)
            along = axes.dot(R.T)
            if turns:
                turns_by = vector(turn), vector(second.tried_turn(begins)[0])
                along = np.array([turning_along(vector(along[0]), *turns_by)])
            changed = max(changed, float(np.abs(self.D[rows, 3 * pair : 3 * pair + 3] + along).max()))
            self.D[rows, 3 * pair : 3 * pair + 3] = -along
        for row, each, leader, ratio in self.following:
            self.D[row] = self.D[each.row] - ratio * self.D[leader.row]
        return changed

    def _set(self, row: int) -> None:
        """Has a row be on a piece of its law."""
        piece = self._laws[row][self._on[row]]
        self.held[row] = piece.is_steep or piece.slope > 0
        self.compliance[row] = self.speed[row] = self.known[row] = 0.0
        if piece.is_steep:
            self.speed[row] = piece.speeds[0]
        elif piece.slope > 0:
            self.compliance[row], self.speed[row] = 1 / piece.slope, piece.force / piece.slope
        else:
            self.known[row] = piece.force

    def settle(self, u: Array, z: Array) -> bool:
        """Whether all rows are on the pieces where velocities u (J, 3) and forces z (m,) are; else goes to others."""
        s, self.z = self.D.dot(u.ravel()), z
        fastest, largest, fits = MISSES * np.abs(u).max(initial=0.0), MISSES * np.abs(z).max(initial=0.0), True
        for each in self.driven:
            row, on = each.row, self._on[each.row]
            piece, to = self._laws[row][on], on
            if piece.is_steep:
                to = on - (z[row] > piece.forces[0] + largest) + (z[row] < piece.forces[1] - largest)
            else:
                to = on - (s[row] < piece.speeds[0] - fastest) + (s[row] > piece.speeds[1] + fastest)
            if to == on:
                continue
            self._changes += 1
            if self._changes > MOST_CHANGES * (1 + len(self.driven)):
                raise StepError(f"joint {each.name!r}: its friction or limits were not found; a smaller dt is the cure")
            self._on[row], fits = int(to), False
            self._set(row)
            if self._changes > MOST_CHANGES * len(self.driven) / 2:
                break
        return fits

    def forces(self, z: Array) -> Array:
        """On the first bodies at the pairs, (J, 3), of forces z (m,)."""
        forces: Array = z.dot(self.D).reshape(-1, 3)
        return forces

    def take_targets(self, targets: Mapping[str, float]) -> None:
        """Of motors in the next step, by name; of others 0."""
        for each in self.driven:
            each.joint.state = each.joint.state._replace(target=targets.get(each.name, 0.0))

    @property
    def energy(self) -> float:
        """Of rotors and springs, J."""
        return math.fsum(each.drive.energy(each.joint.state) for each in self.driven)

    def end(self, u: Array, ledger: EnergyLedger) -> None:
        """Ends the step, with velocities u (J, 3), and books it."""
        h, s = self.h, self.D.dot(u.ravel())
        for each in self.driven:
            speed, z, state = float(s[each.row]), float(self.z[each.row]), each.joint.state
            by_motor = motor_force(each.drive.numbers, state, h, speed)
            rotor = 2 * speed - state.rotor if each.drive.armature else 0.0
            ended = State(state.position + h * speed, speed, rotor, state.target, by_motor, z)
            stored = each.drive.energy(ended) - each.drive.energy(state)
            ledger.book(supplied=h * by_motor * speed, dissipated=h * (by_motor - z) * speed - stored)
            ledger.book(numerical=h * z * speed)  # of what all pairs do
            each.joint.state = ended

    def stop(self, W: Array, u: Array, stopped: Array) -> tuple[Array, float]:
        """Impulses (J, 3), N s, that take from velocities u (J, 3) what joints do not let go, and what rotors lose, J.

        W: velocities per impulse, (3J, 3J); stopped: which of them are, (J, 3).
        """
        self._direct(begins=True)
        rotors = {each.row: each for each in self.driven if each.drive.armature}
        held, target, slack = np.ones(len(self.D), dtype=bool), np.zeros(len(self.D)), np.zeros(len(self.D))
        for each in self.driven:
            hits = self._is_at_limit(each.row)
            held[each.row] = hits or each.row in rotors
            if each.row in rotors and not hits:
                target[each.row], slack[each.row] = each.joint.state.rotor, 1 / each.drive.armature
        held &= ~(np.abs(self.D).dot(~stopped.ravel()) > 0)
        impulses, lost = np.zeros(len(self.D)), 0.0
        for rows, columns in self.islands:
            some = rows[held[rows]]
            D = self.D[np.ix_(some, columns)]
            own = D.dot(W[np.ix_(columns, columns)]).dot(D.T) + np.diag(slack[some])
            impulses[some] = scaled_pinv(own, 1e-12).dot(target[some] - D.dot(u.ravel()[columns]))
        for row, each in rotors.items():
            before = each.drive.energy(each.joint.state)
            rotor = each.joint.state.rotor - impulses[row] / each.drive.armature if slack[row] else 0.0
            each.joint.state = each.joint.state._replace(rotor=float(rotor))
            lost += before - each.drive.energy(each.joint.state)
        return impulses.dot(self.D).reshape(-1, 3), lost

    def _is_at_limit(self, row: int) -> bool:
        """Whether a limit stopped it in the last step."""
        piece = self._laws[row][self._on[row]] if row in self._laws else None
        return piece is not None and piece.is_steep and math.inf in np.abs(piece.forces)


def _independent(arms: Array) -> Array:
    """Directions (r, k, 3), of length 1 together, along which points (k, 3) of a rigid body can move at all."""
    apart = arms - arms.mean(axis=0)
    size = float(np.abs(apart).max(initial=0.0))
    moved = np.zeros((len(arms), 3, 6))
    moved[:, :, :3], moved[:, :, 3:] = np.eye(3), crossed(apart / size if size else apart)
    directions, values, _ = np.linalg.svd(moved.reshape(-1, 6), full_matrices=False)
    return directions[:, values > 1e-9 * values[0]].T.reshape(-1, len(arms), 3)


def scaled_pinv(matrix: Array, rcond: float) -> Array:
    """Pseudo-inverse of a matrix (n, n) whose rows have other units; rcond: what is none, of the largest."""
    scale = 1 / np.sqrt(np.maximum(matrix.diagonal(), 1e-300))
    inverse: Array = scale[:, None] * np.linalg.pinv(scale[:, None] * matrix * scale, rcond=rcond) * scale
    return inverse


def _groups(joints: Iterable[JointPoints], bodies: Sequence[Body]) -> dict[JointPoints, int]:
    """A number of what each joint moves; those have the same that move one another."""
    group = list(range(len(bodies)))

    def of(body: int) -> int:
        while group[body] != body:
            body = group[body]
        return body

    moved = dict[JointPoints, int]()
    for joint in joints:
        free = [number for number in (joint.first, joint.second) if not bodies[number].is_driven]
        moved[joint] = free[0]
        group[of(free[0])] = of(free[-1])
    return {joint: of(body) for joint, body in moved.items()}
