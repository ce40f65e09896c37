"""Several bodies in one step, rigid and soft, in contact and joined, and an energy account of each and of the whole."""

import math
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from copy import copy
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.arguments import mapping_in
from fenics_rom.compilation import compiled
from fenics_rom.errors import SceneError, StepError, shown
from fenics_rom.mechanics.contact import ContactLaw
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.rom.midpoint_map import checked_dt
from fenics_rom.world.contact_step import Found, Pairs, find_forces
from fenics_rom.world.driven import Driven
from fenics_rom.world.fast_motion import fast_pairs
from fenics_rom.world.guide import Guide
from fenics_rom.world.joined_world import JoinedWorld
from fenics_rom.world.joint_plan import JointPlan
from fenics_rom.world.joints import AnyJoint
from fenics_rom.world.make_bodies import FIXED, make_bodies
from fenics_rom.world.meetings import check_apart, make_meetings
from fenics_rom.world.records import RigidBody, SoftBody
from fenics_rom.world.shapes import passing_radius
from fenics_rom.world.skins import WorldSkins
from fenics_rom.world.soft import Soft
from fenics_rom.world.step_count import checked_count, next_time
from fenics_rom.world.step_pairs import StepPairs

if TYPE_CHECKING:
    from fenics_rom.world.compiled_world import CompiledWorld

_ONES = np.ones(3)
STAYS = 4  # steps in another contact mode, after which compiled steps are made for it
LONGEST_TO_SHORTEST = 1000  # of steps that are looked at where one of a world is refused


