"""Many bodies of one ROM in frames that move with them, stepped by compiled loops: each as a single one, to the bit."""

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import compiled, in_plain, or_numpy
from fenics_rom.errors import StepError
from fenics_rom.mechanics.base_path import BaseState, base_in, checked_base
from fenics_rom.mechanics.compiled.obstacle_motion import Moving
from fenics_rom.mechanics.step import StepInput
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.batch_arrays import distinct
from fenics_rom.runtime.compiled import frame_bodies
from fenics_rom.runtime.compiled.carried_strains import AHEAD, GAP, IS_AHEAD
from fenics_rom.runtime.compiled.frame_bodies import Bodies, Near, Room
from fenics_rom.runtime.compiled.frame_tables import IN_A_STEP, IS_KNOWN, KEPT, NOTES, REMADE, STRAINED
from fenics_rom.runtime.compiled.frames import LOOKED_AT, REST, VELOCITY, WRENCH
from fenics_rom.runtime.compiled_bodies import inside_message
from fenics_rom.runtime.frames_state import OF_LAW, FrameMode, FramesState
from fenics_rom.runtime.simulator import Simulator
from fenics_rom.runtime.steppers.moving_frame import MovingFrameStepper
from fenics_rom.runtime.threads import deal_out

if TYPE_CHECKING:
    from fenics_rom.mechanics.active_environment import SignalLike

# By whether they are among obstacles, whether bases carry them, and whether they deform largely.
LOOPS: dict[tuple[bool, bool, bool], Callable[..., None]] = {
    (False, False, False): frame_bodies.step_free,
    (False, True, False): frame_bodies.step_carried,
    (False, False, True): frame_bodies.step_bent_free,
    (False, True, True): frame_bodies.step_bent_carried,
    (True, False, False): frame_bodies.step_touched_free,
    (True, True, False): frame_bodies.step_touched_carried,
    (True, False, True): frame_bodies.step_touched_bent_free,
    (True, True, True): frame_bodies.step_touched_bent_carried,
}


