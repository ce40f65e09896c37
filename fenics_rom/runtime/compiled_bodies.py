"""Many linear bodies of one ROM among obstacles, stepped by compiled loops: each as it is by itself, to the bit.

A simulator is put where a body is, one after another, for what loops do not do: steps whose forces they do not find,
and switches of the contact mode.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import compiled, or_numpy
from fenics_rom.errors import StepError
from fenics_rom.mechanics.compiled.contact_law import OTHERWISE
from fenics_rom.mechanics.compiled.obstacle_motion import Moving
from fenics_rom.mechanics.contact import ObstacleMotion
from fenics_rom.mechanics.contact_solver import PENETRATION_TOLERANCE
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.mechanics.obstacle_poses import NO_TURN, mean_velocities
from fenics_rom.mechanics.step import StepInput
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.batch_arrays import distinct, stacked_state
from fenics_rom.runtime.compiled.linear_bodies import look_at_bodies, step_bodies
from fenics_rom.runtime.compiled.linear_step import PARTS, State
from fenics_rom.runtime.compiled.touching import LOST, NO_LAW, Clearance
from fenics_rom.runtime.compiled_mode import Mode
from fenics_rom.runtime.compiled_state import LOST_IN_SWITCHING, CompiledState
from fenics_rom.runtime.simulator import Simulator
from fenics_rom.runtime.threads import deal_out

if TYPE_CHECKING:
    from fenics_rom.mechanics.active_environment import SignalLike
    from fenics_rom.mechanics.base_path import BaseState

FARTHEST = 1e50  # m, that obstacles are placed away


class CompiledBodies(CompiledState):
    """Linear bodies among obstacles; arguments, properties and methods as of `Batch`, where they are checked.

    States and obstacles are checked here; `bodies` are indices.
    """

    @classmethod
    def made(
        cls, rom: Rom, size: int, dt: float, ledger: bool, signals: "Mapping[str, SignalLike]", detail: str | None
    ) -> "CompiledBodies | None":
        """Of a ROM; None where its steps are not compiled."""
        acting = rom.environment
        is_plain = not (acting.contact_law or acting.finds_forces or acting.viscoelasticity)
        if not compiled() or is_plain or acting.is_moving or rom.deformation is not None:
            return None
        single = Simulator(rom, dt, signals=signals, detail=detail)
        is_compiled = getattr(single.integrator.kernel, "compiled_step", None) is not None
        feels_turning = single.sensed is not None and acting.turns_obstacles
        return cls(single, size, ledger) if is_compiled and not feels_turning else None

    @property
    def reactions(self) -> dict[str, Array]:
        """(size,) of each, by name."""
        return dict(zip(self._single.stroke_names, self._found.T, strict=False))

    @property
    def _found(self) -> Array:
        """Forces (size, n) that were found in the last step."""
        found = np.zeros((self.size, self._strokes))
        for bodies, mode in self._by_mode():
            found[bodies] = mode.states.reactions[bodies]
        return found

    def _rub(self, friction: float) -> None:
        """Has the simulator have this μ."""
        if self._interface is None:
            return
        stepper, solver = self._single.integrator, self._solver
        if solver.law.friction != friction:
            solver.law = replace(solver.law, friction=friction)
            solver.search = solver.search._replace(laws=(), frames=None, is_steady=False, unturned=0, planes=None)
            stepper.set_time_step(self._dt)  # what was worked out with the other one is found anew

    def _leave(self, body: int) -> None:
        """The body is where the simulator is."""
        self._clearance[:, body] = 0.0
        stepper, self._mode[body] = self._single.integrator, self._numbers[self._single.integrator.contact_mode]
        now, states = stepper.snapshot(), self._modes[self._mode[body]].states
        states.halves[body] = now.state.reshape(2, -1)
        states.rigid[body] = now.rigid_displacement
        ends = np.cumsum([states.beyond[body].size, states.relaxed_beyond[body].size])
        beyond, relaxed_beyond, relaxed = np.split(now.auxiliary, ends)
        states.reactions[body] = stepper.reactions
        states.beyond[body] = beyond.reshape(states.beyond[body].shape)
        states.relaxed_beyond[body] = relaxed_beyond.reshape(states.relaxed_beyond[body].shape)
        share, (strains, forces) = self._modes[self._mode[body]].body.share, states.relaxed[body].transpose(1, 0, 2)
        strains[:] = relaxed.reshape(strains.shape)
        forces[:] = strains @ share if len(share) else strains

    def _step_alone(self, body: int, u: Array, obstacles: Moving) -> None:
        """Takes a step as a single body does.

        Raises:
            StepError: there are no forces, or no finite state; nothing is changed.
        """
        stepper, ledger, told = self._enter(body), self._single.ledger, self._new
        assert ledger is not None
        self._rub(float(self._friction[body]))
        stepper.flush()
        ledger.sums, filling = EnergyLedger().sums, self._single.filling
        if filling is not None:
            filling.resume(self._gas_of(body))
            filling.check(u, float(self.time[body]))
        energy = stepper.step(self._all_of(body, u, obstacles))
        if not np.isfinite(energy):
            stepper.rollback()
            raise StepError(OVERFLOWS)
        self._leave_step(body)
        if self._interface is not None:
            self._searches[body] = search = self._solver.search  # with what NumPy's methods keep
            self._after.forces[body] = search.forces
            self._after.swung[body] = 0 if search.swung is None else search.swung
        sums = ledger.sums
        (supplied, *_), (dissipated, *_), *_, by_obstacles, contact, friction = sums
        of_contact = by_obstacles[0], contact[0], friction[0]
        told.works[body] = supplied - of_contact[0], dissipated - sum(of_contact[1:]), *of_contact
        if filling is not None:
            self._filled.before[body] = self._filled.amounts[body]
            told.works[body, 0] += filling.take(u)
            self._filled.amounts[body] = filling.in_order(self._single.stroke_names, self._strokes)
        touched = stepper.contact
        for kept, part in zip(told[2:], self._nothing(1), strict=True):
            kept[body] = part[0]
        if touched is not None:
            told.forces[body], told.resultants[body] = touched.forces, touched.by_obstacle
            told.pressing[body] = touched.normal_forces

    def _all_of(self, body: int, u: Array, obstacles: Moving) -> StepInput:
        """All that acts on a body in a step."""
        moving = None if self._interface is None else ObstacleMotion(*(part[body] for part in obstacles))
        return StepInput(u, moving)

    def _leave_step(self, body: int) -> None:
        """The body is where the simulator is after a step."""
        states = self._modes[self._mode[body]].states
        for kept, part in zip(states[PARTS:], states[:PARTS], strict=True):
            kept[body] = part[body]
        self._leave(body)

    def _checked_state(self, q: Array, r: Array, bodies: Array) -> Array:
        """What bodies (n,) are to be put to, (2, n, m).

        Raises:
            StepError: as of `Batch.set_state`.
        """
        state = stacked_state(q, r, (len(bodies), self._m))
        if not np.isfinite(state).all():
            raise StepError("state: use finite numbers")
        orders = np.array([model.order for model in self._models])[self._mode[bodies]]
        if state[:, np.arange(self._m) >= orders[:, None]].any():
            raise StepError("state: beyond the order of a body's contact mode only zeros are allowed")
        return state

    def set_state(self, q: Array, r: Array, bodies: Array, on_error: str) -> None:
        """As of `Batch`."""
        state = self._checked_state(q, r, bodies)
        saved = [(mode, bodies, [part[bodies] for part in mode.states[:PARTS]]) for mode in self._modes]
        given = np.zeros((2, self.size, self._m))
        given[:, bodies] = state
        for own, mode in self._by_mode(bodies):
            q, r = given[:, own, : len(mode.body.ω)]
            mode.states.halves[own] = np.stack([mode.body.ω * q, r], axis=1)
            mode.states.rigid[own] = q[:, : self.rom.rigid]
            for part in mode.states[2:PARTS]:
                part[own] = 0.0
        inside = self._inside(bodies, self._offsets)
        if inside.any() and on_error == "raise":
            for mode, own, parts in saved:
                for kept, part in zip(mode.states[:PARTS], parts, strict=True):
                    kept[own] = part
            raise StepError(inside_message(bodies[inside.argmax()]))
        self._begin(bodies, inside)
        if self._skin is not None:
            self._skin.forget(bodies)
        if on_error == "reset":
            self.reset(bodies[inside], "hold")

    def reset(self, bodies: Array, on_error: str) -> None:
        """As of `Batch`."""
        offsets, placed = self._offsets.copy(), self._placed[bodies]
        offsets[bodies] = np.where(np.isnan(placed), self._environment.offsets_at(0.0), placed)
        inside = self._inside(bodies, offsets, at_rest=True)
        if inside.any() and on_error == "raise":
            raise StepError(inside_message(bodies[inside.argmax()]))
        self._mode[bodies], self._offsets, self._velocities[bodies] = 0, offsets, 0.0
        for part in self._modes[0].states[:PARTS]:
            part[bodies] = 0.0
        self._begin(bodies, inside)
        self._begun.forces[bodies], self._begun.swung[bodies] = 0.0, 0
        self._began[bodies], self._taken[bodies] = 0.0, 0
        self._account[:, bodies] = self._least_tensions[:, bodies] = 0.0
        self._filled.amounts[bodies] = 0.0
        for body in bodies.tolist():
            self._searches.pop(body, None)
        if self._skin is not None:
            self._skin.begin(bodies)
        if self._touch is not None:
            self._touch.begin(bodies)

    def _begin(self, bodies: Array, frozen: Array) -> None:
        """Bodies are where they were put, and nothing touches; some of them are inside an obstacle."""
        self.frozen[bodies] = frozen
        self._clearance[:, bodies] = 0.0
        for kept in self._told[2:]:
            kept[bodies] = 0.0

    def _inside(self, bodies: Array, offsets: Array, at_rest: bool = False) -> Array:
        """Which (n,) of the bodies are inside an obstacle where they are, or at rest."""
        points = self._points
        if not len(points):
            return np.zeros(len(bodies), bool)
        gaps, size = np.full((self.size, len(points)), np.inf), max(np.ptp(points, axis=0).max(), np.abs(points).max())
        for own, mode in [(bodies, self._modes[0])] if at_rest else self._by_mode(bodies):
            states = State(*map(np.zeros_like, mode.states)) if at_rest else mode.states
            given = mode.touch, mode.body.inverse_ω, self._shapes
            look_at_bodies(*given, own, offsets, states, np.empty((*gaps.shape, 3)), gaps)
        deep: Array = gaps[bodies].min(axis=1) < -PENETRATION_TOLERANCE * float(size)
        return deep

    def place_obstacle(self, name: str, displacement: Array, bodies: Array) -> None:
        """As of `Batch`."""
        number, shape = self._number_of(name), (len(bodies), 3)
        if displacement.shape not in ((3,), shape) or not (np.abs(displacement) <= FARTHEST).all():
            raise StepError(
                f"{name}: use three finite numbers within {FARTHEST:.0e}, in m, for each of {len(bodies)} "
                f"bodies, or for all (got an array of shape {displacement.shape})"
            )
        if self.rom.environment.obstacles[name].motion is not None:
            raise StepError(f"{name}: it has a motion, which says where it is: use obstacles without one")
        self._placed[bodies, number, :3] = displacement
        self._placed[bodies, number, 3:] = NO_TURN[: self._placed.shape[2] - 3]

    def can_switch(self, modes: Array, bodies: Array) -> bool:
        """Whether bodies can get to contact modes: they all can."""
        return True

    def switch(self, modes: Array, bodies: Array) -> None:
        """Makes contact modes active, by their numbers (B,), of bodies (B,)."""
        for mode, body in zip(modes.tolist(), bodies.tolist(), strict=True):
            if mode != self._mode[body]:
                lost, before = self._enter(body).switch(self._modes[mode].name), self._gas_energy(np.array([body]))
                self._leave(body)
                self._account[LOST_IN_SWITCHING, body] += lost - float((self._gas_energy(np.array([body])) - before)[0])

    def step(self, u: Array, base: "BaseState | None", held: Array, on_error: str) -> Array:
        """As of `Batch`, but for "reset", under inputs and bases that are fine but for those of bodies held."""
        self._move_bases(base)
        goes = ~self.frozen
        goes[held] = False
        obstacles, loads = self._obstacles(goes), self._loads()
        modes, lost, searches = self._mode.copy(), self._account[LOST_IN_SWITCHING].copy(), dict(self._searches)
        if self._interface is not None and self._environment.environment.switches_itself and len(self._modes) > 1:
            self._follow_obstacles(goes.nonzero()[0])
        taken = np.zeros(self.size, bool)
        try:
            self._take(goes, taken, u, loads, obstacles, on_error)
        except StepError:
            self._take_back(taken.nonzero()[0])
            self._mode, self._account[LOST_IN_SWITCHING], self._searches = modes, lost, searches
            raise
        stays = (~taken).nonzero()[0]  # what they were in the mode before is still there
        self._mode[stays], self._account[LOST_IN_SWITCHING, stays] = modes[stays], lost[stays]
        self._commit(taken, stays, obstacles)
        for column, least in zip(self._pulled.values(), self._least_tensions, strict=True):
            np.minimum(least, u[:, column], out=least)
        if self._skin is not None:
            self._skin.look_in_turn()
        return stays

    def _move_bases(self, base: "BaseState | None") -> None:
        """Where bases are at the end of the step; a StepError where nothing carries bodies."""
        if base is not None:
            raise StepError(f"step {self.steps}: base: use a body in a moving frame that a rigid base carries")

    def _take_back(self, bodies: Array) -> None:
        """Puts bodies where they were before the last step."""
        for own, mode in self._by_mode(bodies):
            for kept, part in zip(mode.states[:PARTS], mode.states[PARTS:], strict=True):
                kept[own] = part[own]
        self._clearance[:, bodies] = 0.0
        self._filled.amounts[bodies] = self._filled.before[bodies]

    def _take(self, goes: Array, taken: Array, u: Array, loads: Array, obstacles: Moving, on_error: str) -> None:
        """Takes the steps of bodies that go (size,), and notes those that have taken theirs."""
        most = max(self._widths.values())
        inputs = dict[str, Array]()
        for own, mode in self._by_mode(goes.nonzero()[0]):
            columns = u[:, : self._widths[mode.name]], u[:, most:], loads
            inputs[mode.name] = full = np.ascontiguousarray(np.hstack(columns))
            self._new.status[own] = OTHERWISE
            self._step_together(mode, own, full, obstacles)
        taken[:] = goes & (self._new.status < OTHERWISE)
        for body in (goes & ~taken).nonzero()[0].tolist():
            try:
                if self._new.status[body] == LOST:
                    raise StepError(OVERFLOWS)
                self._step_alone(body, inputs[self._modes[self._mode[body]].name][body], obstacles)
                taken[body] = True
            except StepError as error:
                if on_error == "raise":
                    where = f"step {self.steps}, body {body}"
                    raise StepError(f"{where}: {error}; all bodies were left as they were") from None

    def _step_together(self, mode: Mode, own: Array, inputs: Array, obstacles: Moving) -> None:
        """Takes the steps of bodies that are in a contact mode, in threads."""
        law = NO_LAW._replace(h=self._dt) if self._interface is None else self._solver.law_in_steps(self._dt)
        given = mode.body, law, self._friction, self._shapes
        gap, untouched, still, gone = self._clearance
        clearance = Clearance(gap, untouched, still, mode.stretch, gone, self._apart)
        between = inputs, obstacles, self._begun, self._after, mode.states, self._filled, clearance, self._new
        deal_out(partial(_step, given, between), own)
        mode.keep_rows()

    def _commit(self, taken: Array, stays: Array, obstacles: Moving) -> None:
        """The step was taken by some of the bodies (size,), all but those that stay (n,)."""
        self._begun, self._after, self._told, self._new = self._after, self._begun, self._new, self._told
        for now, before in zip((*self._begun, *self._told), (*self._after, *self._new), strict=True):
            now[stays] = before[stays]
        obstacles.end[stays] = obstacles.start[stays]
        if self._touch is not None:
            self._touch.take(taken, obstacles, self._mode, self._dt)
        velocities = mean_velocities(obstacles.start, obstacles.end, self._dt)
        velocities[stays] = self._velocities[stays]
        self._offsets, self._velocities = obstacles.end, velocities
        self._taken[taken] += 1
        self.steps += 1
        if self._touch is not None:
            self._touch.look(taken, self.time)
        if self.ledger:
            supplied, dissipated, by_obstacles, contact, friction = np.where(taken, self._told.works.T, 0.0)
            self._account[0] += supplied + by_obstacles
            self._account[1] += dissipated + contact + friction
            self._account[2] += by_obstacles
            self._account[3] += contact + friction

    def _obstacles(self, goes: Array) -> Moving:
        """How obstacles move in a step; they stand still beside bodies that do not go (size,)."""
        instants, which = distinct(self.time)
        scene = np.array([self._environment.offsets_at(time + self._dt) for time in instants])
        if not (np.abs(scene) <= FARTHEST).all():
            raise StepError(f"obstacles: use displacements within {FARTHEST:.0e} m; all bodies were left as they were")
        ends = np.where(np.isnan(self._placed), scene[which], self._placed)
        ends[~goes] = self._offsets[~goes]
        return Moving(self._offsets, ends, self._velocities)

    def _loads(self) -> Array:
        """What acts by itself in the step of each body, in the middle of it, (size, loads)."""
        instants, which = distinct(self.time)
        loads = np.array([self._environment.loads_at(time + self._dt / 2) for time in instants])
        bad = np.flatnonzero(~(np.abs(loads) <= self.input_limit).all(axis=1))
        if len(bad):
            raise StepError(
                f"loads at {instants[bad[0]] + self._dt / 2:g} s: {loads[bad[0]].tolist()}: use numbers within "
                f"{self.input_limit:.0e}; all bodies were left as they were"
            )
        return loads[which]

    def _follow_obstacles(self, bodies: Array) -> None:
        """Makes the contact modes active that obstacles are nearest to."""
        assert self._interface is not None
        gaps = np.full((self.size, len(self._points)), np.inf)
        for own, mode in self._by_mode(bodies):
            given = mode.touch, mode.body.inverse_ω, self._shapes
            deal_out(partial(_look, given, (self._offsets, mode.states, np.empty((*gaps.shape, 3)), gaps)), own)
        self.switch(self._interface.points.nearest_modes(gaps[bodies].T, self._mode[bodies]), bodies)


OVERFLOWS = "its input is so large that the step overflows"


@or_numpy
def _step(given: Any, between: Any, bodies: Array) -> None:
    step_bodies(*given, bodies, *between)  # type: ignore[call-arg]


def _look(given: Any, between: Any, bodies: Array) -> None:
    look_at_bodies(*given, bodies, *between)  # type: ignore[call-arg]


def inside_message(body: int) -> str:
    """Of one that was put there."""
    return (
        f"body {body} is inside an obstacle: use a start outside of all of them, or "
        'on_error="hold"; all bodies were left as they were'
    )
