"""Steps of a held body that compiled functions take, one by one or in a row, and what the body notes of them."""

import math
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.contact import ContactSolution, ContactWork, ObstacleMotion
from fenics_rom.runtime.steppers.elastic.carried_strains import StrainsCarried
from fenics_rom.runtime.steppers.elastic.law import ElasticLaw
from fenics_rom.runtime.steppers.held_adjoint import HeldAdjoint
from fenics_rom.runtime.steppers.held_solution import Solution
from fenics_rom.runtime.steppers.kernel import BOOKED_TOGETHER, ContactWorks, StepWork

if TYPE_CHECKING:
    from fenics_rom.runtime.compiled.held_step import Step
    from fenics_rom.runtime.steppers.bent_in_loops import BentInLoops
    from fenics_rom.runtime.steppers.compiled_held import Beginning, CompiledHeld, HeldStepsTaken


class HeldByLoops(HeldAdjoint):
    """What of a held body loops do, where they are compiled, and know all that acts on it."""

    _has_loops: bool  # whether functions are compiled, as the body was made: it goes on as it began
    _watched: dict[str, float] | None = None  # notes by which loops say what is new
    _law: "ElasticLaw | None" = None
    _ahead: "CompiledHeld | None" = None  # loops that took steps of which the law does not know

    @property
    def elastic(self) -> "ElasticLaw | None":
        """As in PartedKernel; it is told what loops did since it was last asked."""
        if self._ahead is not None:
            self._ahead.settle()
            self._ahead = None
        return self._law

    @elastic.setter
    def elastic(self, law: "ElasticLaw | None") -> None:
        self._law = law

    def _step_alone(self, u: Array) -> float | None:
        """A step under u (p,) of a body that nothing touches or pulls by strokes; None: NumPy is to take it.

        Twice the stored energy, J. What is noted of steps is looked at where one is new.
        """
        if self.notes is not self._watched:
            self._watch()
        taken = self.loops.take_alone(u, self._halves, self.tangent)
        if taken is None:
            return None
        (square, supplied, dissipated, is_new), self._ahead = taken, self.loops
        if len(self._owed) == BOOKED_TOGETHER:
            self.flush()
        self._owed.append((supplied, dissipated, (), 0.0))
        self._notes_before, self._expectation, self.taken = self.notes, None, ()
        if is_new:
            self._take_note(u)
        elif self.branches is not None:
            self._ahead.settle()  # who reads branches does not ask the law
        return square

    def _take_note(self, u: Array) -> None:
        """Notes the last step, under u (p,), in which something is new."""
        self._notes_before, self.tangent = dict(self.notes), self.loops.tangent
        assert self.elastic is not None
        assert self._extent is not None
        self.elastic.note(self.notes)
        self._extent.look(self.notes, u, self._e * self._inverse_ω, None, self.h)
        self._watch()

    def _watch(self) -> None:
        """Has loops say what is new beside what is noted."""
        self._watched, notes = self.notes, self.notes
        assert self._extent is not None
        self.loops.watch(*self._extent.limits(notes), notes["strained"])

    def _beginning(self, obstacles: ObstacleMotion | None) -> "Beginning":
        """What loops begin a step with."""
        from fenics_rom.runtime.steppers.compiled_held import Beginning

        return Beginning(self._halves, self.tangent, obstacles, self.contact, self.reactions)

    @property
    def _reactions_of_loops(self) -> Array:
        """Forces of strokes in the last step that loops took."""
        found = self.loops.reactions
        return self.reactions if found is None else found

    @property
    def strokes_in_loops(self) -> Array | None:
        """By how much chambers are larger than at rest, (n,) of forces that are found, m³; None: NumPy takes steps."""
        if self._compiled is None or self._compiled.pull is None:
            return None
        return self._compiled.strokes_at(self._halves)

    @property
    def loops(self) -> "CompiledHeld":
        """What takes steps where `is_compiled`."""
        assert self._compiled is not None
        return self._compiled

    def _take_over(self, u: Array, law: ElasticLaw, solution: Solution) -> None:
        """Takes the step under u (p,)."""
        raise NotImplementedError

    def in_world(self) -> tuple[Any, ...] | None:
        """What a BentInLoops is made of, in worlds, of bodies whose shape loops know; None of others."""
        law, points = self.elastic, 0 if self._interface is None else len(self._interface.points.coordinates)
        if not (self._found is None and isinstance(law, StrainsCarried)):
            return None
        from fenics_rom.runtime.steppers.compiled_deformation import is_known  # here, as numba takes time to import

        if not is_known(law, self._body):
            return None
        return self._body, law, self.loads.following, np.zeros(3), points, True, self.h

    @property
    def halves(self) -> tuple[Array, Array]:
        """[e, r] (2, m), now and before the last step."""
        return self._halves, self._state_before.reshape(2, -1)

    @property
    def of_points(self) -> Array:
        """Sᵀ (m, 3P)."""
        return self._Sᵀ

    def end_in_world(self, u: Array, bent: "BentInLoops") -> None:
        """Takes note of a step under u (p,) by which loops of worlds have changed the state."""
        law, q = self.elastic, self._e * self._inverse_ω
        assert law is not None
        assert self._extent is not None
        bent.hand_on(q, self.contact)
        self.tangent, self._expectation, self.taken, self.notes = bent.inverse_tangent, None, (), dict(self.notes)
        law.note(self.notes)
        self._extent.look(self.notes, u, q, self.contact, self.h)

    def _compiled_step(self) -> "CompiledHeld | None":
        """What takes steps where loops are compiled, and there is nothing that they do not know."""
        law, solver = self.elastic, None if self._interface is None else self._interface.solver
        if not (self._has_loops and law is not None and self.h > 0):
            return None
        from fenics_rom.runtime.steppers.compiled_held import CompiledHeld  # here, as numba takes time to import

        others = solver, self._Sᵀ, self.residual, self._found, self._ω, self._inverse_ω, self.h
        made = CompiledHeld.of(self._body, law, self.loads, *others)
        if made is not None and made.is_alone and self._extent is not None:
            self._watched = None
            made.note_in(self._state_before.reshape(2, -1), self._extent.watched)
        return made

    def _end_compiled(self, u: Array, law: ElasticLaw, step: "Step", contact: ContactSolution | None) -> float:
        """Takes note of a step that a compiled function took; twice the stored energy, J."""
        assert self._compiled is not None
        motion, of_contact = self._compiled.motion, (step.by_obstacles, step.contact, step.friction)
        contacts: ContactWorks = ()
        if contact is not None:
            contacts, self._at_touch = (partial(ContactWork, *of_contact),), (None, self._compiled.beyond)
        self.tangent, self._expectation = self._compiled.tangent, None
        work = StepWork(step.supplied, step.dissipated, contacts)
        self._take_over(u, law, Solution(motion.e, motion.r, contact, self._reactions_of_loops, work, ()))
        return step.square

    @property
    def is_compiled(self) -> bool:
        """Whether compiled functions take steps."""
        return self._compiled is not None

    def roll(self, inputs: Array, path: ObstacleMotion | None, amounts: Array) -> "HeldStepsTaken | None":
        """Takes steps under inputs (n, p) among obstacles on a path (`in_step`), as many as loops find; None: none.

        No step is to be taken back after them. `amounts`: as in ContactMidpoint.
        """
        law, halves = self.elastic, self._halves.copy()
        if self._compiled is None or law is None:
            return None
        start = self._beginning(path)._replace(halves=halves)
        taken = self._compiled.take_many(inputs, start, amounts)
        if taken is None:
            return None
        self.flush()
        steps, count = taken.steps, len(taken.steps.q)
        if self._ledger is not None:
            supplied, dissipated, by_obstacles, contact, friction = map(math.fsum, steps.works.T)
            self._ledger.book(supplied=supplied, dissipated=dissipated)
            self._ledger.book_contact(by_obstacles, contact, friction, 0.0)
        self._halves[:], self.contact, self.tangent = halves, taken.contact, self._compiled.tangent
        self.reactions, acting = self._reactions_of_loops, inputs[:count]
        if self._found is not None:
            acting = acting.copy()
            acting[:, self._found.actuators.columns] = steps.reactions
        self._remember()
        law.note_all(self.notes, steps.noted)
        assert self._extent is not None
        self._extent.look_along(self.notes, acting, steps.q, steps.by_obstacle, self.h)
        return taken