class World(JoinedWorld):
    """Bodies that touch and hold one another.

    Args:
        bodies: by name. Rigid ones with a `motion` move as it says, the ground for example.
        dt: time step, s.
        joints: points of bodies that stay together, surfaces of soft ones that are held; "world" is what stands still.
            Bodies that are joined do not touch. They hold from their start to their stop; see `join` and `release`.
        gravity: on rigid bodies, m/s²; soft ones have that of their scene.
        friction, restitution: of all bodies.
        pairs: other laws of two bodies, by their names; a soft body that is named twice touches itself.
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
        joints: Sequence[AnyJoint] = (),
        gravity: Sequence[float] = (0.0, 0.0, 0.0),
        friction: float = 0.0,
        restitution: float = 0.0,
        pairs: Mapping[tuple[str, str], ContactLaw] | None = None,
        apart: Sequence[Collection[str]] = (),
    ):
        self.bodies, self.gravity, self._dt = mapping_in("bodies", bodies, SceneError), gravity, checked_dt(dt)
        if not isinstance(joints, list | tuple) or not all(isinstance(each, AnyJoint) for each in joints):
            raise SceneError(f"joints = {shown(joints)}: use a list of Joints and SurfaceJoints")
        self._arguments: dict[str, Any] = {
            "joints": joints,
            "gravity": gravity,
            "friction": friction,
            "restitution": restitution,
            "pairs": pairs,
            "apart": apart,
        }
        self._steps, self._compiled_steps, self._time = 0, 0, 0.0
        joined = any(FIXED in (joint.first, joint.second) for joint in joints)
        self._bodies = make_bodies(self.bodies, self._dt, gravity, joined or bool(pairs))
        if not joined and all(isinstance(body, SoftBody) for body in self.bodies.values()) and len(self.bodies) == 1:
            del self._bodies[FIXED]  # as a soft body by itself needs no other
        self._names = list(self._bodies)
        self._in_turn = sorted(self._names, key=lambda name: not self._bodies[name].is_driven)  # who carries is first
        self._meetings = make_meetings(self._bodies, ContactLaw(restitution, friction), pairs or {}, apart)
        self._joints = JointPlan(joints, self._bodies, self._meetings)
        made = self._joints.change(self._dt / 2)
        self._met = EnergyLedger()  # what contacts and joints dissipate
        everyone = list(self._bodies.values())
        self._soft = [body for body in everyone if isinstance(body, Soft)]
        self._lone = everyone[0] if len(everyone) == 1 and isinstance(everyone[0], Soft) and not pairs else None
        if self._lone is not None:
            self._lone_step, self._lone_name = self._lone.step, self._lone.name
            self.step = self._step_alone  # type: ignore[method-assign]
        check_apart(everyone, self._meetings)
        self._skins = WorldSkins({} if self._lone else self._bodies, self._meetings)
        of_soft = {body: self._met_by(body) for body in self._soft}
        said = {body.name: body.describe_passing(radii) for body, radii in of_soft.items() if radii}
        self._passing = [f"{name}: {text}" for name, text in said.items() if text]
        self._fast = fast_pairs(everyone, self._meetings)
        self._step_pairs = StepPairs([] if self._lone else everyone, self._meetings)
        self._found, self._residuals = Found(np.empty((0, 3)), np.empty((0, 3)), 0, 0.0), (0, 0.0)
        self._let_touch_be_read()
        self._loops: CompiledWorld | None = None  # what takes whole steps, if it is compiled
        if made:
            self._go_on_with_joints(made)
        else:
            self._make_loops()

    def _leave_loops(self) -> None:
        """Has no steps taken by compiled functions from now on."""
        if self._loops is not None:
            if self._loops.is_ahead:
                self._found = self._loops.found
            self._loops.leave()
            self._loops = None

    def _make_loops(self) -> None:
        """Has whole steps taken by compiled functions from now on, if they know all that there is."""
        self._leave_loops()
        touches_itself = any(meeting.own is not None for meeting in self._meetings)
        waits = self._joints.next_change == -math.inf
        if not compiled() or self._lone is not None or touches_itself or waits:
            return
        from fenics_rom.world.compiled_world import compiled_world  # here, as numba takes time to import

        joints = list(self._joints.points.values())
        self._loops = compiled_world(self._bodies, self._meetings, joints, self._step_pairs, self._met, self._dt)

    def _met_by(self, body: Soft) -> dict[str, float]:
        """Radii, m, by name, of the rigid bodies that a soft one may meet."""
        others = {name for each in self._meetings if each.is_on and body.name in each.names for name in each.names}
        rigid = {name: record for name, record in self.bodies.items() if name in others}
        return {
            name: passing_radius(each.shape)
            for name, each in rigid.items()
            if isinstance(each, RigidBody) and each.shape
        }

    @property
    def dt(self) -> float:
        """Time step, s."""
        return self._dt

    @dt.setter
    def dt(self, dt: float) -> None:
        self._set_step(checked_dt(dt))
        self._wait = 0
        self._make_loops()

    def drive(self, name: str, motion: Any) -> None:
        """Moves a rigid body that has a `motion` by another one, from the next step on."""
        body = self._body(name)
        if not isinstance(body, Driven):
            raise StepError(f"body {name!r} moves freely: use one that has a motion")
        body.motion = motion

    def step(self, inputs: Mapping[str, Mapping[str, Any]] | None = None, count: int = 1) -> None:
        """Advances by so many steps of dt.

        Where they are compiled, many cost less than one by one. Accounts, warnings and skins are as of single ones;
        forces, contacts and sweeps are read of the last. A step in which bodies would go through one another is
        cut: `warnings` tells of it.

        Args:
            inputs: by body, by name, the same in all steps; what is not named is 0. Of a soft body as of a Simulator;
                of a rigid one that moves freely `force` (3,), N, and `torque` (3,) about its centre of mass, N m, in
                world axes. By joint with a motor: its `target`.
            count: how many steps. Loads, motions and joints go on in time.

        Raises:
            StepError: no such body or input, or no forces were found; all is as it was before that step or part of it.
        """
        left = checked_count(count)
        while left > 0:
            left -= self._advance(inputs, 1 if self._remembers_touch else left)

    def _take_steps(self, inputs: Mapping[str, Mapping[str, Any]] | None, most: int) -> int:
        """Takes so many steps at most: how many."""
        if inputs is not None and self._loops is None:
            self._check_inputs(inputs)
        h, bodies = self._dt, self._bodies
        if self._time + h / 2 >= self._joints.next_change:
            self._go_on_with_joints(self._joints.change(self._time + h / 2))
        if self._loops is not None:
            if most > 1:
                room = (self._joints.next_change - self._time) / h - 1
                most = self._skins.steps_to_ask(self._steps, max(1, int(min(most, room))))
            if taken := self._loops.take(inputs or {}, self._time, most):
                self._compiled_steps += taken
                return self._end_steps(taken)
            if self._loops.is_ahead:
                self._found = self._loops.found
                self._loops.tell_all()
            if self._loops.misfits == STAYS:
                self._make_loops()
            if inputs is not None:
                self._check_inputs(inputs)
        before = copy(self._step_pairs)
        try:
            pairs, found, guide = self._find(inputs or {})
            for soft in self._soft:
                soft.close()
        except BaseException as error:
            for body in bodies.values():
                body.undo()
            shorter = self._step_that_would_do(inputs or {}) if isinstance(error, StepError) else None
            self._step_pairs = before
            if shorter:
                raise StepError(f"{error}; steps of {shorter:.3g} s would do") from error
            raise
        for body in bodies.values():
            body.commit()
        self._step_pairs.keep(found, guide, h)
        self._found = found
        self._book(pairs, found)
        if self._joints.points:
            self._met.book(dissipated=self._step_pairs.stop_joints())
        if found.residual:
            self._residuals = self._residuals[0] + 1, max(self._residuals[1], found.residual)
        return self._end_steps(1)

    def _end_steps(self, taken: int) -> int:
        """Ends steps, and looks at skins where it is due; how many steps."""
        self._steps, self._time = self._steps + taken, next_time(self._time, self._dt, taken)
        if self._remembers_touch:
            self._note_touch()
        if self._skins.asks(self._steps, self._loops is not None and self._loops.is_ahead):
            self._tell()
            if self._skins.is_due(self._steps):
                self._skins.look(self._steps, self._time)
        return taken

    def _tell(self) -> None:
        """Has all bodies know of the last step."""
        if self._loops is not None and self._loops.is_ahead:
            for number in range(len(self._bodies)):
                self._loops.tell(number)
            self._loops.tell_drives()

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

    def _step_alone(self, inputs: Mapping[str, Any] | None = None, count: int = 1) -> None:
        """`step` of a world that has one soft body: it costs little more than that of its simulator."""
        try:
            given = None if inputs is None else inputs.get(self._lone_name)
        except AttributeError:  # cheaper than to ask before
            self._check_inputs({} if inputs is None else inputs)
            raise
        if given is None or (inputs and len(inputs) > 1):
            for name in inputs or ():
                self.simulator(name)
            given = np.zeros(self._soft[0].inputs) if given is None else given
        for _ in range(checked_count(count)):
            self._lone_step(given)

    def anew(self) -> "World":
        """Another world of the same bodies where they begin, moved as they were at first, in steps of now."""
        return World(self.bodies, self._dt, **self._arguments)

    def _begin(self, inputs: Mapping[str, Mapping[str, Any]]) -> tuple[Pairs, Array, Guide | None]:
        """Opens a step of all bodies; its pairs, forces to begin with, and what may guide."""
        of_bodies = self._take_targets(inputs)
        for name in self._in_turn:
            body = self._bodies[name]
            try:
                body.take(of_bodies.get(name, {}))
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
        if not isinstance(inputs, Mapping):
            raise StepError(f"inputs = {shown(inputs)}: use a mapping of bodies to their inputs by name")
        for name in inputs:
            if name not in self._motors:
                self._body(name)
            if not isinstance(given := inputs[name], Mapping):
                raise StepError(f"body {name!r}: use inputs by name, a mapping (got {shown(given)})")

    def _book(self, pairs: Pairs, found: Found) -> None:
        C, n = len(pairs.normals), pairs.normals
        if self._joints.points:  # what they did where forces were found but for a residual
            work = float(found.forces[C:].ravel().dot(found.velocities[C:].ravel()))
            self._met.book(numerical=-self._dt * work)
        if pairs.rows is not None:
            pairs.rows.end(found.velocities[C:], self._met)
        f, u = found.forces[:C], found.velocities[:C]
        whole = float(f.ravel().dot(u.ravel()))
        normal = float((n * f).dot(_ONES).dot((n * u).dot(_ONES)))
        self._met.book_contact(0.0, -self._dt * normal, self._dt * (normal - whole), 0.0)
