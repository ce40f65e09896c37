"""A full-order body in its environment: loads and obstacles act by themselves, the contact mode follows them."""

from collections.abc import Mapping
from functools import partial
from operator import attrgetter

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError, check_known
from fenics_rom.fem.carried_at_rest import CarriedAtRest
from fenics_rom.fem.finite_strain.arc_length import ArcLength
from fenics_rom.fem.finite_strain.stepper import FiniteStrainStepper
from fenics_rom.fem.frame_stepper import MovingFrameStepper
from fenics_rom.fem.full_order_body import FullOrderBody
from fenics_rom.fem.linear_stepper import FullOrderStepper
from fenics_rom.fem.readings import readable
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.contact_points import ContactPoints
from fenics_rom.mechanics.environment import Environment
from fenics_rom.mechanics.filling import Filling
from fenics_rom.mechanics.initial_state import InitialState, lost_messages, missing_share
from fenics_rom.mechanics.load_history import LoadHistory
from fenics_rom.mechanics.nodal_contact import Touch, TouchedBody
from fenics_rom.mechanics.readable_body import LastStep
from fenics_rom.mechanics.readings import Reading
from fenics_rom.mechanics.sensor import SensedTouch
from fenics_rom.mechanics.signals import SignalLike
from fenics_rom.mechanics.step import StepInput
from fenics_rom.system.system import System


