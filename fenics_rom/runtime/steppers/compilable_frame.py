"""A body in a moving frame whose steps compiled functions may take, and what is there after these."""

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.contact import ObstacleMotion
from fenics_rom.mechanics.frame_motion import Rotation, rotation_of
from fenics_rom.runtime.steppers.elastic.carried_strains import StrainsCarried
from fenics_rom.runtime.steppers.expected_step import Expected
from fenics_rom.runtime.steppers.frame_loads import FrameForces
from fenics_rom.runtime.steppers.frame_state import FrameState, Shape
from fenics_rom.runtime.steppers.kernel import BOOKED_TOGETHER, ContactWorks, StepWork
from fenics_rom.runtime.steppers.parted_kernel import PartedKernel

if TYPE_CHECKING:
    from fenics_rom.runtime.steppers.bent_in_loops import BentInLoops
    from fenics_rom.runtime.steppers.compiled_frame import CompiledFrame, FrameStep, FrameSteps


class CompilableFrame(PartedKernel):
    """Arguments as in PartedKernel; attributes as in FrameKernel."""

    _frame_known: FrameState | None = None  # where the frame is; None where a compiled step knows
    _frame_before_known: FrameState | None = None  # the same before the last step
    _places: Array | None  # of the contact points in the frame, m, if they are known
    _compiled: "CompiledFrame | None" = None
    _motion: Any = None  # how the body moves, and how it did before the step; None where a compiled step knows
    _motion_before: Any = None
    _touched: Array  # mid-step velocities (P, 3) of the contact points in world axes in the last step, m/s
    _twice = 0.0  # the stored energy, if a compiled step knows, J
    _ahead: tuple[Array, ...] | None  # of an expected step what it was found of, and the inverse slopes with that
    _forces: FrameForces  # of the step
    _guided_by: tuple[float, Array] | None = None  # h and ω̂, r̂ of the step before, that a compiled one began with
    expectation: Expected | None = None  # of the last step, where its law asks for one

    @property
    def frame(self) -> FrameState:
        """Where the frame is."""
        if self._frame_known is None:
            assert self._compiled is not None
            self._frame_known = self._compiled.frame()
        return self._frame_known

    @frame.setter
    def frame(self, frame: FrameState) -> None:
        self._frame_known = frame

    @property
    def _frame_before(self) -> FrameState:
        """Where it was before the last step."""
        if self._frame_before_known is None:
            assert self._compiled is not None
            self._frame_before_known = self._compiled.frame_before()
        return self._frame_before_known

    @_frame_before.setter
    def _frame_before(self, frame: FrameState) -> None:
        self._frame_before_known = frame

    def take_by_loops(self) -> "CompiledFrame | None":
        """What compiled functions know of the body, with the state that it is in; None where there is more to it."""
        raise NotImplementedError

    def tell_loops(self) -> None:
        """Has compiled functions know of all that the next step begins with, as far as another step has changed it."""
        assert self._compiled is not None
        if self._compiled.bent is not None:
            self._compiled.bent.begin(self.contact, self._ahead)
            self._guided_by = self._compiled.passed()
        self._compiled.begin(self._frame_known, self.notes)

    @property
    def loops(self) -> "CompiledFrame | None":
        """What takes steps by compiled functions, among obstacles, too; None where these do not know the body."""
        return self._compiled if self.is_compiled else None

    def learn_of_loops(self, square: float, *, is_moving: bool) -> None:
        """Has NumPy know of a state that was put where compiled functions have it.

        Args:
            square: twice the stored energy, J.
            is_moving: whether they know how it moves.
        """
        assert self._compiled is not None
        if is_moving:
            self._motion, self._twice = None, square
        if self._compiled.bent is not None:
            self._ahead = self._compiled.bent.hand_on(self._e * self._inverse_ω, self.contact)

    def end_in_world(self, u: Array, square: float, within: float) -> None:
        """Takes note of a step under contact forces, by which compiled functions have changed the state.

        Args:
            u: inputs (p,) of the step; of one body that deforms largely it was the last of those taken.
            square: twice the stored energy, J.
            within: what of this is in the shape and its rate, J.
        """
        assert self._compiled is not None
        self._frame_known = self._places = self._motion = self._motion_before = None
        self.notes = self._compiled.notes(self.notes)
        self._square, self._twice = within, square
        if self._compiled.bent is not None:
            self._acting = u.copy()
            self._hand_on_bent(self._acting, self._compiled.bent, notes=True)

    def _taken_compiled(self, u: Array, base: Array, obstacles: ObstacleMotion | None) -> "FrameStep | None":
        """A step that compiled functions have taken; None where they do not."""
        if self._compiled is None or not self._is_known(obstacles):
            return None
        if self._compiled.bent is not None:
            self._compiled.bent.begin(self.contact, self._ahead)
            self._guided_by = self._compiled.passed()
        if self._compiled.pull is not None:
            self._compiled.pull.forces[:] = self.reactions
        return self._compiled.take(u, base, self._frame_known, self.notes, obstacles)

    def _is_known(self, obstacles: ObstacleMotion | None) -> bool:
        """Whether compiled functions know all that touches the body."""
        if self._interface is None:
            return True
        is_asked = obstacles is not None and self._interface.environment.mark is None
        return is_asked and self._compiled is not None and self._compiled.touch is not None

    def _end_compiled(self, u: Array, taken: "FrameStep", *, owed: bool = True) -> float:
        """Takes note of a step under u that a compiled function has taken; twice the stored energy, J."""
        assert self._compiled is not None
        (step, contact, works), touch = taken, self._compiled.touch
        if owed:
            if len(self._owed) == BOOKED_TOGETHER:
                self.flush()
            contacts: ContactWorks = () if contact is None else (lambda: works,)
            self._owed.append(StepWork(step.supplied, step.dissipated, contacts))
        self._contact_before, self._reactions_before, self._notes_before = self._contact, self.reactions, self.notes
        self._frame_before_known, self._frame_known = self._frame_known, None
        self._acting, self._places, self._contact = self._with_found(u), None, contact
        if touch is not None:
            self._touched = touch.touched
        self.notes = self._compiled.notes(self.notes)
        self._motion = self._motion_before = None
        self._square, self._twice = step.within, step.square
        if self._compiled.bent is not None:
            self._hand_on_bent(u, self._compiled.bent, notes=owed)
        self._take_found(u)
        return step.square

    def _hand_on_bent(self, u: Array, bent: "BentInLoops", *, notes: bool) -> None:
        """Has NumPy know what a step under u of a body that deforms largely led to, and notes it, if it is to."""
        law, q = self.elastic, self._e * self._inverse_ω
        assert law is not None
        assert self._extent is not None
        self._ahead = bent.hand_on(q, self.contact)
        e_before = self._state_before[: len(q)]
        middle = e_before * self._inverse_ω + self.h / 2 * bent.velocity_before
        self._forces = self._forces_at(middle)
        forces = self._acting, self._forces, bent.pressed_before
        self.expectation = Expected(*forces, *bent.expected(), None, self._guided_by)
        if self._found is not None:  # which it was expected under as they were
            self._take_found(u)
            self._forces = self._forces_at(middle)
        if notes:
            self.notes = dict(self.notes)
            law.note(self.notes)
            self._extent.look(self.notes, self._acting, q, self.contact, self.h)
            self._extent.look_at_frame(self.notes, *bent.felt)

    def _take_found(self, u: Array) -> None:
        """Has forces that compiled functions found be those of the last step, under u (p,)."""
        if self._compiled is not None and self._compiled.pull is not None:
            self.reactions = self._compiled.pull.forces.copy()
            self._acting = self._with_found(u)

    def _with_found(self, u: Array) -> Array:
        """An input (p,) with the forces that were found last."""
        if self._found is None:
            return u
        acting = u.copy()
        acting[self._found.actuators.columns] = self.reactions
        return acting

    @property
    def is_compiled(self) -> bool:
        """Whether compiled functions take its steps, also in a row and of many; where forces are found single ones."""
        if self._compiled is None or self._found is not None:
            return False
        return self._interface is None or self._compiled.touch is not None

    @property
    def strokes_in_loops(self) -> Array | None:
        """By how much chambers are larger than at rest, (n,) of forces that are found, m³; None: nothing is found."""
        return None if self._found is None else self._found.strokes(self._coordinates())

    def roll(self, inputs: Array, bases: Array | None, path: ObstacleMotion | None) -> "FrameSteps | None":
        """Takes steps under inputs (n, p), as many as compiled functions do; None: none.

        `bases`: at the end of each step, (n, 13); None: it stands still. `path`: of obstacles (`in_step`).
        """
        if not self.is_compiled or self._compiled is None or not self._is_known(path):
            return None
        if bases is None:
            bases = np.tile((*self.frame.position, *self.frame.rotation, *np.zeros(6)), (len(inputs), 1))
        if self._compiled.bent is not None:
            self._compiled.bent.begin(self.contact, self._ahead)
        taken = self._compiled.take_many(inputs, bases, self._frame_known, self.notes, path)
        if taken is None:
            return None
        self.flush()
        if self._ledger is not None:
            supplied, dissipated = map(math.fsum, taken.steps.works.T)
            self._ledger.book(supplied=supplied, dissipated=dissipated)
            if taken.works.shape[1]:
                by_obstacles, lost, friction = map(math.fsum, taken.works.T)
                self._ledger.book_contact(by_obstacles, lost, friction, 0.0)
        steps, count = taken.steps, len(taken.steps.q)
        self._end_compiled(inputs[count - 1], taken.last, owed=False)
        if isinstance(self.elastic, StrainsCarried) and self._extent is not None and self._compiled.bent is not None:
            self.notes, (strained, felt) = dict(self.notes), np.split(steps.noted, [2], axis=1)
            self.elastic.note_all(self.notes, strained)
            self._extent.look_along(self.notes, inputs[:count], steps.q, taken.by_obstacle, self.h)
            self._extent.look_at_frame(self.notes, *self._compiled.bent.motions(np.abs(felt).max(axis=0)))
        return taken

    @property
    def _now(self) -> Any:
        """How the body moves."""
        if self._motion is None and self._compiled is not None:
            self._shape_at(self._coordinates(), self._r)  # of which NumPy's steps are to know, too
            e, R = self._e, rotation_of(*self.frame.rotation)
            self._motion = self._motion_told(e * self._inverse_ω, R, *self._compiled.motion())
        return self._motion

    @_now.setter
    def _now(self, motion: Any) -> None:
        self._motion = motion

    @property
    def _now_before(self) -> Any:
        """How it did before the step."""
        if self._motion_before is None and self._compiled is not None:
            e, R = self._state_before[: self._model.order], rotation_of(*self._frame_before.rotation)
            self._motion_before = self._motion_told(e * self._inverse_ω, R, *self._compiled.motion(before=True))
        return self._motion_before

    @_now_before.setter
    def _now_before(self, motion: Any) -> None:
        self._motion_before = motion

    def _forces_at(self, expected: Array) -> FrameForces:
        """What acts in the frame where the shape is expected there (m,)."""
        raise NotImplementedError

    def _shape_at(self, q: Array, r: Array) -> Shape:
        """The inertia there, which the table is of from now on."""
        raise NotImplementedError

    def _motion_told(self, q: Array, R: Rotation, shape: Shape, moving: list[float]) -> Any:
        """How the body moves, as a compiled step tells it."""
        raise NotImplementedError
