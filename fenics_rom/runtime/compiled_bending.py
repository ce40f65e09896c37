"""Many held bodies of one ROM that deform largely, stepped by compiled loops, with obstacles or without.

Each is as it is by itself, to the bit. A contact mode changes inputs only, so that all have one state.
"""

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import compiled, or_numpy
from fenics_rom.mechanics.compiled.obstacle_motion import Moving
from fenics_rom.mechanics.compiled.searched_forces import Actuators
from fenics_rom.mechanics.step import StepperState
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.compiled.branches import RATIO
from fenics_rom.runtime.compiled.carried_strains import (
    ENERGY,
    HAS_TANGENT,
    IS_AHEAD,
    IS_CARRIED,
    LEFT,
    NUMBERS,
    VELOCITY,
)
from fenics_rom.runtime.compiled.held_bodies import Carried, restore_bodies, set_strokes_of, step_bodies
from fenics_rom.runtime.compiled.linear_step import State
from fenics_rom.runtime.compiled.strain_tables import padded
from fenics_rom.runtime.compiled.strokes import Pull
from fenics_rom.runtime.compiled.touching import NO_LAW
from fenics_rom.runtime.compiled_bodies import CompiledBodies
from fenics_rom.runtime.compiled_mode import Mode
from fenics_rom.runtime.simulator import Simulator
from fenics_rom.runtime.steppers.adjoint import NONE
from fenics_rom.runtime.steppers.compiled_deformation import Known, branches_of
from fenics_rom.runtime.steppers.deformation_maps import E_OF_Q
from fenics_rom.runtime.steppers.deformation_maps import Carried as HandedOn
from fenics_rom.runtime.steppers.elastic.carried_strains import StrainsCarried
from fenics_rom.runtime.steppers.elastic.sampled import SampledPoints
from fenics_rom.runtime.steppers.training_watch import TRUSTED_EXTENT
from fenics_rom.runtime.threads import deal_out

if TYPE_CHECKING:
    from fenics_rom.mechanics.active_environment import SignalLike
    from fenics_rom.runtime.steppers.held import HeldBody
    from fenics_rom.runtime.steppers.stepper import ReducedStepper


