"""Steps of passive midpoint integration among obstacles, of one contact mode.

Contact points have the displacement S x, S their rows of the basis. In a step of passive midpoint integration

    v̂ = A⁻¹ (G u + 2/h r - ω e + Sᵀ f),

with forces f that contact needs for the free velocity S v̂ without them and the Delassus operator W = S A⁻¹ Sᵀ.

Actuators by stroke, and tendons that rub, have forces z that are found with those of contact: G u + B z is in place of
G u, with their columns B.

Branches of a material that relaxes (mechanics/viscoelasticity.py) have energy coordinates ω w, too. In a step they pull
with -ω Σ g (ω w)/(1 + θ h/τ), and add their stiffening time to h/2 in A: modes that are apart stay so.
"""

import math
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import compiled, in_plain
from fenics_rom.mechanics.actuator_forces import ActuatorForces
from fenics_rom.mechanics.contact import ContactSolution, ContactWork, ObstacleMotion
from fenics_rom.mechanics.kept_rows import RowsOperator
from fenics_rom.mechanics.points_operator import components, operator_of, whole_of
from fenics_rom.rom.block_rows import BlockRows
from fenics_rom.rom.midpoint_map import compliance
from fenics_rom.runtime.steppers.adjoint import contact_adjoint
from fenics_rom.runtime.steppers.clearance import Clearance
from fenics_rom.runtime.steppers.following_midpoint import FollowingMidpoint
from fenics_rom.runtime.steppers.kernel import BOOKED_TOGETHER, ContactWorks, StepWork
from fenics_rom.runtime.steppers.taken_step import found_taken, linear_taken, residual_taken

MOST_FOUND = 50  # forces of actuators, of which loops tell in one number
# A step without contact: G u, the same with elasticity and inertia, N kg^-1/2, and v̂, (m,) each.
_Step = tuple[Array, Array, Array]

if TYPE_CHECKING:
    from fenics_rom.runtime.compiled.linear_actuators import Pulled
    from fenics_rom.runtime.steppers.compiled_step import CompiledStep, StepsTaken, StepTaken
    from fenics_rom.runtime.steppers.parted_adjoint import PartedAdjoint