class FullOrderSimulator(TouchedBody):
    """Steps a system from rest; every rank must call every method.

    Args:
        system: the full-order model.
        dt: time step, s; may be set anew before any step.
        environment: what acts.
        signals: of loads and obstacles by name, instead of the environment's; as in ActiveEnvironment.
        ledger: whether the energy account is kept.

    Attributes:
        system: the full-order model.
        stepper: of the body: linear, unless the system deforms largely or its frame moves.
        pose, momentum, base_wrench: of a moving frame, as in Simulator; None of others.
        environment: the loads and obstacles.
        contact, time, energy, ledger, displacement, velocity, switch, close: the stepper's; see FullOrderBody.

    Raises:
        SceneError: without inertia, a body that nothing holds; or as ActiveEnvironment.
        StepError: the body begins in an obstacle.
    """

    stepper: FullOrderStepper | FiniteStrainStepper | MovingFrameStepper

    def __init__(
        self,
        system: System,
        dt: float,
        environment: Environment,
        signals: Mapping[str, SignalLike] | None = None,
        *,
        ledger: bool = True,
    ):
        self.system, self.environment = system, ActiveEnvironment(environment, signals=signals)
        environment.check_supports(system.rigid.shape[1])
        if system.moving_frame is not None:
            if system.deformation is not None:
                self.stepper = system.deformation.stepper_in_frame(dt, self.environment, ledger=ledger)
            else:
                of_kind = MovingFrameStepper if environment.has_inertia else CarriedAtRest
                self.stepper = of_kind(system, dt, self.environment, ledger=ledger)
        elif system.deformation is None:
            self.stepper = FullOrderStepper(system, dt, self.environment, ledger=ledger)
        else:
            self.stepper = system.deformation.stepper(dt, self.environment, ledger=ledger)
        self.displacement, self.velocity = self.stepper.displacement, self.stepper.velocity
        self.switch, self.close = self.stepper.switch, self.stepper.close
        self._follows = environment.switches_itself
        self._sensed, self._steps = SensedTouch(system.readings, self._felt), 0
        stroke = partial(_stroke, system, self.stepper)
        widths = {name: columns.shape[1] for name, columns in system.actuators.items()}
        self.filling = Filling(environment.gases, widths, stroke) if environment.gases else None
        self._last: tuple[tuple[Array, Array], Array] | None = None  # what a step began with, and its inputs (p,)
        self._touched = np.empty((0, 3))  # velocities (P, 3) of contact points in the middle of the last step, m/s

    contact = property(attrgetter("stepper.contact_mode"))
    time = property(attrgetter("stepper.time"))
    ledger = property(attrgetter("stepper.ledger"))
    pose = property(lambda self: getattr(self.stepper, "pose", None))
    momentum = property(lambda self: getattr(self.stepper, "momentum", None))
    base_wrench = property(lambda self: getattr(self.stepper, "wrench", None))

    @property
    def energy(self) -> float:
        """Stored, also in the gas of chambers, J."""
        return self.stepper.energy + (0.0 if self.filling is None else self.filling.energy)

    @property
    def gas(self) -> dict[str, float]:
        """As of a Simulator."""
        return {} if self.filling is None else dict(self.filling.amounts)

    def begin(self, initial: InitialState, history: LoadHistory) -> list[str]:
        """Puts a body that is at rest at the start of a run; what supports do not let it have of that, in words.

        Raises:
            SceneError: an equilibrium of a body that nothing holds, or a field that supports hold.
            SolverError, StepError: no equilibrium was found, or the body begins in an obstacle.
        """
        if (frame := self.system.moving_frame) is not None:
            if frame.carried:
                initial.check_carried()
            else:
                self.stepper.place(initial.pose(frame.origin))  # type: ignore[union-attr]
                self.stepper.check_start()
            return []
        initial.check_supports(self.system.rigid.shape[1])
        body, rows = self.system.body, self.system.algebra.rows()
        x = self._equilibrium(history) if initial.equilibrium else np.zeros_like(self.stepper.x)
        fields = dict(zip(("displacement", "velocity"), initial.fields(body.nodes, body.node_mass), strict=True))
        unknowns = {name: field.ravel()[body.free] for name, field in fields.items()}
        taken = {name: body.unknowns.expand(part).reshape(-1, 3) for name, part in unknowns.items()}
        lost = {name: missing_share(field, taken[name], body.node_mass) for name, field in fields.items()}
        self._last = None
        self.stepper.set_state(x[:, 0] + unknowns["displacement"][rows], unknowns["velocity"][rows])
        self.stepper.check_start()
        if self.filling is not None:
            self.filling.resume({})
        return lost_messages(lost, "the body")

    def _equilibrium(self, history: LoadHistory) -> Array:
        """The displacement (rows here, 1) under what acts at time 0, m."""
        contact, u = history.at(0.0, self.contact)
        still, signals = self.environment.frozen_at(0.0)
        settled = FullOrderSimulator(self.system, self.stepper.dt, still, signals, ledger=False)
        settled.switch(contact)
        settled.step(u)
        self.switch(settled.contact)
        settled.close()
        return settled.stepper.x

    def step(self, u: Array) -> None:
        """Advances by the stepper's dt.

        Inputs `u` are the contact mode's columns, then the actuators'; the actuators' alone where the contact mode
        follows the obstacles. A step that fails leaves everything as it was.
        """
        stepper, interface, before = self.stepper, self.stepper.interface, self.stepper.contact_mode
        start = stepper.point_displacement() if self._sensed.feels else self._touched
        try:
            if self._follows and interface is not None:
                gaps = interface.solver.gaps(stepper.point_displacement(), self.environment.state.offsets)
                stepper.switch(interface.points.nearest(gaps, before))
                u = np.concatenate([np.zeros(self.system.contacts[stepper.contact_mode].shape[1]), u])
            if self.filling is not None:
                u = self.filling.blown(u, self.time, stepper.dt)
            inputs = self.environment.step_input(u, stepper.time, stepper.dt)
            moved = stepper.x, stepper.v
            stepper.step(inputs)
        except BaseException:
            stepper.switch(before)
            raise
        self.environment.commit(inputs, stepper.dt)
        if self.filling is not None:
            gained = self.filling.take(u)
            if stepper.ledger is not None:
                stepper.ledger.book(supplied=gained)
        self._steps += 1
        self._last = moved, inputs.u
        if self._sensed.feels:
            self._touched = (stepper.point_displacement() - start) / stepper.dt
        self._sensed.note(self.time, stepper.dt, self._steps)

    def step_along(self, path: ArcLength, u: Array, end: float) -> None:
        """Takes a step along the equilibrium path of u, of contact columns and actuators, that grows from nothing.

        Beside it there is what acts by itself at the end of a run, s. Only without inertia, contact and given strokes.
        """
        assert isinstance(self.stepper, FiniteStrainStepper)

        def inputs_at(factor: float) -> StepInput:
            return self.environment.step_input(factor * u, end, 0.0)

        if not path.steps:
            self.stepper.equilibrium(inputs_at(0.0))
        self.stepper.step_along(path, inputs_at)

    def reading(self, name: str) -> Array:
        """A reading of the scene as it is now; of contact pressure in the last step. Its shape and unit: see Readings.

        Raises:
            StepError: no such reading.
        """
        check_known("reading", name, self.system.readings, StepError)
        return self._sensed.shown(name, self.time, self._steps)

    @property
    def _readings(self) -> Mapping[str, Reading]:
        return self.system.readings

    def _felt(self, name: str) -> Array:
        """A reading without what a sensor adds."""
        of_step = self._touched, self._last_step, partial(self.environment.amplitudes_at, self.time)
        return self.system.readings[name].read(readable(self.system, self.stepper, *of_step))

    def _last_step(self) -> LastStep | None:
        """What was done in it."""
        if self._last is None:
            return None
        stepper, gather, (moved, u) = self.stepper, self.system.algebra.gather, self._last
        if stepper.actuators is not None:
            u = stepper.actuators.split(u)[0]
            u[stepper.actuators.columns] = stepper.reactions
        start, end = (tuple(gather(part)[:, 0] for part in pair) for pair in (moved, (stepper.x, stepper.v)))
        h = stepper.dt if self.environment.environment.has_inertia else 0.0
        return LastStep(h, start, end, stepper.contact_mode, u)  # type: ignore[arg-type]

    def obstacle_forces(self) -> Array:
        """Forces of the obstacles on the body in the last step, (O, 3), N."""
        contact = self.stepper.contact
        return np.zeros((len(self.environment.obstacles), 3)) if contact is None else contact.by_obstacle

    def _touch(self) -> tuple[ContactPoints, Touch | None] | None:
        interface, contact = self.stepper.interface, self.stepper.contact
        if interface is None:
            return None
        return interface.points, None if contact is None else Touch(contact.forces, contact.normal_forces)

    def _surface_at_rest(self) -> tuple[Array, Array, Array]:
        body = self.system.body
        return body.nodes, body.triangles, np.concatenate(list(body.contact_surfaces.values()))

    @property
    def reactions(self) -> dict[str, float]:
        """Forces of the actuators whose strokes are given, in the last step: tensions in N, pressures in Pa."""
        names = self.environment.stroke_names(self.system.actuators)
        return dict(zip(names, map(float, self.stepper.reactions), strict=False))


def _stroke(system: System, body: FullOrderBody, actuator: str) -> float:
    """By how much a chamber is larger than at rest, m³."""
    return readable(system, body, np.empty((0, 3))).stroke(actuator)