class CompiledBending(CompiledBodies):
    """Arguments, properties and methods as of `CompiledBodies`."""

    @classmethod
    def made(
        cls, rom: Rom, size: int, dt: float, ledger: bool, signals: "Mapping[str, SignalLike]", detail: str | None
    ) -> "CompiledBending | None":
        """Of a ROM; None where its steps are not compiled.

        They are linearly implicit at any dt where NumPy would take them together, and else what suits dt.
        """
        acting = rom.environment
        if not compiled() or rom.deformation is None or acting.is_moving or not acting.has_inertia:
            return None
        if acting.self_contact:
            return None  # pairs of bodies are those with obstacles
        alone = acting.contact_law is not None or acting.finds_forces or acting.viscoelasticity is not None
        stepper = None if alone else "linearly-implicit"
        single = Simulator(rom, dt, signals=signals, stepper=stepper, detail=detail)
        return cls(single, size, ledger) if single.steps_in_loops else None

    def _make_modes(self) -> None:
        first, size = not self._modes, self.size
        stepper, body = self._single.integrator, self.rom.deformation
        assert body is not None
        m, r = body.order, StrainsCarried.strain_count(body) if isinstance(self._law, StrainsCarried) else 0
        states, self._modes = self._modes[0].states if self._modes else None, []
        self._pulls = dict[str, Pull | None]()
        for name in self.rom.contact_models:
            stepper.restore(name, self._at_rest(name), self._dt)
            loops = self._kernel.loops
            if states is None:
                k = 0 if loops.touch is None else len(loops.touch.R)
                sizes = (2, m), (0,), (4, k), (0, 2, 0), (loops.body.law.branches.shape[1] if k else 0, 2, k), (0,)
                states = State(*(np.zeros((size, *shape)) for shape in sizes * 2))
            self._modes.append(Mode(name, loops.body, loops.touch, states))
            self._pulls[name] = loops.pull
        if first:
            relaxed, N, k = branches_of(self._law).shape, padded((m + 1) * (m + 2) // 2), self._strokes
            own = (9, m), (m, m), (2, r), (NUMBERS,), relaxed, (2, N)
            shapes = *own, (m,), (k,), (m,), (2, r), (NUMBERS,), relaxed, (m,), (k,), (3,)
            self._carried = Carried(*(np.zeros((size, *shape)) for shape in shapes))
            self._notes = np.zeros((3, size))  # strained, mismatch and distance, at most
            self._begin(np.arange(size), np.zeros(size, bool))
        self._carried.numbers[:, [HAS_TANGENT, IS_AHEAD]] = 0.0
        for number in range(size):
            self._set_pushed(number, self._told.forces[number])

    @property
    def _kernel(self) -> "HeldBody":
        return cast("HeldBody", self._single.integrator.kernel)

    @property
    def _law(self) -> Known:
        return cast(Known, self._kernel.elastic)

    def _set_pushed(self, body: int, forces: Array) -> None:
        """Has the last step have had contact forces (P, 3)."""
        touch, pushed = self._modes[0].touch, self._carried.pushed
        pushed[body] = touch.points.dot(forces.ravel()) if touch is not None and forces.any() else 0.0

    def _enter(self, body: int) -> "ReducedStepper":
        stepper, carried, states = self._single.integrator, self._carried, self._modes[0].states
        numbers, contact = carried.numbers[body], self._contact_of(body)
        of_law = [carried.relaxed[body].ravel(), states.beyond[body].ravel(), states.relaxed_beyond[body].ravel()]
        if isinstance(self._law, StrainsCarried):
            strained = carried.strained[body].copy() if numbers[IS_CARRIED] else E_OF_Q
            handed_on = HandedOn(carried.vectors[body, VELOCITY].copy(), strained, *numbers[:4].tolist())
            of_law.insert(0, handed_on.in_one(carried.strained.shape[2]))
        own = states.halves[body].ravel(), np.empty(0), np.concatenate(of_law)
        now = StepperState(*own, contact, self._search_of(body), {}, carried.reactions[body].copy())
        stepper.restore(self._modes[self._mode[body]].name, now, self._dt)
        if numbers[HAS_TANGENT]:
            self._kernel.tangent = carried.tangent[body].copy()
        self._kernel.loops.go_on(carried.pushed[body], contact)
        return stepper

    def _leave(self, body: int) -> None:
        kernel, self._mode[body] = self._kernel, self._numbers[self._single.integrator.contact_mode]
        states, noted = self._modes[0].states, kernel.notes
        kernel.flush()
        states.halves[body] = kernel.state.reshape(2, -1)
        if states.beyond.size and kernel.residual is not None:
            states.beyond[body] = kernel.residual.state.reshape(4, -1)
            if kernel.residual.branches is not None:
                states.relaxed_beyond[body] = kernel.residual.branches.state
        self._take_on(body, kernel.tangent)
        self._carried.pushed[body] = kernel.loops.pushed_by(kernel.contact)
        self._carried.reactions[body] = kernel.reactions
        q, strained = states.halves[body, 0] * self._modes[0].body.inverse_ω, noted.get("strained", 0.0)
        self._carried.noted[body] = strained, noted.get("mismatch", 0.0) ** 2 * strained, q.dot(q)

    def _take_on(self, body: int, tangent: Array) -> None:
        """Has a body go on from what the law carries along."""
        carried, numbers, law = self._carried, self._carried.numbers[body], self._law
        if law.branches is not None:
            carried.relaxed[body] = law.branches.state
        if isinstance(law, SampledPoints):
            numbers[ENERGY] = law.energy_of_points
            return
        handed_on = law.carried
        carried.vectors[body, VELOCITY] = handed_on.velocity
        numbers[:5] = *handed_on[2:], len(handed_on.strained) > 0
        if len(handed_on.strained):
            carried.strained[body] = handed_on.strained
        numbers[[IS_AHEAD, HAS_TANGENT]] = 0.0, len(tangent) > 0
        if len(tangent):
            carried.tangent[body] = tangent

    def _begin(self, bodies: Array, frozen: Array) -> None:
        super()._begin(bodies, frozen)
        states = self._modes[0].states
        for body in bodies.tolist():
            e, r = states.halves[body]
            self._law.resume(e * self._modes[0].body.inverse_ω, r, np.empty(0))
            self._take_on(body, NONE)
            self._carried.reactions[body] = 0.0

    def reset(self, bodies: Array, on_error: str) -> None:
        """As of `Batch`."""
        super().reset(bodies, on_error)
        self._carried.pushed[bodies], self._notes[:, bodies] = 0.0, 0.0

    def switch(self, modes: Array, bodies: Array) -> None:
        """Makes contact modes active, by their numbers (B,), of bodies (B,): what is known ahead is found anew."""
        for body in bodies[self._mode[bodies] != modes].tolist():
            self._carried.numbers[body, [HAS_TANGENT, IS_AHEAD]] = 0.0
            self._set_pushed(body, self._told.forces[body])
        self._mode[bodies] = modes

    def _step_alone(self, body: int, u: Array, obstacles: Moving) -> None:
        carried = self._carried
        carried.velocity_before[body] = carried.vectors[body, VELOCITY]
        carried.strained_before[body] = carried.strained[body]
        carried.numbers_before[body], carried.pushed_before[body] = carried.numbers[body], carried.pushed[body]
        carried.relaxed_before[body], carried.reactions_before[body] = carried.relaxed[body], carried.reactions[body]
        super()._step_alone(body, u, obstacles)

    def _step_together(self, mode: Mode, own: Array, inputs: Array, obstacles: Moving) -> None:
        law = NO_LAW if self._interface is None else self._solver.law_in_steps(self._dt)
        given = mode.body, mode.touch, self._pulls[mode.name], law, self._friction, self._shapes
        between = inputs, obstacles, self._begun, self._after, mode.states, self._filled, self._carried, self._new
        deal_out(partial(_step, given, between), own)

    def _take_back(self, bodies: Array) -> None:
        if len(bodies):
            restore_bodies(bodies, self._modes[0].states, self._carried)
            self._filled.amounts[bodies] = self._filled.before[bodies]

    def _commit(self, taken: Array, stays: Array, obstacles: Moving) -> None:
        super()._commit(taken, stays, obstacles)
        strained, mismatch, distance = self._notes
        of_step, gap, square = self._carried.noted.T
        np.maximum(strained, of_step, out=strained, where=taken)
        seen = taken & (gap > 0) & (strained > 0)
        mismatch[seen] = np.maximum(mismatch[seen], np.sqrt(gap[seen] / strained[seen]))
        np.maximum(distance, np.sqrt(square), out=distance, where=taken)

    @property
    def _found(self) -> Array:
        return self._carried.reactions.copy()

    @property
    def energy(self) -> Array:
        """(size,), J."""
        mode, numbers, beyond = self._modes[0], self._carried.numbers, self._modes[0].states.beyond
        q, r = mode.states.halves[:, 0] * mode.body.inverse_ω, mode.states.halves[:, 1]
        energy: Array = numbers[:, ENERGY] + numbers[:, LEFT] + np.einsum("bm,bm->b", r, r) / 2
        energy += np.einsum("bm,bm->b", q @ mode.body.law.springs, q) / 2
        for relaxed in (self._carried.relaxed, mode.states.relaxed_beyond):
            if relaxed.size:
                w, stressed = relaxed.transpose(2, 0, 1, 3)
                energy += np.einsum("n,bnk,bnk->b", mode.body.law.branches[RATIO], w, stressed) / 2
        if beyond.size:
            g, y, ġ, ẏ = beyond.transpose(1, 0, 2)
            energy += (np.einsum("bp,bp->b", g, y) + mode.touch.τ**2 * np.einsum("bp,bp->b", ġ, ẏ)) / 2
        return energy + self._gas_energy(np.arange(self.size))

    def _strokes_of(self, mode: Mode, bodies: Array) -> tuple[Actuators, Array]:
        pull = self._pulls[mode.name]
        assert pull is not None
        strokes = np.zeros((len(bodies), self._strokes))
        set_strokes_of(pull, mode.states.halves[bodies], mode.body.inverse_ω, strokes)
        return pull.actuators, strokes

    @property
    def beyond_training(self) -> Array:
        """(size,)."""
        assert self.rom.deformation is not None
        beyond: Array = self._notes[2] > TRUSTED_EXTENT * self.rom.deformation.training_radius
        return beyond

    @property
    def mismatch(self) -> Array:
        """(size,)."""
        return self._notes[1].copy()


@or_numpy
def _step(given: Any, between: Any, bodies: Array) -> None:
    step_bodies(*given, bodies, *between)  # type: ignore[call-arg]
