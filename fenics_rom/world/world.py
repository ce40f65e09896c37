"""Several bodies in one step, rigid and soft, in contact and joined, and an energy account of each and of the whole."""

import math
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from itertools import combinations
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.arguments import mapping_in
from fenics_rom.errors import SceneError, StepError, check_known, shown
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.contact import LEAST_TOLD, ContactLaw
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.rom.midpoint_map import checked_dt
from fenics_rom.world.contact_step import Found, Guide, Pairs, find_forces
from fenics_rom.world.joints import Joint, JointPoints, SurfaceJoint
from fenics_rom.world.make_bodies import FIXED, AnyBody, make_bodies
from fenics_rom.world.meetings import Meeting, check_apart
from fenics_rom.world.records import RigidBody, SoftBody
from fenics_rom.world.shapes import passing_radius
from fenics_rom.world.soft import Soft
from fenics_rom.world.step_pairs import StepPairs

_ONES = np.ones(3)
LONGEST_TO_SHORTEST = 1000  # of steps that are looked at where one of a world is refused


class World:
    """Bodies that touch and hold one another.

    Args:
        bodies: by name. Rigid ones with a `motion` move as it says, the ground for example.
        dt: time step, s.
        joints: points of bodies that stay together, surfaces of soft ones that are held; "world" is what stands still.
            Bodies that are joined do not touch.
        gravity: on rigid bodies, m/s²; soft ones have that of their scene.
        friction, restitution: of all bodies.
        pairs: other laws of two bodies, by their names.
        apart: groups of names of bodies without contact between them: they pass through one another.

    Attributes:
        bodies, gravity: as given.

    Raises:
        SceneError: names that nobody has, bodies that cannot be, joints that cannot be closed, two laws of a pair, or
            one of bodies that do not touch.
        StepError: bodies begin inside each other.

    Example:
        >>> from fenics_rom.world.shapes import Box, HalfSpace
        >>> lies = fr.BaseState(np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))
        >>> bodies = {"ground": fr.RigidBody(HalfSpace(), motion=lies)}
        >>> bodies["box"] = fr.RigidBody(Box((0.1, 0.1, 0.1)), mass=1.0, position=(0, 0, 0.05))
        >>> world = fr.World(bodies, dt=2e-3, gravity=(0, 0, -10.0), friction=0.5)
        >>> world.step()
        >>> print(f"{world.force_between('box', 'ground')[2]:.3f} N")
        10.000 N
    """

    def __init__(
        self,
        bodies: Mapping[str, RigidBody | SoftBody],
        dt: float,
        *,
        joints: Sequence[Joint | SurfaceJoint] = (),
        gravity: Sequence[float] = (0.0, 0.0, 0.0),
        friction: float = 0.0,
        restitution: float = 0.0,
        pairs: Mapping[tuple[str, str], ContactLaw] | None = None,
        apart: Sequence[Collection[str]] = (),
    ):
        self.bodies, self.gravity, self._dt = mapping_in("bodies", bodies, SceneError), gravity, checked_dt(dt)
        if not isinstance(joints, list | tuple) or not all(isinstance(each, Joint | SurfaceJoint) for each in joints):
            raise SceneError(f"joints = {shown(joints)}: allowed is a list of Joints and SurfaceJoints")
        self._arguments: dict[str, Any] = {
            "joints": joints,
            "gravity": gravity,
            "friction": friction,
            "restitution": restitution,
            "pairs": pairs,
            "apart": apart,
        }
        self._steps, self._time = 0, 0.0
        joined = any(FIXED in (joint.first, joint.second) for joint in joints)
        self._bodies = make_bodies(self.bodies, self._dt, gravity, joined)
        if not joined:
            del self._bodies[FIXED]
        self._names = list(self._bodies)
        law, laws = ContactLaw(restitution, friction), _laws(pairs or {}, self._bodies)
        separate = _pairs_apart(apart, joints, self._bodies)
        for group in apart:
            if both := [pair for pair in laws if pair <= set(group)]:
                names = " and ".join(sorted(both[0]))
                raise SceneError(f"pairs: {names}: have no contact, as `apart` says: allowed is one of both")
        self._meetings = [
            Meeting(a, b, laws.get(frozenset((self._names[a], self._names[b])), law), self._smaller(a, b))
            for a, b in combinations(range(len(self._names)), 2)
            if self._may_touch(a, b) and frozenset((self._names[a], self._names[b])) not in separate
        ]
        self._joints = [JointPoints(joint, self._bodies) for joint in joints]
        self._met = EnergyLedger()  # what contacts and joints dissipate
        everyone = list(self._bodies.values())
        self._soft = [body for body in everyone if isinstance(body, Soft)]
        self._lone = everyone[0] if len(everyone) == 1 and isinstance(everyone[0], Soft) else None
        if self._lone is not None:
            self._lone_step, self._lone_name = self._lone.step, self._lone.name
            self.step = self._step_alone  # type: ignore[method-assign]
        if self._meetings:
            check_apart(everyone, self._names, self._meetings)
        of_soft = {body: self._met_by(body) for body in self._soft}
        said = {body.name: body.describe_passing(radii) for body, radii in of_soft.items() if radii}
        self._passing = [f"{name}: {text}" for name, text in said.items() if text]
        self._step_pairs = StepPairs([] if self._lone else everyone, self._meetings, self._joints)
        self._found = Found(np.empty((0, 3)), np.empty((0, 3)), 0, 0.0)
        self._residuals = 0, 0.0
        if joints:
            _, forces, _ = self._begin({})
            self._found = self._found._replace(forces=0.0 * forces)
            self._met.book(dissipated=self._step_pairs.stop_joints())

    def _may_touch(self, a: int, b: int) -> bool:
        first, second = (self._bodies[self._names[number]] for number in (a, b))
        return FIXED not in (self._names[a], self._names[b]) and not (first.is_driven and second.is_driven)

    def _met_by(self, body: Soft) -> dict[str, float]:
        """Radii, m, by name, of the rigid bodies that a soft one may meet."""
        pairs = [{self._names[meeting.first], self._names[meeting.second]} for meeting in self._meetings]
        others = {name for pair in pairs if body.name in pair for name in pair}
        rigid = {name: record for name, record in self.bodies.items() if name in others}
        return {name: passing_radius(record.shape) for name, record in rigid.items() if isinstance(record, RigidBody)}

    def _smaller(self, a: int, b: int) -> float:
        return min(self._bodies[self._names[number]].size for number in (a, b))

    @property
    def dt(self) -> float:
        """Time step, s."""
        return self._dt

    @dt.setter
    def dt(self, dt: float) -> None:
        self._dt = checked_dt(dt)
        for body in self._bodies.values():
            if isinstance(body, Soft):
                body.dt = self._dt

    @property
    def names(self) -> tuple[str, ...]:
        """Of the bodies."""
        return tuple(self.bodies)

    def pose(self, name: str) -> BaseState:
        """Where a body is and how it moves, in world axes: its centre of mass, or the frame of a soft body."""
        return self._body(name).pose

    def velocity(self, name: str) -> tuple[Array, Array]:
        """Velocity (3,), m/s, and angular velocity (3,), rad/s, of a body, or of the frame of a soft one."""
        pose = self._body(name).pose
        return pose.velocity, pose.angular_velocity

    def simulator(self, name: str) -> Soft:
        """A soft body's: displacements, readings, switching; it is stepped by the world alone."""
        body = self._body(name)
        if not isinstance(body, Soft):
            raise StepError(f"body {name!r} is rigid: allowed is a soft one")
        return body

    def account(self, name: str) -> EnergyLedger:
        """Of a body: of what was supplied to it, `obstacles` is what other bodies did."""
        return self._body(name).account

    def energy_of(self, name: str) -> float:
        """Of a body, J: kinetic and elastic."""
        return self._body(name).energy

    @property
    def energy(self) -> float:
        """Of all bodies, J: kinetic and elastic."""
        return math.fsum(body.energy for body in self._bodies.values())

    @property
    def ledger(self) -> EnergyLedger:
        """The account of the whole: by loads and drivers supplied; in bodies, contacts and joints dissipated."""
        whole = EnergyLedger()
        accounts = [body.account.sums for body in self._bodies.values()]
        for sums in accounts:
            whole.book(supplied=math.fsum((*sums[0], -sums[4][0], -sums[4][1])), dissipated=sum(sums[1]))
            whole.book(lost_in_switching=sum(sums[2]), numerical=sum(sums[3]))
        by_contact, by_friction = sum(self._met.sums[5]), sum(self._met.sums[6])
        whole.book(dissipated=sum(self._met.sums[1]), numerical=sum(self._met.sums[3]))
        whole.book_parts(0.0, by_contact, by_friction)
        return whole

    def force_between(self, first: str, second: str) -> Array:
        """Force of the second body on the first in the last step, by contact and joints, (3,), N."""
        for name in (first, second):
            self._body(name)
        return self._step_pairs.force_between(self._names.index(first), self._names.index(second), self._found.forces)

    def joint_forces(self, number: int) -> Array:
        """Forces at the points of a joint on its first body in the last step, (k, 3), N.

        Of a rigid surface that is welded the force on it, N, and the couple about its middle, N m, (2, 3).
        """
        return self._step_pairs.forces_of_joint(number, self._found.forces)

    @property
    def touching(self) -> int:
        """Number of pairs of points that push in the last step."""
        return self._step_pairs.touching(self._found.forces)

    @property
    def sweeps(self) -> int:
        """That the last step took."""
        return self._found.sweeps

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the user should know of the run so far."""
        steps, residual = self._residuals
        soft = {name: body for name, body in self._bodies.items() if isinstance(body, Soft)}
        said = [*self._passing, *(f"{name}: {text}" for name, body in soft.items() for text in body.warnings)]
        if residual >= LEAST_TOLD:
            said.append(
                f"in {steps} steps contact forces were not found exactly: the worst leave {residual:.0e} of the "
                "velocities that they stop; a smaller dt or less friction may help"
            )
        return tuple(said)

    def drive(self, name: str, motion: Any) -> None:
        """Moves a rigid body that has a `motion` by another one, from the next step on."""
        body = self._body(name)
        if not body.is_driven:
            raise StepError(f"body {name!r} moves freely: allowed is one that has a motion")
        body.follow(motion)  # type: ignore[union-attr]

    def step(self, inputs: Mapping[str, Mapping[str, Any]] | None = None) -> None:
        """Advances by dt.

        Args:
            inputs: by body, by name; what is not named is 0. Of a soft body as of a Simulator; of a rigid one that
                moves freely `force` (3,), N, and `torque` (3,) about its centre of mass, N m, in world axes.

        Raises:
            StepError: no such body or input, or no forces were found; everything is as it was.
        """
        h, bodies = self._dt, self._bodies
        if inputs:
            self._check_inputs(inputs)
        try:
            pairs, found, guide = self._find(inputs or {})
            for soft in self._soft:
                soft.close()
        except BaseException as error:
            for body in bodies.values():
                body.undo()
            if isinstance(error, StepError) and (shorter := self._step_that_would_do(inputs or {})):
                raise StepError(f"{error}; steps of {shorter:.3g} s would do") from error
            raise
        for body in bodies.values():
            body.commit()
        self._step_pairs.keep(found, guide, h)
        self._found = found
        self._book(pairs, found)
        if self._joints:
            self._met.book(dissipated=self._step_pairs.stop_joints())
        if found.residual:
            self._residuals = self._residuals[0] + 1, max(self._residuals[1], found.residual)
        self._steps, self._time = self._steps + 1, self._time + h

    def _find(self, inputs: Mapping[str, Mapping[str, Any]]) -> tuple[Pairs, Found, Guide]:
        """Opens a step, and finds its forces; all bodies have tried them last."""
        h, known = self._dt, self._step_pairs
        pairs, start, guide = self._begin(inputs)
        found, guide = find_forces(pairs, h, start, guide)
        for _ in self.bodies:  # each may hit the next
            if not known.lacks_pairs(pairs, found, h):
                break
            more, start, guided = self._pairs_of_step(far=True)
            if more.parts is pairs.parts:
                break
            pairs = more
            found, guide = find_forces(pairs, h, start, guided)
        if (deep := known.let_out(pairs, found, guide, h)) is not pairs:
            found, guide = find_forces(deep, h, found.forces, guide)
            if known.overdraws(found, h):
                found, guide = find_forces(pairs, h, start, guide)
        return pairs, found, guide

    def _step_that_would_do(self, inputs: Mapping[str, Mapping[str, Any]]) -> float | None:
        """The longest of shorter steps, s, in which forces are found; None where that is not looked for."""
        dt, self._dt = self._dt, self._dt / 2
        try:
            while not self._soft and self._dt > dt / LONGEST_TO_SHORTEST:
                with suppress(StepError):
                    self._find(inputs)
                    return self._dt
                self._dt /= 2
            return None
        finally:
            self._dt = dt

    def _step_alone(self, inputs: Mapping[str, Any] | None = None) -> None:
        """`step` of a world that has one soft body: it costs little more than that of its simulator."""
        given = inputs.get(self._lone_name) if inputs else None
        if given is None or (inputs and len(inputs) > 1):
            for name in inputs or ():
                self.simulator(name)
            given = np.zeros(self._soft[0].inputs) if given is None else given
        self._lone_step(given)

    def anew(self) -> "World":
        """Another world of the same bodies where they begin, moved as they were at first, in steps of now."""
        return World(self.bodies, self._dt, **self._arguments)

    @property
    def steps(self) -> int:
        """Number of steps taken."""
        return self._steps if self._lone is None else self._lone.steps

    @property
    def time(self) -> float:
        """Simulated, s."""
        return self._time if self._lone is None else self._lone.time

    def _begin(self, inputs: Mapping[str, Mapping[str, Any]]) -> tuple[Pairs, Array, Guide | None]:
        """Opens a step of all bodies; its pairs, forces to begin with, and what may guide."""
        for name, body in self._bodies.items():
            try:
                body.take(inputs.get(name, {}))
                body.begin(self._dt)
            except StepError as error:
                raise StepError(f"body {name!r}: {error}") from error
        return self._pairs_of_step()

    def _pairs_of_step(self, far: bool = False) -> tuple[Pairs, Array, Guide | None]:
        pairs, start, guide = self._step_pairs.of_step(self._dt, far)
        for part in pairs.parts:
            if isinstance(part.body, Soft):
                part.body.note_gaps(part.points, pairs.gaps[part.pairs[part.pairs < len(pairs.gaps)]])
        return pairs, start, guide

    def _check_inputs(self, inputs: Mapping[str, Any]) -> None:
        for name in inputs:
            self._body(name)
            if not isinstance(given := inputs[name], Mapping):
                raise StepError(f"body {name!r}: allowed are inputs by name, a mapping; given: {shown(given)}")

    def _book(self, pairs: Pairs, found: Found) -> None:
        C, n = len(pairs.normals), pairs.normals
        if self._joints:  # what they did where forces were found but for a residual
            work = float(found.forces[C:].ravel().dot(found.velocities[C:].ravel()))
            self._met.book(numerical=-self._dt * work)
        f, u = found.forces[:C], found.velocities[:C]
        whole = float(f.ravel().dot(u.ravel()))
        normal = float((n * f).dot(_ONES).dot((n * u).dot(_ONES)))
        self._met.book_contact(0.0, -self._dt * normal, self._dt * (normal - whole), 0.0)

    def _body(self, name: str) -> AnyBody:
        check_known("body", name, self.bodies, StepError)
        return self._bodies[name]

    def __repr__(self) -> str:
        soft = [name for name, body in self.bodies.items() if isinstance(body, SoftBody)]
        driven = [name for name, body in self._bodies.items() if body.is_driven and name != FIXED]
        free = [name for name in self.bodies if name not in soft and name not in driven]
        kinds = {"soft": soft, "rigid": free, "driven": driven}
        parts = "; ".join(f"{kind}: {', '.join(some)}" for kind, some in kinds.items() if some)
        return f"World of {len(self.bodies)} bodies, dt = {self._dt:g} s, {self.steps} steps taken\n  {parts}"


def _laws(
    pairs: Mapping[tuple[str, str], ContactLaw], bodies: Mapping[str, AnyBody]
) -> dict[frozenset[str], ContactLaw]:
    laws: dict[frozenset[str], ContactLaw] = {}
    for pair, law in pairs.items():
        for name in pair:
            check_known("body", name, bodies, SceneError, "pairs: ")
        if law.stiffness is not None:
            raise SceneError(f"pairs: {pair}: allowed between bodies is a law without stiffness, 'complementarity'")
        if frozenset(pair) in laws:
            raise SceneError(f"pairs: {' and '.join(pair)}: are named twice: allowed is one law of two bodies")
        if all(bodies[name].is_driven for name in pair):
            raise SceneError(f"pairs: {' and '.join(pair)}: both move as they are told, and do not push one another")
        laws[frozenset(pair)] = law
    return laws


def _pairs_apart(
    apart: Sequence[Collection[str]], joints: Sequence[Joint | SurfaceJoint], bodies: Collection[str]
) -> set[frozenset[str]]:
    for group in apart:
        for name in group:
            check_known("body", name, bodies, SceneError, "apart: ")
    separate = {frozenset(pair) for group in apart for pair in combinations(group, 2)}
    return separate | {frozenset((joint.first, joint.second)) for joint in joints}