class ContactMidpoint(FollowingMidpoint):
    """The midpoint step with contact. Arguments and attributes as in BookedKernel."""

    compiled_step: "CompiledStep | None" = None  # what takes steps by loops; None where they do not

    @property
    def answers_linearly(self) -> bool:  # type: ignore[override]
        """As in Kernel: not where forces of actuators are found with those of contact."""
        return self._actuators is None

    def set_time_step(self, h: float) -> None:
        """As in Kernel."""
        super().set_time_step(h)
        self._points = None
        relaxing = () if self.branches is None else (self.branches.stiffening_time, self.branches.share)
        self._a, self._Ra = compliance(self._model, h, *relaxing)
        self._answered = b"", np.empty((0, 0))  # of which points, and how
        if self._interface is not None:
            self._delassus = self._operator_by(_applied(self._a, self._Sᵀ))
        if self._actuators is not None:
            self._columns = self._model.inputs[:, self._actuators.columns]
            self._spread = _applied(self._a, self._columns)
        self._pushed_by, self._heat_of = (A.__mul__ if A.ndim == 1 else A.dot for A in (self._a, self._Ra))
        self._elastic_and_inertial = np.stack([-self._ω, np.full(self._model.order, 2 / h)])
        self._travel = h * self._ω
        self._clearance = Clearance(self._Sᵀ, h)
        self.compiled_step = self._make_compiled_step()

    def _make_compiled_step(self) -> "CompiledStep | None":
        """What takes steps where loops are compiled, and there is nothing that they do not know."""
        solver = None if self._interface is None else self._interface.solver
        if not compiled() or (solver is None and self._interface is not None) or len(self.reactions) > MOST_FOUND:
            return None
        from fenics_rom.mechanics.compiled_contact import CompiledContact  # here, as numba takes time to import
        from fenics_rom.runtime.compiled.linear_step import Body, State
        from fenics_rom.runtime.steppers.compiled_step import (
            YIELDS_AS_A_WHOLE,
            CompiledStep,
            Relaxing,
            inverse_of,
            yielding_of,
        )

        if not (solver is None or isinstance(solver, CompiledContact)):
            return None
        branches, beside = self.branches, None if self.residual is None else self.residual.branches
        coefficients, share = np.zeros((8, 0)), np.empty((0, 0))
        if branches is not None:
            coefficients, share = branches.numbers, share if branches.share is None else in_plain(branches.share)
        A, heat = (each if each.ndim == 2 else np.diag(each) for each in (self._a, self._Ra))
        R: Array | RowsOperator[BlockRows] = np.empty((0, 0))
        times, (beyond, beyond_before) = (0.0, 1.0, 0.0, 0.0), np.zeros((2, 4, 0))
        if self.residual is not None:
            R, times, (beyond, beyond_before) = self.residual.part.operator, self.residual.times, self.residual.states
        if self._actuators is not None and isinstance(R, RowsOperator):
            return None  # loops hold back points by W as a whole
        ω, inverse_ω, inputs, A, heat = map(in_plain, (self._ω, self._inverse_ω, self._model.inputs, A, heat))
        at = np.zeros((0, 3)) if solver is None else solver.points
        points, places = map(in_plain, (self._Sᵀ, at))
        if isinstance(R, np.ndarray):
            W = in_plain(whole_of(self._delassus))
            inverse = inverse_of(W) if self._actuators is None else np.empty((0, 0))
            of_points = W, inverse, in_plain(R), YIELDS_AS_A_WHOLE
        else:
            none, root = np.empty((points.shape[1], 0)), np.sqrt(A) if self._a.ndim == 1 else np.linalg.cholesky(A)
            of_points = none, np.empty((0, 0)), none, yielding_of(R, np.ascontiguousarray(points.T @ root))
        given = ω, inverse_ω, inputs, A, heat, points, places, *of_points, coefficients, share
        body = Body(*given, *times, self.pulled)
        count = coefficients.shape[1]
        within, outside = Relaxing(branches, count, len(ω)), Relaxing(beside, count, beyond.shape[1])
        reactions = np.zeros((2, len(self.reactions)))
        now = self._halves, self._rigid_displacement, beyond, within.rows, outside.rows
        before = self._state_before.reshape(2, -1), self._rigid_before, beyond_before
        state = State(*now, reactions[0], *before, within.rows_before, outside.rows_before, reactions[1])
        return CompiledStep(body, self._delassus, state, solver, self.h, (within, outside))

    @property
    def has_gas(self) -> bool:
        """Whether some of the forces that are found are those of gas."""
        return self._actuators is not None and bool(self._actuators.gases)

    @property
    def pulled(self) -> "Pulled":
        """What forces are found in steps, as loops have it."""
        from fenics_rom.mechanics.compiled.searched_forces import Actuators  # here, as numba takes time to import
        from fenics_rom.runtime.compiled.linear_actuators import Pulled

        (m, width), given = self._Sᵀ.shape, Actuators.of(self._actuators, self._model.inputs.shape[1])
        if self._actuators is None:
            return Pulled(given, np.zeros((0, m)), np.zeros((0, m)), np.zeros((0, 0)), np.zeros((0, width)))
        B, spread = self._columns, self._spread
        lines, by_forces = (np.ascontiguousarray(columns.T) for columns in (B, spread))
        return Pulled(given, lines, by_forces, self._actuators.compliance(B.T @ spread), spread.T @ self._Sᵀ)

    def step(self, u: Array, obstacles: ObstacleMotion | None = None) -> float:
        """As in Kernel."""
        if (
            self.compiled_step is not None
            and (obstacles is not None or self._interface is None)
            and (taken := self.compiled_step.take(u, obstacles, self.reactions))
        ):
            return self._end_compiled(taken)
        if self._actuators is not None:
            return self._step_by_strokes(self._actuators, u, obstacles)
        if self._clearance.lasts(obstacles, self.state, self._rigid_displacement):
            step, beyond = self._begin_step(u), self._speed_beyond
            if self._clearance.is_enough(step[2], self._r, beyond):
                return self._end_clear(step, beyond)
        points = self._points_to_follow(obstacles)
        if points is not None and points.solver.search.planes is not None:
            points = self._points_at_planes(points, points.solver.search.planes)
        if points is not None and (found := self._follow(points, u)) is not None:
            return self._end_followed_step(points, *found)
        step = self._begin_step(u)
        contact = self._solve_contact(self._coordinates(), self._r, step[2], self.h, obstacles)
        if obstacles is None or self._interface is None or not self._interface.solver.clear:
            return self._end_step(step, contact)
        self._clearance.set(self._interface.solver.clear, obstacles)
        return self._end_clear(step, self._speed_beyond)

    @property
    def _speed_beyond(self) -> float:
        """At most, of the contact points beyond the basis in a step without contact, m/s."""
        if self.residual is None or self.residual.is_at_rest:
            return 0.0
        return math.sqrt(3) * float(np.abs(self.residual.points[1:]).max())

    def _end_clear(self, step: _Step, beyond: float) -> float:
        """Takes a step out of reach of obstacles, in which points move beyond the basis by at most this speed, m/s."""
        assert self._interface is not None
        self._interface.solver.pass_by()
        is_plain = beyond == 0.0 and self.branches is None
        twice = self._end_plain(step) if is_plain else self._end_step(step, None)
        self._clearance.go_on(step[2], beyond, self.state, self._rigid_displacement)
        return twice

    def _end_plain(self, step: _Step) -> float:
        """Takes a step that is that of the basis alone."""
        pushed, right, v = step
        if self.residual is not None:
            self.residual.remember()
        heat = self._heat_of(right)
        self._leave(StepWork(self.h * float(pushed.dot(v)), self.h * float(heat.dot(heat)), ()))
        self._move(v)
        self._contact = None
        return float(self.state.dot(self.state))

    def _end_compiled(self, taken: "StepTaken") -> float:
        """Takes note of a step that compiled loops have taken; twice the stored energy, J."""
        works: ContactWorks = ()
        did = taken.did
        if taken.touches:
            works = (partial(ContactWork, did.by_obstacles, did.contact, did.friction),)
        if len(self._owed) == BOOKED_TOGETHER:
            self.flush()
        self._owed.append(StepWork(did.supplied, did.dissipated, works))
        self._note_touch(taken)
        return did.square

    def _note_touch(self, taken: "StepTaken") -> None:
        """Takes note of contact in the last step, which compiled loops have taken."""
        self._contact_before, self._reactions_before, self._notes_before = self._contact, self.reactions, self.notes
        self._contact = taken.contact if taken.touches else None
        if self._actuators is not None and self.compiled_step is not None:
            self.reactions = self.compiled_step.state.reactions.copy()
        if taken.touches:
            self._at_touch = None, None if self.residual is None else taken.beyond

    @property
    def is_compiled(self) -> bool:
        """Whether compiled functions take steps."""
        return self.compiled_step is not None

    @property
    def strokes_in_loops(self) -> Array | None:
        """As in HeldByLoops."""
        return None if self.compiled_step is None else self.compiled_step.strokes

    def roll(self, inputs: Array, path: ObstacleMotion | None, amounts: Array) -> "StepsTaken | None":
        """Takes steps under inputs (n, p) among obstacles on a path (`in_step`), as many as loops find; None: none.

        `amounts`: of gas in chambers, of forces that are found (n,), m³, changed.
        """
        if self.compiled_step is None:
            return None
        taken = self.compiled_step.take_many(inputs, path, self.reactions, amounts)
        if taken is None:
            return None
        self.flush()
        if self._ledger is not None:
            supplied, dissipated, by_obstacles, contact, friction = map(math.fsum, taken.steps.works.T)
            self._ledger.book(supplied=supplied, dissipated=dissipated)
            self._ledger.book_contact(by_obstacles, contact, friction, 0.0)
        self._note_touch(taken.last)
        return taken

    def open(self, u: Array) -> Array:
        """As in Kernel."""
        self._opened = self._begin_step(u)
        free: Array = self._opened[2].dot(self._Sᵀ).reshape(-1, 3)
        return free if self.residual is None else free + self.residual.points[2]

    def answer(self, some: Array) -> Array:
        """As in Kernel."""
        key = some.tobytes()
        if self._answered[0] != key:
            self._answered = key, operator_of(self._delassus, some)
        return self._answered[1]

    def close(self, contact: ContactSolution | None) -> float:
        """As in Kernel."""
        return self._end_step(self._opened, contact)

    @property
    def arrays(self) -> tuple[Array, Array, Array, Array]:
        """A⁻¹, diagonal (m,) or whole, Sᵀ (m, 3P), and [e, r] (2, m), now and before the last step."""
        return self._a, self._Sᵀ, self._halves, self._state_before.reshape(2, -1)

    def inverse_mass(self, some: Array) -> Array:
        """Velocities within the basis of contact points per impulse on them between two steps, (3 s, 3 s), 1/kg."""
        rows = self._Sᵀ[:, components(some)]
        return rows.T @ rows

    @property
    def basis_velocities(self) -> Array:
        """Of the contact points (P, 3), m/s, within the basis: what they yield beyond it has next to no mass."""
        velocities: Array = self._r.dot(self._Sᵀ).reshape(-1, 3)
        return velocities

    def kick(self, impulses: Array) -> None:
        """Adds impulses (P, 3), N s, on the contact points between two steps; they are not booked."""
        self._r += self._Sᵀ.dot(impulses.ravel())

    def _begin_step(self, u: Array) -> _Step:
        pushed = self._model.inputs.dot(u)
        elastic, inertial = self._elastic_and_inertial * self._halves
        right = pushed + elastic
        right += inertial
        if self.branches is not None:
            right -= self._ω * self.branches.pull[0]
        return pushed, right, self._pushed_by(right)

    def _end_step(self, step: _Step, contact: ContactSolution | None, rubbed: Array | None = None) -> float:
        """Takes a step under contact forces; rubbed (m,): forces of guides, which dissipate, but for contact."""
        pushed, right, v = step
        if contact is not None:
            by_contact = self._pushed(contact)
            right += by_contact
        if contact is not None or rubbed is not None:
            v = self._pushed_by(right)
        heat = self._heat_of(right)
        h, supplied, dissipated = self.h, float(pushed.dot(v)), float(heat.dot(heat))
        if rubbed is not None:
            dissipated -= float(rubbed.dot(v))
        residual, relaxed = self._step_residual(contact)
        if self.branches is not None:
            relaxed += self.branches.step((self._ω * v)[None])
        contacts: ContactWorks = ()
        if contact is not None:
            power, self._at_touch = float(by_contact.dot(v)), (v, residual)
            if residual is not None:
                power += float(contact.forces.ravel().dot(residual.ravel()))
            contacts = (partial(contact.work_at, power, h),)
        self._leave(StepWork(h * supplied, h * dissipated + relaxed, contacts))
        self._move(v)
        self.contact = contact
        return 2 * self.energy

    def _move(self, v: Array) -> None:
        """Moves by v̂ (m,)."""
        if len(self._rigid_displacement):
            self._rigid_displacement += self.h * v[: len(self._rigid_displacement)]
        self._e += self._travel * v
        np.subtract(v + v, self._r, self._r)

    def _step_by_strokes(self, actuators: ActuatorForces, u: Array, obstacles: ObstacleMotion | None) -> float:
        """The step where forces of actuators are found with those of contact."""
        u, given = actuators.split(u)
        pushed, right, v = self._begin_step(u)
        q = self._coordinates()
        strokes, rates = np.stack([q, self._r]).dot(self._columns)
        targets = actuators.targets(given, strokes, rates, self.h)
        motion = q, self._r, v, self.h, obstacles
        found, contact = self._solve_actuators(u, self._columns, self._spread, targets, *motion)
        by_strokes, rubbed = actuators.parts(self._columns, found)
        square = self._end_step((pushed + by_strokes, right + by_strokes + rubbed, v), contact, rubbed)
        self.reactions = found
        return square

    def adjoint(self, u: Array) -> "PartedAdjoint":
        """As in Kernel."""
        from fenics_rom.runtime.steppers.acts.found_forces import FoundForces
        from fenics_rom.runtime.steppers.held_part import HeldPart
        from fenics_rom.runtime.steppers.parted_adjoint import Ends, PartedAdjoint

        h, ρ, given = self.h, len(self._rigid_displacement), None
        (e, r), (_, r_after) = self._state_before.reshape(2, -1).copy(), self.state.reshape(2, -1).copy()
        q, q_after, v = e * self._inverse_ω, self._coordinates().copy(), (r + r_after) / 2
        q[:ρ] = self._rigid_before
        contact, is_kink = contact_adjoint(self._interface)
        (residual, rows), found = residual_taken(self.residual), None
        if self._actuators is not None:
            of = FoundForces(None, self._model, self._actuators)
            found, given = found_taken(of, u, self.reactions, (h, q, r, v, q)), of.stroke_slopes(q).T
        law = linear_taken(self._model, h / 2, q, q_after, v, self.branches)
        columns = self._model.inputs
        part = HeldPart(h, 2 / h, law, columns, None, 0.0, found, self._Sᵀ, contact, residual, r_after)
        ends = Ends(self._model.safe_frequencies, q, q_after, rows)
        return PartedAdjoint((part,), ends, is_kink, given, rows_first=True)


def _applied(matrix: Array, columns: Array) -> Array:
    """The product with a diagonal (m,) or a whole matrix (m, m), of a vector or columns."""
    if matrix.ndim == 2:
        return matrix.dot(columns)
    return matrix * columns if columns.ndim == 1 else matrix[:, None] * columns
