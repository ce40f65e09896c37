"""Large deformation by Newton's iteration in every step."""

import math
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.actuator_forces import SHARE
from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion
from fenics_rom.mechanics.hyperelastic import (
    discrete_gradient_slopes,
    discrete_gradient_stress,
    linear_stress,
    moduli,
    strain,
)
from fenics_rom.runtime.steppers.adjoint import contact_adjoint
from fenics_rom.runtime.steppers.definite import definite_inverse, is_definite
from fenics_rom.runtime.steppers.elastic.sampled import SampledPoints
from fenics_rom.runtime.steppers.finite_strain import FiniteStrainKernel
from fenics_rom.runtime.steppers.kernel import ContactWorks, StepWork, symmetric

if TYPE_CHECKING:
    from fenics_rom.mechanics.contact_adjoint import ContactAdjoint
    from fenics_rom.runtime.steppers.adjoint import ContactStep
    from fenics_rom.runtime.steppers.balance_adjoint import BalanceAdjoint, BalancedPart
    from fenics_rom.runtime.steppers.residual_motion import ResidualMaps

CONVERGENCE_TOLERANCE = 1e-12  # of the largest force in a step
STAGNATION_TOLERANCE = 1e-8  # of it: from here on round-off may be what is left
MAX_ITERATIONS = 30
MAX_PARTS = 64  # that a step which Newton's iteration does not solve is cut into
FAST_CONTRACTION = 0.1  # up to which the tangent of an earlier iteration will do

# The state q, r after a step, the last contact and reactions, and the work.
Solution = tuple[Array, Array, ContactSolution | None, Array, StepWork]


class Part(NamedTuple):
    """A part of a step, as it was solved."""

    h: float  # s
    q: Array  # at its start
    r: Array
    v: Array  # v̂
    reactions: Array
    contact: "ContactStep | None"
    residual: "ResidualMaps | None"


