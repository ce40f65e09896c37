"""Many soft bodies of one ROM, each with a simulator of its own, that are stepped one after another.

For whatever has no form in which all bodies are stepped together. Simulators share the ROM.
"""

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError, check_known
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.contact_search import ContactSearch
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.batch_arrays import stacked_state
from fenics_rom.runtime.moving_body import BeforeStep
from fenics_rom.runtime.simulator import Simulator
from fenics_rom.runtime.tension_watch import pulled_columns

if TYPE_CHECKING:
    from fenics_rom.mechanics.active_environment import SignalLike
    from fenics_rom.runtime.joint_bodies import JointBodies


class SeparateBodies:
    """Bodies that are stepped one after another; arguments, properties and methods as of `Batch`.

    States and obstacles are checked here; `bodies` are indices.

    Attributes:
        input_limit, dtype: of inputs, as of bodies that are stepped together in double precision.
    """

    input_limit, dtype = 1e75, np.dtype(float)

    def __init__(
        self,
        rom: Rom,
        size: int,
        dt: float,
        ledger: bool,
        signals: "Mapping[str, SignalLike]",
        detail: str | None,
        told: Mapping[str, Any],
    ):
        first = Simulator(rom, dt, ledger=ledger, signals=signals, detail=detail, **told)
        self.bodies = _copies([first] * size)
        self.rom, self.steps, self.frozen = first.rom, 0, np.zeros(size, bool)
        law = first.rom.environment.contact_law
        self._friction = np.full(size, 0.0 if law is None else law.friction)
        self._goes = np.zeros(size, bool)  # who took the last step
        self._widths = self.rom.contacts

    def __deepcopy__(self, memo: object) -> "SeparateBodies":
        other = copy(self)
        other.bodies = _copies(self.bodies)
        other.frozen, other._goes = self.frozen.copy(), self._goes.copy()
        other.friction = self._friction
        return other

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self.friction = self._friction  # which simulators do not keep
        _number(self.bodies)

    def take_over(self, joint: "JointBodies") -> None:
        """Goes on where bodies are that were stepped together, without contact."""
        q, r = joint.state(np.arange(len(self.bodies)))
        base, (forces, torques), times = joint.base, joint.base_wrench, joint.time
        sums = [joint.account(name) for name in ("supplied", "dissipated", "lost_in_switching")]
        for k, body in enumerate(self.bodies):
            body.switch(joint.contact[k])
            m = body.model.order
            body.state = q[k, :m], r[k, :m]
            body.place(BaseState(*(part[k] for part in base)))
            state = body.save()
            frame = state.stepper.frame._replace(wrench=(tuple(forces[k].tolist()), tuple(torques[k].tolist())))
            state = replace(state, since=(float(times[k]), 0), stepper=state.stepper._replace(frame=frame))
            if state.sums is not None:
                booked = tuple((float(sum_[k]), 0.0) for sum_ in sums)
                state = replace(state, sums=(*booked, *state.sums[len(booked) :]))
            body.restore(state)
        self.steps, self._goes[:] = joint.steps, True

    # --- what can be read --------------------------------------------------------------------------------------------

    def _each(self, read: Callable[[Simulator], Any]) -> Array:
        return np.array([read(body) for body in self.bodies])

    @property
    def dt(self) -> float:
        """Time step, s."""
        return self.bodies[0].dt

    @dt.setter
    def dt(self, h: float) -> None:
        for body in self.bodies:
            body.dt = h

    @property
    def contact(self) -> Array:
        """(size,)."""
        return self._each(lambda body: body.contact)

    @property
    def time(self) -> Array:
        """(size,), s."""
        return self._each(lambda body: body.time)

    @property
    def energy(self) -> Array:
        """(size,), J."""
        return self._each(lambda body: body.energy)

    def account(self, entry: str) -> Array:
        """A sum of the energy account (size,), J, by its name in `Batch`."""
        parts = {"supplied_by_obstacles": ("obstacles",), "dissipated_in_contact": ("contact", "friction")}
        return self._each(lambda body: sum(getattr(body.ledger, part) for part in parts.get(entry, (entry,))))

    @property
    def friction(self) -> Array:
        """(size,)."""
        return self._friction.copy()

    @friction.setter
    def friction(self, μ: Array) -> None:
        self._friction = np.array(μ, dtype=float)
        beside = [body.beside.finer for body in self.bodies if body.beside is not None]
        for body, own in zip([*self.bodies, *beside], self._friction.tolist() * 2, strict=False):
            if body.integrator.interface is None or body.integrator.interface.solver.law.friction == own:
                continue
            solver = body.integrator.interface.solver
            solver.law = replace(solver.law, friction=own)
            solver.search = solver.search._replace(laws=(), frames=None, is_steady=False, unturned=0, planes=None)
            body.integrator.set_time_step(body.dt)  # what was worked out with the other one is found anew

    @property
    def inexact(self) -> Array:
        """(size,)."""
        return np.array([0 if search is None else search.residual.steps for search in self._searches])

    @property
    def held_back(self) -> Array:
        """(size,)."""
        return np.array([0 if search is None else search.held.steps for search in self._searches])

    @property
    def _searches(self) -> list[ContactSearch | None]:
        """Of each body; None where nothing can touch it."""
        faces = [body.integrator.interface for body in self.bodies]
        return [None if face is None else face.solver.search for face in faces]

    @property
    def through_skin(self) -> Array:
        """(size,), m."""
        return self._each(lambda body: body.through_skin)

    @property
    def least_tensions(self) -> dict[str, Array]:
        """(size,), N, by name."""
        found = [body.least_tensions for body in self.bodies]
        return {name: np.array([of.get(name, 0.0) for of in found]) for name in pulled_columns(self.rom, 0)}

    @property
    def beyond_training(self) -> Array:
        """(size,)."""

        def is_beyond(body: Simulator) -> bool:
            kernel = body.integrator.kernel
            return kernel.beyond_training or getattr(kernel, "distrusted", False)

        return self._each(is_beyond)

    @property
    def mismatch(self) -> Array:
        """(size,)."""
        return self._each(lambda body: body.mismatch or 0.0)

    @property
    def base(self) -> BaseState:
        """Of arrays (size, 3) and (size, 4)."""
        return BaseState(*map(np.array, zip(*(body.pose or () for body in self.bodies), strict=True)))

    @property
    def base_wrench(self) -> tuple[Array, Array]:
        """(size, 3), N and N m."""
        wrenches = self._each(lambda body: body.base_wrench or np.zeros((2, 3)))
        wrenches[~self._goes] = 0.0
        return wrenches[:, 0], wrenches[:, 1]

    @property
    def base_misfit(self) -> Array:
        """(size,)."""
        notes = [body.integrator.kernel.notes for body in self.bodies]
        return np.array([max(of.get("misfit", 0.0), of.get("misfit of turn", 0.0)) for of in notes])

    @property
    def reactions(self) -> dict[str, Array]:
        """(size,) of each, by name."""
        found = [body.reactions for body in self.bodies]
        names = dict.fromkeys(name for of in found for name in of)
        return {name: np.array([of.get(name, 0.0) for of in found]) for name in names}

    def contact_force(self, obstacle: str) -> Array:
        """(size, 3), N."""
        return self._each(lambda body: body.contact_forces(obstacle))

    @property
    def point_forces(self) -> Array:
        """(size, P, 3), N."""
        return self._each(lambda body: body.contact_forces())

    def state(self, bodies: Array) -> tuple[Array, Array]:
        """(bodies, m) each."""
        q, r = np.zeros((2, len(bodies), self._order))
        for k, body in enumerate(bodies):
            parts = self.bodies[body].state
            q[k, : len(parts[0])], r[k, : len(parts[1])] = parts
        return q, r

    @property
    def _order(self) -> int:
        """The largest of a contact model, or of what one has beside at the moment."""
        models = [*self.rom.contact_models.values(), *(body.model for body in self.bodies)]
        return max(model.order for model in models)

    def displacement(self, output: str) -> Array:
        """(size, points, 3), m."""
        return self._each(lambda body: body.displacement(output))

    def velocity(self, output: str) -> Array:
        """(size, points, 3), m/s."""
        return self._each(lambda body: body.velocity(output))

    def shape(self, body: int) -> Array:
        """(nodes, 3), m."""
        return self.bodies[body].displacement()

    def shape_coordinates(self, body: int) -> Array:
        """(k,)."""
        return self.bodies[body].shape_coordinates

    def reading(self, name: str) -> Array:
        """(size, ...)."""
        return self._each(lambda body: body.reading(name))

    # --- what can be done --------------------------------------------------------------------------------------------

    def set_state(self, q: Array, r: Array, bodies: Array, on_error: str) -> None:
        """As of `Batch`."""
        orders = np.array([self.bodies[body].model.order for body in bodies])
        state = stacked_state(q, r, (len(bodies), self._order))
        if not np.isfinite(state).all():
            raise StepError("state: use finite numbers")
        if state[:, np.arange(self._order) >= orders[:, None]].any():
            raise StepError("state: beyond the order of a body's contact mode only zeros are allowed")

        def put(body: Simulator, k: int) -> None:
            body.state = state[0, k, : orders[k]], state[1, k, : orders[k]]

        inside = self._put(bodies, put, on_error)
        if on_error == "reset":
            self.reset(inside, "hold")

    def reset(self, bodies: Array, on_error: str) -> None:
        """As of `Batch`."""
        self._put(bodies, lambda body, k: body.begin_anew(), on_error)

    def place(self, base: BaseState, bodies: Array) -> None:
        """As of `Batch`."""
        before, done = [self.bodies[body].pose for body in bodies], 0
        try:
            for k, body in enumerate(bodies):
                self.bodies[body].place(BaseState(*(part[k] for part in base)))
                done = k + 1
        except StepError as error:
            for pose, body in zip(before[:done], bodies, strict=False):
                assert pose is not None
                self.bodies[body].place(pose)
            raise StepError(f"body {bodies[done]}: {error}; all bodies were left as they were") from None

    def _put(self, bodies: Array, put: Callable[[Simulator, int], None], on_error: str) -> Array:
        """Puts bodies somewhere; those that are inside an obstacle then, (any,), which are to stand still."""
        touches, inside = self.rom.environment.contact_law is not None, np.zeros(len(bodies), bool)
        saved = [self.bodies[body].save() for body in bodies] if touches else []
        for k, number in enumerate(bodies):
            body = self.bodies[number]
            put(body, k)
            try:
                body.check_outside_obstacles()
            except StepError as error:
                inside[k] = True
                if on_error == "raise":
                    for state, back in zip(saved[: k + 1], bodies, strict=False):
                        self.bodies[back].restore(state)
                    raise StepError(
                        f'body {number}: {error}; or on_error="hold"; all bodies were left as they were'
                    ) from None
        self.frozen[bodies], self._goes[bodies] = inside, False
        return bodies[inside]

    def place_obstacle(self, name: str, displacement: Array, bodies: Array) -> None:
        """As of `Batch`."""
        check_known("obstacle", name, list(self.rom.environment.obstacles), StepError)
        shape = len(bodies), 3
        if displacement.shape not in ((3,), shape) or not np.isfinite(displacement).all():
            raise StepError(
                f"{name}: use three finite numbers, in m, for each of {len(bodies)} bodies, or for all "
                f"(got an array of shape {displacement.shape})"
            )
        for body, own in zip(bodies, np.broadcast_to(displacement, shape), strict=True):
            self.bodies[body].set_signal(name, own.copy())

    def can_switch(self, modes: Array, bodies: Array) -> bool:
        """Whether bodies can get to contact modes: they all can."""
        return True

    def switch(self, modes: Array, bodies: Array) -> None:
        """Makes contact modes active, by their numbers (B,), of bodies (B,)."""
        names = list(self.rom.contact_models)
        for mode, body in zip(modes, bodies, strict=True):
            self.bodies[body].switch(names[mode])

    def step(self, u: Array, base: BaseState | None, held: Array, on_error: str) -> Array:
        """As of `Batch`, but for "reset", under inputs and bases that are fine but for those of bodies held."""
        most, where, stays = max(self._widths.values()), f"step {self.steps}", self.frozen.copy()
        stays[held] = True
        taken: list[BeforeStep] = []
        for number, body in enumerate(self.bodies):
            if stays[number]:
                continue
            own = None if base is None else BaseState(*(part[number] for part in base))
            before = BeforeStep.of(body) if on_error == "raise" else None
            try:
                body.step(self._input_of(body, u[number], most), base=own)
            except StepError as error:
                if on_error == "raise":
                    for one in taken:
                        one.return_to()
                    raise StepError(f"{where}, body {number}: {error}; all bodies were left as they were") from None
                stays[number] = True
            if before is not None:
                taken.append(before)
        self.steps += 1
        self._goes = ~stays
        return stays.nonzero()[0]

    def _input_of(self, body: Simulator, u: Array, most: int) -> Array:
        """What of an input is a body's, without columns that only other contact modes have."""
        own = self._widths[body.nearest_contact] if min(self._widths.values()) < most else most
        return u if own == most else np.concatenate([u[:own], u[most:]])


def _copies(bodies: list[Simulator]) -> list[Simulator]:
    """Of bodies of one ROM, which share the maps of its errors."""
    copies = [copy(body) for body in bodies]
    for k, body in enumerate(copies):
        body.whose = f"body {k}: "
        if body.errors is not None and bodies[0].errors is not None:
            body.errors.maps = bodies[0].errors.maps
    _number(copies)
    return copies


def _number(bodies: list[Simulator]) -> None:
    """Gives the sensors of each body noise of their own."""
    for number, body in enumerate(bodies):
        if body.sensed is not None:
            body.sensed.body = number
