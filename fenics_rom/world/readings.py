"""What is read of a world: where its bodies are, what pushes them, and an energy account of each and of the whole."""

import math
from collections.abc import Iterable, Mapping
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError, check_known
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.contact import LEAST_TOLD
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.mechanics.nodal_contact import Touch
from fenics_rom.mechanics.rubbing import Rubbing
from fenics_rom.world.contact_step import Found
from fenics_rom.world.driven import Driven
from fenics_rom.world.joint_plan import JointPlan
from fenics_rom.world.make_bodies import FIXED, AnyBody
from fenics_rom.world.meetings import Meeting
from fenics_rom.world.pushes import Pushes, pushes_of, rubbing_of, touch_of
from fenics_rom.world.records import RigidBody, SoftBody
from fenics_rom.world.skins import WorldSkins
from fenics_rom.world.soft import Soft
from fenics_rom.world.step_pairs import StepPairs

if TYPE_CHECKING:
    from fenics_rom.world.compiled_world import CompiledWorld


class ReadWorld:
    """What a World is read by; it makes what this reads."""

    bodies: Mapping[str, RigidBody | SoftBody]
    _bodies: dict[str, AnyBody]
    _names: list[str]
    _meetings: list[Meeting]
    _joints: JointPlan
    _step_pairs: StepPairs
    _found: Found
    _met: EnergyLedger
    _passing: list[str]
    _skins: WorldSkins
    _dt: float
    _lone: Soft | None
    _steps: int
    _compiled_steps: int
    _time: float
    _residuals: tuple[int, float]
    _loops: "CompiledWorld | None"

    def _tell(self) -> None:
        """Has all bodies know of the last step."""
        raise NotImplementedError

    @property
    def steps(self) -> int:
        """Number of steps taken."""
        return self._steps if self._lone is None else self._lone.steps

    @property
    def time(self) -> float:
        """Simulated, s."""
        return self._time if self._lone is None else self._lone.time

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
            raise StepError(f"body {name!r} is rigid: use a soft one")
        return body

    def account(self, name: str) -> EnergyLedger:
        """Of a body: of what was supplied to it, `obstacles` is what other bodies did."""
        return self._body(name).account

    def energy_of(self, name: str) -> float:
        """Of a body, J: kinetic and elastic."""
        return self._body(name).energy

    @property
    def energy(self) -> float:
        """Of all bodies, J: kinetic and elastic; of rotors and springs of joints."""
        self._tell()
        bodies = math.fsum(body.energy for body in self._bodies.values())
        return bodies if self._step_pairs.rows is None else bodies + self._step_pairs.rows.energy

    @property
    def ledger(self) -> EnergyLedger:
        """The account of the whole: by loads and drivers supplied; in bodies, contacts and joints dissipated."""
        whole = EnergyLedger()
        accounts = [body.account.sums for body in self._bodies.values()]
        for sums in accounts:
            whole.book(supplied=math.fsum((*sums[0], -sums[4][0], -sums[4][1])), dissipated=sum(sums[1]))
            whole.book(lost_in_switching=sum(sums[2]), numerical=sum(sums[3]))
        by_contact, by_friction = sum(self._met.sums[5]), sum(self._met.sums[6])
        whole.book(supplied=sum(self._met.sums[0]), dissipated=sum(self._met.sums[1]))
        whole.book(numerical=sum(self._met.sums[3]))
        whole.book_parts(0.0, by_contact, by_friction)
        return whole

    def force_between(self, first: str, second: str) -> Array:
        """Force of the second body on the first in the last step, by contact and joints, (3,), N.

        Raises:
            StepError: there is no such body, or both are the same, whose forces on itself add up to 0.
        """
        for name in (first, second):
            self._body(name)
        if first == second:
            raise StepError(f"forces of {first!r} on itself add up to 0: use two bodies; `contact_forces` has each")
        if self._loops is not None and self._loops.is_ahead:
            return self._loops.force_between(self._names.index(first), self._names.index(second))
        return self._step_pairs.force_between(self._names.index(first), self._names.index(second), self._found.forces)

    def contact_forces(self, first: str, second: str) -> tuple[Array, Array]:
        """Where two bodies touched or were near in the last step, and forces on the first there, by contact.

        Of a body that touches itself, `first` and `second` are the same: the forces on points of its surface by
        triangles that face them; what these get stands opposite.

        Returns:
            Places (k, 3), m, of that body which the world has first, in the middle of the step: as bodies were expected
            there, or as they went where loops took it. Forces (k, 3), N, 0 where nothing pushes.
        """
        for name in (first, second):
            self._body(name)
        numbers = self._names.index(first), self._names.index(second)
        if self._loops is not None and self._loops.is_ahead:
            return self._loops.contact_forces(*numbers)
        return self._step_pairs.contact_forces(*numbers, self._found.forces)

    def _let_touch_be_read(self) -> None:
        """Has soft bodies tell what the world knows of their contact."""
        for number, body in enumerate(self._bodies.values()):
            if isinstance(body, Soft):
                body.read_touch = partial(self._touch_of, number, body)
                body.read_rubbing = partial(self._rubbing_of, number, body)
                if body.sensed is not None:
                    body.sensed.body = number

    def _touch_of(self, number: int, body: Soft) -> Touch | None:
        """What others did to a soft body in the last step."""
        if self._lone is not None:
            contact, turns = body.integrator.contact, not body.rom.environment.is_moving
            R = rotation_matrix(body.pose.rotation) if turns else np.eye(3)
            return None if contact is None else Touch(contact.forces.dot(R.T), contact.normal_forces)
        return touch_of(self._pushes(number), len(body.contact_coordinates))

    def _rubbing_of(self, number: int, body: Soft) -> Rubbing | None:
        """What friction did there."""
        if self._lone is not None:
            own = body.own_rubbing()
            R = np.eye(3) if body.rom.environment.is_moving else rotation_matrix(body.pose.rotation)
            return own and own._replace(tangential=own.tangential.dot(R.T), slipping=own.slipping.dot(R.T))
        return rubbing_of(self._pushes(number), len(body.contact_coordinates))

    def _pushes(self, number: int) -> Iterable[Pushes]:
        """What contacts did to a soft body in the last step."""
        if self._loops is not None and self._loops.is_ahead:
            return [self._loops.pushes(number)]
        return pushes_of(number, self._meetings, self._step_pairs.contacts, self._found)

    @cached_property
    def _remembers_touch(self) -> bool:
        """Whether a sensor has to look after every step."""
        return any(isinstance(body, Soft) and body.remembers_touch for body in self._bodies.values())

    def _note_touch(self) -> None:
        """Has sensors look."""
        self._tell()
        for body in self._bodies.values():
            if isinstance(body, Soft) and body.remembers_touch:
                body.note_touch()

    def joint_forces(self, which: str | int) -> Array:
        """Forces at the points of a joint on its first body in the last step, (k, 3), N; none where it does not hold.

        Of a rigid surface that is welded the force on it, N, and the couple about its middle, N m, (2, 3).
        `which`: its name, or its number in the order in which they were named.
        """
        points = self._joints.points.get(self._joints.name_of(which))
        if points is None:
            return np.empty((0, 3))
        found = self._found if self._loops is None or not self._loops.is_ahead else self._loops.found
        return self._step_pairs.of_joint(points, found.forces)

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints that hold now."""
        return tuple(self._joints.points)

    @property
    def touching(self) -> int:
        """Number of pairs of points that push in the last step."""
        if self._loops is not None and self._loops.is_ahead:
            return self._loops.touching
        return self._step_pairs.touching(self._found.forces)

    @property
    def compiled_steps(self) -> int:
        """Number of steps that compiled functions took whole; 0 of one soft body alone, as its simulator takes them."""
        return self._compiled_steps

    @property
    def sweeps(self) -> int:
        """That the last step took."""
        if self._loops is not None and self._loops.is_ahead:
            return self._loops.sweeps
        return self._found.sweeps

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the user should know of the run so far."""
        self._tell()
        steps, residual = self._residuals
        soft = {name: body for name, body in self._bodies.items() if isinstance(body, Soft)}
        said = [
            *self._passing,
            *self._joints.warnings,
            *(f"{name}: {text}" for name, body in soft.items() for text in body.warnings),
            *(text for name, body in self._bodies.items() if isinstance(body, Driven) for text in body.warnings(name)),
        ]
        self._skins.look(self._steps, self._time)
        said += self._skins.messages
        if residual >= LEAST_TOLD:
            said.append(
                f"in {steps} steps contact forces were not found exactly: the worst leave {residual:.0e} of the "
                "velocities that they stop; a smaller dt or less friction may help"
            )
        return tuple(said)

    def _body(self, name: str) -> AnyBody:
        check_known("body", name, self.bodies, StepError)
        if self._loops is not None and self._loops.is_ahead:
            self._loops.tell(self._names.index(name))
        return self._bodies[name]

    def __repr__(self) -> str:
        soft = [name for name, body in self.bodies.items() if isinstance(body, SoftBody)]
        driven = [name for name, body in self._bodies.items() if body.is_driven and name != FIXED]
        free = [name for name in self.bodies if name not in soft and name not in driven]
        kinds = {"soft": soft, "rigid": free, "driven": driven}
        parts = "; ".join(f"{kind}: {', '.join(some)}" for kind, some in kinds.items() if some)
        return f"World of {len(self.bodies)} bodies, dt = {self._dt:g} s, {self.steps} steps taken\n  {parts}"
