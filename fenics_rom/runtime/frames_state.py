"""Bodies of a batch in frames that move with them: where they are in compiled steps, and what can be read of them.

What a compiled step changes of a body are some of the arrays in its table; these are stacked, bodies first. The
simulator is put where a body is by copying them, and a body where the simulator is in the same way.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.base_path import BaseState, base_in
from fenics_rom.mechanics.frame_motion import world_displacement
from fenics_rom.mechanics.step import StepperState
from fenics_rom.rom.moving_frame import MovingFrame
from fenics_rom.runtime.compiled.arrays_at import table_of
from fenics_rom.runtime.compiled.carried_strains import HAS_TANGENT, IS_AHEAD, VELOCITY
from fenics_rom.runtime.compiled.frame_tables import (
    BEFORE,
    BENT,
    CARRIED,
    HALVES,
    IS_KNOWN,
    KEPT,
    NOTES,
    NOW,
    OWN,
    RELAXED,
    STRAINED,
    VECTORS,
)
from fenics_rom.runtime.compiled.frames import (
    AWAY,
    BENDING,
    FASTEST,
    INERTIA,
    IS_SHAPE_KNOWN,
    LOOKED_AT,
    MOTION,
    REST,
    WRENCH,
)
from fenics_rom.runtime.compiled.linear_step import State
from fenics_rom.runtime.compiled_bodies import CompiledBodies
from fenics_rom.runtime.simulator import Simulator
from fenics_rom.runtime.steppers import compiled_frame
from fenics_rom.runtime.steppers.compiled_frame import CompiledFrame
from fenics_rom.runtime.steppers.moving_frame import FrameSnapshot, MovingFrameStepper
from fenics_rom.runtime.steppers.training_watch import TRUSTED_EXTENT
from fenics_rom.runtime.world_axes import turned, world_outputs, world_rates

if TYPE_CHECKING:
    from fenics_rom.runtime.steppers.frame_kernel import FrameKernel


OF_LAW = 3  # of what a step returns to: from there on it is what the law of large deformation carries along


class FrameMode(NamedTuple):
    """A contact mode; the first of these are as in `Mode`."""

    name: str
    body: Any
    states: State  # of all bodies; those of bodies in other modes say nothing
    loops: CompiledFrame  # of the simulator
    arrays: tuple[Array, ...]  # in a table: those of a row that is `own` are the simulator's
    own: dict[int, Array]  # of each body, by the rows of its table
    tables: Array  # of the bodies (B, n, 4)

    @property
    def bends(self) -> bool:
        """Whether bodies deform largely."""
        return self.loops.bent is not None

    @property
    def returns(self) -> list[tuple[Array, Array]]:
        """What a step changes, bodies first, and what that was before."""
        own, states = self.own, self.states
        pairs = [
            (states.halves, states.halves_before),
            (states.beyond, states.beyond_before),
            (own[NOW][:, 0], own[NOW][:, 1]),
        ]
        if self.bends:
            carried = own[VECTORS][:, VELOCITY], own[CARRIED], own[STRAINED], own[RELAXED]
            pairs += [(part, own[BEFORE + k]) for k, part in enumerate(carried)]
        return pairs


class FramesState(CompiledBodies):
    """Arguments, properties and methods as of `CompiledBodies`."""

    _modes: list[FrameMode]  # type: ignore[assignment]

    def __init__(self, single: Simulator, size: int, ledger: bool):
        self._at_start = cast(FrameSnapshot, single.integrator.snapshot().frame)
        self._squares, self._goes, self._ends = np.zeros(size), np.zeros(size, bool), np.zeros((size, 13))
        self._noted = np.zeros((3, size))  # strained, mismatch and distance, at most
        super().__init__(single, size, ledger)
        self._put_at_rest(np.arange(size))

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._make_modes(is_same=True)

    def _make_modes(self, *, is_same: bool = False) -> None:
        known, self._modes = {mode.name: mode for mode in self._modes}, []
        for name in self.rom.contact_models:
            self._stepper.restore(name, self._at_rest(name), self._dt)
            loops, residual = self._loops, self._kernel.residual
            rows = OWN if loops.bent is None else (*OWN, *BENT)
            if name in known:
                own, states = known[name].own, known[name].states
            else:
                own = {row: np.zeros((self.size, *loops.arrays[row].shape)) for row in rows}
                width = 0 if residual is None else residual.states[0].shape[1]
                sizes = (0, 0), (0,), (4, width), (0, 2, 0), (0, 2, 0), (0,)
                states = State(*(np.zeros((self.size, *shape)) for shape in sizes * 2))
                states = states._replace(halves=own[HALVES], halves_before=own[HALVES + 1])
            tables = np.tile(table_of(loops.arrays), (self.size, 1, 1))
            for row, stack in own.items():
                tables[:, row, 0] = stack.ctypes.data + stack.strides[0] * np.arange(self.size)
            mode = FrameMode(name, loops.parts[0], states, loops, loops.arrays, own, tables)
            self._modes.append(mode)
            if not is_same:  # but for how it moves, and did, nothing is known of steps of another length
                own[KEPT][:, 1 if self._is_carried else 2 : WRENCH] = 0.0
                if mode.bends:
                    own[STRAINED][:, [HAS_TANGENT, IS_AHEAD]] = own[IS_KNOWN][:] = 0.0

    def _at_rest(self, name: str) -> StepperState:
        return super()._at_rest(name)._replace(frame=self._at_start)

    def _by_mode(self, bodies: Array | None = None) -> list[tuple[Array, FrameMode]]:  # type: ignore[override]
        return cast(list[tuple[Array, FrameMode]], super()._by_mode(bodies))

    @property
    def _stepper(self) -> MovingFrameStepper:
        return cast(MovingFrameStepper, self._single.integrator)

    @property
    def _kernel(self) -> "FrameKernel":
        return cast("FrameKernel", self._stepper.kernel)

    @property
    def _loops(self) -> CompiledFrame:
        assert self._kernel.loops is not None
        return self._kernel.loops

    @property
    def _frame(self) -> MovingFrame:
        assert self.rom.moving_frame is not None
        return self.rom.moving_frame

    @property
    def _is_carried(self) -> bool:
        return self._single.is_carried

    def _enter(self, body: int) -> MovingFrameStepper:
        self._rub(float(self._friction[body]))
        mode, stepper, search = self._modes[self._mode[body]], self._stepper, self._search_of(body)
        own, beyond = mode.own, mode.states.beyond[body]
        frame = compiled_frame.frame_in(own[NOW][body, 0])
        wrench = compiled_frame.two_vectors(own[KEPT][body, WRENCH:REST])
        notes = dict(zip(compiled_frame.NOTES, own[NOTES][body, :LOOKED_AT].tolist(), strict=True))
        if search is not None:  # what it keeps may be of another friction
            search = search._replace(laws=(), frames=None, is_steady=False, unturned=0, planes=None)
        carried = np.empty(0) if mode.bends else beyond.ravel()
        now = mode.states.halves[body].ravel(), np.empty(0), carried, self._contact_of(body), search, notes
        snapshot = FrameSnapshot(frame, None, wrench)
        stepper.restore(mode.name, StepperState(*now, np.empty(0), frame=snapshot), self._dt)
        if self._kernel.residual is not None:
            self._kernel.residual.states[0][:] = beyond
        for row, stack in own.items():
            self._loops.arrays[row][...] = stack[body]
        is_moving = own[KEPT][body, IS_SHAPE_KNOWN] != 0
        self._kernel.learn_of_loops(float(self._squares[body]), is_moving=bool(is_moving))
        return stepper

    def _leave(self, body: int) -> None:
        kernel, self._mode[body] = self._kernel, self._numbers[self._stepper.contact_mode]
        mode = self._modes[self._mode[body]]
        kernel.flush()
        kernel.tell_loops()
        for row, stack in mode.own.items():
            stack[body] = self._loops.arrays[row]
        mode.own[KEPT][body, WRENCH:REST] = np.ravel(self._stepper.kernel.wrench)
        if kernel.residual is not None:
            mode.states.beyond[body] = kernel.residual.states[0]
        self._squares[body] = 2 * kernel.energy

    def _leave_step(self, body: int) -> None:
        pairs = self._modes[self._mode[body]].returns
        before = [now[body].copy() for now, _ in pairs]
        self._leave(body)
        for (_, kept), part in zip(pairs, before, strict=True):
            kept[body] = part

    def _put_at_rest(self, bodies: Array) -> None:
        if not len(bodies):
            return
        self._stepper.reset()
        self._leave(int(bodies[0]))
        mode = self._modes[0]
        for stack in (*mode.own.values(), mode.states.beyond, self._squares):
            stack[bodies] = stack[bodies[0]]
        self._noted[:, bodies], self._goes[bodies] = 0.0, False

    # --- what can be read --------------------------------------------------------------------------------------------

    @property
    def energy(self) -> Array:
        """(size,), J."""
        return self._squares / 2

    def _read(self, of: Callable[[FrameMode], Array]) -> Array:
        """Numbers of all bodies, of those that a contact mode has of all (B, ...)."""
        read = np.empty_like(of(self._modes[0]), order="C")
        for own, mode in self._by_mode():
            read[own] = of(mode)[own]
        return read

    @property
    def _frames(self) -> Array:
        """Where frames are, (B, 13); of free bodies the last three are angular momenta."""
        return self._read(lambda mode: mode.own[NOW][:, 0, :INERTIA])

    @property
    def base(self) -> BaseState:
        """Of arrays (size, 3) and (size, 4)."""
        frames = self._frames
        base = BaseState(*(part.T.copy() for part in base_in(frames.T)))
        if self._is_carried:
            return base
        is_known = self._read(lambda mode: mode.own[KEPT][:, IS_SHAPE_KNOWN]) != 0
        turning = turned(base, self._read(lambda mode: mode.own[NOW][:, :1, MOTION : MOTION + 3]))[:, 0]
        for body in (~is_known).nonzero()[0].tolist():
            turning[body] = self._enter(body).pose.angular_velocity
        return base._replace(angular_velocity=turning)

    @property
    def base_wrench(self) -> tuple[Array, Array]:
        """(size, 3), N and N m."""
        wrench = np.where(self._goes[:, None], self._read(lambda mode: mode.own[KEPT][:, WRENCH:REST]), 0.0)
        return wrench[:, :3], wrench[:, 3:]

    @property
    def base_misfit(self) -> Array:
        """(size,)."""
        misfit: Array = self._read(lambda mode: mode.own[NOTES][:, AWAY:LOOKED_AT]).max(axis=1)
        return misfit

    @property
    def beyond_training(self) -> Array:
        """(size,)."""
        notes, body = self._read(lambda mode: mode.own[NOTES][:, :LOOKED_AT]), self.rom.deformation
        beyond = self._kernel.watch.went_too_far(notes[:, BENDING], notes[:, FASTEST])
        if body is not None:
            beyond = beyond | (self._noted[2] > TRUSTED_EXTENT * body.training_radius)
        return beyond

    @property
    def mismatch(self) -> Array:
        """(size,)."""
        return self._noted[1].copy()

    def displacement(self, output: str) -> Array:
        """(size, points, 3), m."""
        return world_outputs(self._frame, self.base, output, super().displacement(output))

    def velocity(self, output: str) -> Array:
        """(size, points, 3), m/s."""
        return world_rates(self._frame, self.base, output, super().displacement(output), super().velocity(output))

    def shape(self, body: int) -> Array:
        """(nodes, 3), m."""
        pose, field = base_in(self._frames[body]), super().shape(body)
        return world_displacement(pose, self._frame.origin, self.rom.nodes, field)

    def whereabouts(self, bodies: Array) -> tuple[Array, Array, Array, Array]:
        """As in CompiledState."""
        q, mode, offsets, _ = super().whereabouts(bodies)
        return q, mode, offsets, self._frames[bodies, :7].T