class Newton(FiniteStrainKernel):
    """Newton's iteration in every step. Arguments and attributes as in FiniteStrainKernel."""

    NOTES = ("cut",)  # how many steps were
    _inverse: Array | None = None  # of the last tangent
    _law: SampledPoints
    _taken: tuple[Part, ...] = ()  # of the last step

    def __init__(self, *args: Any, **named: Any):
        super().__init__(*args, **named)
        self._law = SampledPoints(self._body, self.branches)

    @property
    def energy(self) -> float:
        """Stored, J."""
        return self._with_carried_energy(float(self._r.dot(self._r)) / 2 + self._body.energy(self._coordinates()))

    @property
    def messages(self) -> tuple[str, ...]:
        """As in Kernel."""
        if not self.notes["cut"]:
            return super().messages
        cut = f"{self.notes['cut']:.0f} steps were cut into parts, as Newton's iteration did not solve the whole"
        return *super().messages, cut

    def resume(self, auxiliary: Array) -> None:
        """As in Kernel."""
        super().resume(auxiliary)
        self._inverse = None  # so that what follows does not depend on what was before

    def set_time_step(self, h: float) -> None:
        """As in Kernel."""
        super().set_time_step(h)
        self._inverse = None

    def reset_buffer(self) -> None:
        """As in Kernel: forgets the tangent."""
        self._inverse = None
        super().reset_buffer()

    def step(self, u: Array, obstacles: ObstacleMotion | None = None) -> float:
        """As in Kernel; a StepError also where the iteration does not converge, however small the parts of the step."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            solution, parts = self._solution(u, obstacles)
            q, r, contact, reactions, work = solution
            self._leave(work)
            np.multiply(q, self._ω, self._e)
            self._r[:] = r
            self.contact, self.reactions = contact, reactions
            self.notes["cut"] += parts > 1
            E = self._body.strains(q)
            self._note(q, E, self._acting(u))
            return 2 * self._with_carried_energy(float(r.dot(r)) / 2 + self._body.energy(q, E))

    def _solution(self, u: Array, obstacles: ObstacleMotion | None) -> tuple[Solution, int]:
        """Of a step in as few parts as can be solved, and their number; the residual part and branches take theirs.

        Raises:
            StepError: as in `step`; the residual part and branches are where they were.
        """
        parts, carried = 1, [part for part in (self.residual, self.branches) if part is not None]
        try:
            while parts <= MAX_PARTS:
                with ExitStack() as taken_back:
                    for part in carried:
                        taken_back.enter_context(part.in_parts(parts))
                    try:
                        solution = self._in_parts(u, obstacles, parts)
                    except StepError:  # where the iteration led, no forces of strokes or contact may be found
                        if parts == MAX_PARTS:
                            raise
                        solution, self._inverse = None, None
                if solution is not None:
                    return solution, parts
                for part in carried:
                    part.rollback()
                parts *= 2
        finally:
            if parts > 1:
                self._inverse = None  # it is of another length
        raise StepError(
            f"input {u.tolist()}: Newton's iteration does not converge, even in {MAX_PARTS} parts of a step of "
            f"{self.h:g} s; lower dt or the load"
        )

    def _in_parts(self, u: Array, obstacles: ObstacleMotion | None, parts: int) -> Solution | None:
        """A step in so many parts; None where one was not solved."""
        q, r, h = self._coordinates().copy(), self._r.copy(), self.h / parts
        strokes, reactions = self._strokes_at(q), self.reactions
        u, given = (u, strokes) if self._actuators is None else self._actuators.split(u)
        supplied, dissipated, taken = 0.0, 0.0, list[Part]()
        contact: ContactSolution | None = None
        contacts: ContactWorks = ()
        for part in range(parts):
            motion = None if obstacles is None else obstacles.part(part / parts, 1 / parts, self.h)
            solution = self._solved(u, strokes + (part + 1) / parts * (given - strokes), q, r, h, motion)
            if solution is None:
                self._inverse = None  # it is of another length
                return None
            v, force, heat, contact, reactions = solution
            maps = None if self.residual is None else self.residual.maps
            taken.append(Part(h, q, r, v, reactions, self._contact_step, maps))
            residual, heat_of_residual = self._step_residual(contact)
            supplied, dissipated = supplied + h * float(force.dot(v)), dissipated + heat + heat_of_residual
            contacts += self._contacts(v, contact, h, residual)
            q, r = q + h * v, 2 * v - r
        self._taken = tuple(taken)
        return q, r, contact, reactions, StepWork(supplied, dissipated, contacts)

    def _solved(
        self, u: Array, given: Array, q: Array, r: Array, h: float, obstacles: ObstacleMotion | None
    ) -> tuple[Array, Array, float, ContactSolution | None, Array] | None:
        """One step by iteration: v̂, the force of the inputs, what was dissipated (J), contact, and reactions.

        Args:
            u: inputs.
            given: strokes (n,) at its end.
            q, r: the state at its beginning, (m,) each.
            h: its length, s.
            obstacles: how they move in it.
        """
        law, before, is_fresh, v, reactions = self._law, math.inf, False, r.copy(), self.reactions
        law.set_time_step(h)
        law.begin(q)
        if self._actuators is not None:
            targets = self._actuators.rates(given, self._strokes_at(q), r.dot(self._stroke_columns(q)), h)
        for _ in range(MAX_ITERATIONS):
            middle = q + h / 2 * v
            resisting, force = law.force(v), self._loads(u, middle)
            residual = 2 / h * (v - r) + resisting - force
            scale = max(np.abs(part).max() for part in (2 / h * r, 2 / h * v, resisting, force))
            if not math.isfinite(scale):
                return None
            if self._inverse is None:
                self._inverse, is_fresh = self._tangent_inverse(v, h, self._load_slopes(u, reactions, middle)), True
            motion = q, r, v - self._inverse.dot(residual), h, obstacles
            if self._actuators is None:
                contact = self._solve_contact(*motion)
            else:
                columns = self._stroke_columns(middle)
                spread, angles = self._inverse.dot(columns), self._angles(middle)
                reactions, contact = self._solve_actuators(
                    u, columns, spread, targets, *motion, angles=angles, before=reactions
                )
                by_strokes, rubbed = self._actuators.parts(columns, reactions)
                force, residual = force + by_strokes, residual - by_strokes - rubbed
            if contact is not None:
                residual -= self._pushed(contact)
            error = np.abs(residual).max()
            if is_solved(error, before, scale):
                heat = law.heat(v)
                if self._actuators is not None:
                    heat -= h * float(rubbed.dot(v))
                return v, force, heat, contact, reactions
            if error > FAST_CONTRACTION * before and not is_fresh:
                self._inverse, is_fresh = self._tangent_inverse(v, h, self._load_slopes(u, reactions, middle)), True
            else:
                is_fresh = False
            before = error
            v = v - self._inverse.dot(residual)
        return None

    def _tangent_inverse(self, v: Array, h: float, slopes: Array) -> Array:
        """Of 2/h + ∂f̂/∂v̂ less h/2 ∂loads/∂q (m, m) at v̂; without what makes it indefinite.

        It is symmetric where forces are found by operators that have to be, and near the tangent then; else it is the
        tangent itself. The Delassus operator follows it.
        """
        inert = 2 / h * np.eye(self._model.order)
        if self._interface is None and (self._actuators is None or len(self._actuators.columns) == 1):
            strained, turned = self._law.slope(v, is_exact=True)
            tangent = inert + strained + turned - h / 2 * slopes
            if is_definite((tangent + tangent.T) / 2):
                return np.linalg.inv(tangent)
        strained, turned = self._law.slope(v, is_exact=False)
        matrix, turned = inert + strained, turned - h / 2 * slopes
        inverse = definite_inverse(matrix + (turned + turned.T) / 2, matrix)
        if self._interface is not None:
            self._delassus = self._with_residual(symmetric(self._Sᵀ.T @ inverse @ self._Sᵀ))
        return inverse

    def adjoint(self, u: Array) -> "BalanceAdjoint":
        """As in Kernel."""
        u = u if self._actuators is None else self._actuators.split(u)[0]
        solved = [contact_adjoint(self._interface, part.contact) for part in self._taken]
        parts = [self._balanced_part(u, part, contact) for part, (contact, _) in zip(self._taken, solved, strict=True)]
        reactions = [part.reactions for part in self._taken]
        is_kink = any(kink for _, kink in solved)
        return self._balance_adjoint(parts[::-1], reactions[::-1], self._taken[0].q, is_kink)

    def _balanced_part(self, u: Array, part: Part, contact: "ContactAdjoint | None") -> "BalancedPart":
        """A part of a step under forces u (p,), as the linear map that it is nearby."""
        from fenics_rom.runtime.steppers.balance_adjoint import BalancedPart, HeldStrokes

        body, (h, q, r, v, reactions, _, residual), m = self._body, part, self._model.order
        middle, end = q + h / 2 * v, q + h * v
        H, H_start, H_end = (body.displacement_gradients(at) for at in (middle, q, end))
        E, E_end = strain(H_start), strain(H_end)
        viscous = moduli("st_venant_kirchhoff", E, body.viscosity * body.first_lame, body.viscosity * body.shear) / h
        rates = linear_stress((E_end - E) / h, body.viscosity * body.first_lame, body.viscosity * body.shear)
        S = body.weights * (discrete_gradient_stress(body.law, E, E_end, body.first_lame, body.shear) + rates)
        A = body.strain_rates(H).reshape(-1, m)
        of_end, of_start = discrete_gradient_slopes(body.law, E, E_end, body.first_lame, body.shear)
        by_start, by_end = (
            A.T @ np.einsum("cdp,dpk->cpk", body.weights * slope, body.strain_rates(at)).reshape(-1, m)
            for slope, at in ((of_start - viscous, H_start), (of_end + viscous, H_end))
        )
        turned = body.springs + body.geometric(S) - self._load_slopes(u, reactions, middle)
        _, strokes = self._held_strokes(reactions)
        slopes = [stroke.slope(middle).T @ v for stroke in strokes]  # of Bᵀv̂ with the middle
        at_start = [stroke.force(q) for stroke in strokes]
        moved = [stroke.stroke_slope(q) for stroke in strokes]
        bent = [stroke.slope(q).T @ r for stroke in strokes]
        columns = _rows([stroke.force(middle) for stroke in strokes], m)
        held = HeldStrokes(
            columns.T,
            columns + h / 2 * _rows(slopes, m),
            _rows(slopes, m) + SHARE / h * _rows(moved, m) - (1 - SHARE) * _rows(bent, m),
            (SHARE - 1) * _rows(at_start, m),
            -SHARE / h,
        )
        by_velocity = 2 / h * np.eye(m) + body.external_damping + h / 2 * turned + h * by_end
        by_shape = turned + by_start + by_end
        inputs = self._input_columns(middle)
        return BalancedPart(h, 2 / h, by_velocity, by_shape, inputs, held, self._Sᵀ, contact, residual)


def _rows(vectors: list[Array], m: int) -> Array:
    """Vectors (m,) as rows, (n, m)."""
    return np.array(vectors).reshape(-1, m)


def is_solved(error: float, before: float, scale: float) -> bool:
    """Whether forces out of balance, here and an iteration before, are nothing or round-off beside the largest one."""
    return error <= CONVERGENCE_TOLERANCE * scale or (error <= STAGNATION_TOLERANCE * scale and error > before / 2)