class CompiledFrames(FramesState):
    """Arguments, properties and methods as of `CompiledBodies`."""

    @classmethod
    def made(
        cls, rom: Rom, size: int, dt: float, ledger: bool, signals: "Mapping[str, SignalLike]", detail: str | None
    ) -> "CompiledFrames | None":
        """Of a ROM; None where its steps are not compiled.

        What another contact mode cannot hold of a shape becomes further modes, for which arrays have no room.
        """
        acting = rom.environment
        if not compiled() or not acting.is_moving or acting.finds_forces or not acting.has_inertia:
            return None
        changes = len(rom.contact_models) > 1 and (rom.deformation is None or acting.switches_itself)
        if (changes and acting.contact_law is not None) or acting.self_contact:
            return None
        stepper = None if rom.deformation is None else "linearly-implicit"
        single = Simulator(rom, dt, signals=signals, stepper=stepper, detail=detail)
        return cls(single, size, ledger) if single.takes_compiled_steps else None

    def _put(self, bodies: Array, put: Callable[[MovingFrameStepper, int], None], on_error: str) -> Array:
        """Puts bodies somewhere; which of them (n,) are inside an obstacle then."""
        inside = np.zeros(len(bodies), bool)
        stacks = [stack for mode in self._modes for stack in (*mode.own.values(), mode.states.beyond)]
        saved = [stack[bodies] for stack in (*stacks, self._squares)]
        try:
            for k, body in enumerate(bodies.tolist()):
                stepper = self._enter(body)
                put(stepper, k)
                self._leave(body)
                inside[k] = self._interface is not None and self._is_inside(self._offsets[body])
                if inside[k] and on_error == "raise":
                    raise StepError(inside_message(body))
        except StepError:
            for stack, part in zip((*stacks, self._squares), saved, strict=True):
                stack[bodies] = part
            raise
        self._goes[bodies] = False
        if self._skin is not None:
            self._skin.forget(bodies)
        return inside

    def _inside(self, bodies: Array, offsets: Array, at_rest: bool = False) -> Array:
        """Which (n,) of the bodies are inside an obstacle at rest."""
        if self._interface is None:
            return np.zeros(len(bodies), bool)
        self._stepper.reset()
        distinct_ones, which = np.unique(offsets[bodies].reshape(len(bodies), -1), axis=0, return_inverse=True)
        found = np.array([self._is_inside(each.reshape(offsets.shape[1:])) for each in distinct_ones])
        inside: Array = found[which.ravel()]
        return inside

    def _is_inside(self, offsets: Array) -> bool:
        """Whether the simulator is, where obstacles have such rows (O, any)."""
        environment = self._environment
        environment.state = environment.state._replace(offsets=offsets)
        try:
            self._single.check_outside_obstacles()
        except StepError:
            return True
        return False

    def set_state(self, q: Array, r: Array, bodies: Array, on_error: str) -> None:
        """As of `Batch`."""
        state = self._checked_state(q, r, bodies)
        orders = [self._models[k].order for k in self._mode[bodies]]
        inside = self._put(
            bodies, lambda stepper, k: stepper.set_state(state[0, k, : orders[k]], state[1, k, : orders[k]]), on_error
        )
        self._begin(bodies, inside)
        if on_error == "reset":
            self.reset(bodies[inside], "hold")

    def reset(self, bodies: Array, on_error: str) -> None:
        """As of `Batch`."""
        super().reset(bodies, on_error)
        self._put_at_rest(bodies)

    def place(self, base: BaseState, bodies: Array) -> None:
        """As of `Batch`."""
        poses = [checked_base(BaseState(*(part[k] for part in base)), "base") for k in range(len(bodies))]
        self._put(bodies, lambda stepper, k: stepper.place(poses[k]), "raise")

    def can_switch(self, modes: Array, bodies: Array) -> bool:
        """Whether bodies can get to contact modes: all but strained ones, unless contact modes share a basis."""
        moving = bodies[self._mode[bodies] != modes]
        strained = [mode.states.halves[own].any() for own, mode in self._by_mode(moving) if not mode.bends]
        return not any(strained)

    def step(self, u: Array, base: BaseState | None, held: Array, on_error: str) -> Array:
        """As of `Batch`, but for "reset", under inputs and bases that are fine but for those of bodies held."""
        told = [(mode.own[KEPT][:, WRENCH:REST], mode.own[NOTES][:, :LOOKED_AT]) for mode in self._modes]
        self._before = [(part, part.copy()) for part in (self._squares, *sum(told, ()))]
        stays = super().step(u, base, held, on_error)
        self._goes[:] = True
        self._goes[stays] = False
        return stays

    def _move_bases(self, base: BaseState | None) -> None:
        if not self._is_carried:
            super()._move_bases(base)
            return
        if base is None:
            instants, which = distinct(self.time)
            bases = self._environment.bases_at(instants + self._dt)
            bases = bases if bases is None else bases[which]
        else:
            length = np.fromiter(map(math.hypot, *base.rotation.T.tolist()), float, self.size)
            turned = base.rotation / np.where(length > 0, length, 1.0)[:, None]
            bases = np.hstack([base.position, turned, *base[2:]])
        self._ends = self._frames if bases is None else in_plain(bases)
        if bases is None:
            self._ends[:, VELOCITY:] = 0.0  # it stands still

    def _all_of(self, body: int, u: Array, obstacles: Moving) -> StepInput:
        every = super()._all_of(body, u, obstacles)
        return every._replace(base=base_in(self._ends[body])) if self._is_carried else every

    def _step_together(self, mode: FrameMode, own: Array, inputs: Array, obstacles: Moving) -> None:  # type: ignore[override]
        near, touch, states = None, mode.loops.touch, mode.states
        if touch is not None and self._interface is not None:
            law = self._solver.law_in_steps(self._dt), self._friction, self._shapes
            beyond = states.beyond, states.beyond_before
            near = Near(*law, obstacles, self._begun, self._after, touch.points, touch.at_rest, *beyond)
        deal_out(partial(self._take_part, mode, inputs, near), own)

    @or_numpy
    def _take_part(self, mode: FrameMode, inputs: Array, near: Near | None, bodies: Array) -> None:
        """Takes the steps of some bodies; those of which matrices are singular are taken otherwise."""
        at, given = np.zeros(1, int), () if near is None else (near,)
        if mode.bends:
            rows = IN_A_STEP if self._is_carried else (*IN_A_STEP, *REMADE)
            arrays = [mode.arrays[row].copy() for row in rows]
            given = *given, Room(np.array(rows), np.array([array.ctypes.data for array in arrays]))
        step = LOOPS[near is not None, self._is_carried, mode.bends]
        while len(bodies):
            try:
                step(Bodies(mode.tables, bodies, inputs, self._ends, self._new, self._squares, at), *given)
                return
            except np.linalg.LinAlgError:
                self._forget(mode, bodies[at], mode.returns[OF_LAW:])
                bodies = bodies[at[0] + 1 :]

    def _forget(self, mode: FrameMode, bodies: Array, returns: list[tuple[Array, Array]]) -> None:
        """Has bodies be where they were before a step, in some of what it `returns` to."""
        for now, before in returns:
            now[bodies] = before[bodies]
        mode.own[KEPT][bodies, :WRENCH] = 0.0
        if mode.bends:
            mode.own[STRAINED][bodies, IS_AHEAD] = mode.own[IS_KNOWN][bodies] = 0.0

    def _take_back(self, bodies: Array) -> None:
        for own, mode in self._by_mode(bodies):
            self._forget(mode, own, mode.returns)
        for now, before in self._before:
            now[bodies] = before[bodies]

    def _commit(self, taken: Array, stays: Array, obstacles: Moving) -> None:
        super()._commit(taken, stays, obstacles)
        if self._modes[0].bends:
            for own, mode in self._by_mode(taken.nonzero()[0]):
                strained, gap = 2 * mode.own[STRAINED][own, AHEAD], mode.own[STRAINED][own, GAP]
                q = mode.states.halves[own, 0] * mode.body.inverse_ω
                lacks = np.sqrt(np.divide(gap, strained, out=np.zeros_like(gap), where=(gap > 0) & (strained > 0)))
                of_step = strained, lacks, np.sqrt(np.einsum("bm,bm->b", q, q))
                self._noted[:, own] = np.maximum(self._noted[:, own], of_step)
