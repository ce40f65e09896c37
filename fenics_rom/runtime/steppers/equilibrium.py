"""Large deformation without inertia: every step is an equilibrium.

On the way there the loads supply ½ (F + F⁺)·(q⁺ - q), with F = Φ'(q) - Sᵀ f that held the body before, f of the step
before. A body of linear elasticity stores that; by how much another one stores less is numerical, of second order in
the step.
"""

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion
from fenics_rom.runtime.steppers.adjoint import contact_adjoint
from fenics_rom.runtime.steppers.definite import is_definite
from fenics_rom.runtime.steppers.finite_strain import FiniteStrainKernel
from fenics_rom.runtime.steppers.kernel import StepWork, symmetric
from fenics_rom.runtime.steppers.newton import MAX_ITERATIONS, MAX_PARTS, Part, is_solved

if TYPE_CHECKING:
    from fenics_rom.runtime.steppers.balance_adjoint import BalanceAdjoint

SMALLEST_DISPLACEMENT = 1e-9  # of the training radius: what is beside it a share of CONVERGENCE_TOLERANCE is at rest


class Equilibrium(FiniteStrainKernel):
    """A step of a quasi-static run: Φ'(q⁺) = G u, from the step before by Newton's iteration under a growing load.

    Arguments and attributes as in FiniteStrainKernel; the velocity stays zero.
    """

    _taken: Part  # the last step

    @property
    def energy(self) -> float:
        """Stored, J."""
        return self._with_carried_energy(self._body.energy(self._coordinates()))

    def step(self, u: Array, obstacles: ObstacleMotion | None = None) -> float:
        """As in Kernel."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            start = self._coordinates().copy()
            strokes, reactions = self._strokes_at(start), self.reactions
            u, given = (u, strokes) if self._actuators is None else self._actuators.split(u)
            held = elastic = self._body.force(start)
            if self._interface is not None and self.contact is not None:
                held = held - self._pushed(self.contact)
            unbalanced = elastic - self._loads(u, start)
            if self._actuators is not None:
                by_strokes, rubbed_before = self._actuators.parts(self._stroke_columns(start), reactions)
                unbalanced, held = unbalanced - by_strokes - rubbed_before, held - rubbed_before
            q, share, growth = start, 0.0, 1.0
            contact: ContactSolution | None = None
            while share < 1:
                part = min(share + growth, 1.0)
                goal = strokes + part * (given - strokes)
                balance = self._balanced(u, goal, obstacles, start, q, (1 - part) * unbalanced)
                if balance is None:
                    growth /= 2
                    if growth < 1 / MAX_PARTS:
                        raise StepError(
                            f"input {u.tolist()}: no equilibrium was found beyond {100 * share:.0f} % of the change of "
                            "the load in this step; take shorter steps or lower the load"
                        )
                else:
                    (q, contact, reactions), share = balance, part
            moved, pushed, rubbed_away, lag = q - start, self._loads(u, q), 0.0, 0.0
            if self._actuators is not None:
                by_strokes, rubbed = self._actuators.parts(self._stroke_columns(q), reactions)
                pushed, elastic = pushed + by_strokes, elastic + rubbed
                rubbed_away, lag = -float(rubbed.dot(moved)), float((rubbed - rubbed_before).dot(moved)) / 2
            elastic = elastic + pushed
            if contact is not None:
                elastic += self._pushed(contact)
            E = self._body.strains(q)
            stored = self._body.energy(q, E)
            numerical = float(elastic.dot(moved)) / 2 - (stored - self._body.energy(start)) + lag
            supplied = float((held + pushed).dot(moved)) / 2
            maps = None if self.residual is None else self.residual.maps
            residual, of_residual = self._step_residual_at_rest(contact)
            contacts = self._contacts_at_rest(moved, contact, obstacles, residual)
            self._leave(StepWork(supplied + of_residual, rubbed_away, contacts, numerical))
            self._taken = Part(self.h, start, self._r, moved / self.h, reactions, self._contact_step, maps)
            np.multiply(q, self._ω, self._e)
            self.contact, self.reactions = contact, reactions
            self._note(q, E, self._acting(u))
            return 2 * self._with_carried_energy(stored)

    def _balanced(
        self, u: Array, given: Array, obstacles: ObstacleMotion | None, start: Array, q: Array, unbalanced: Array
    ) -> tuple[Array, ContactSolution | None, Array] | None:
        """A shape near q of given strokes (n,), whose forces are balanced but for a part; contact and reactions.

        None if there is none.
        """
        body, before = self._body, math.inf
        whole_steps = self._interface is None and self._actuators is None
        for _ in range(MAX_ITERATIONS):
            elastic, force = body.force(q), self._loads(u, q)
            residual = elastic - force - unbalanced
            tangent = body.tangent(q)
            stable = is_definite(tangent)
            if not (stable or whole_steps):
                return None
            # Where all is let go there are no forces left to compare with, but those of hardly any displacement.
            least = SMALLEST_DISPLACEMENT * body.training_radius * np.abs(tangent).max()
            scale = max(*(np.abs(part).max() for part in (elastic, force, unbalanced)), least)
            if not math.isfinite(scale):
                return None
            try:
                inverse = np.linalg.inv(tangent)
            except np.linalg.LinAlgError:
                return None
            if self._interface is not None:
                self._delassus = self._with_residual(symmetric(self._Sᵀ.T @ inverse @ self._Sᵀ / self.h))
            free = (q - inverse.dot(residual) - start) / self.h
            motion, reactions = (start, self._r, free, self.h, obstacles, True), self.reactions
            if self._actuators is None:
                contact = self._solve_contact(*motion)
            else:
                columns = self._stroke_columns(q)
                gone = self._strokes_at(q) - (q - start).dot(columns)
                targets, spread = self._actuators.resting_rates(given, gone, self.h), inverse.dot(columns) / self.h
                angles = self._angles(q)
                reactions, contact = self._solve_actuators(
                    u, columns, spread, targets, *motion, angles=angles, before=reactions
                )
                residual -= columns.dot(reactions)
            if contact is not None:
                residual -= self._pushed(contact)
            error = np.abs(residual).max()
            if is_solved(error, before, scale):
                return (q, contact, reactions) if stable else None
            if error > 10 * before and not whole_steps:
                return None
            before = error
            q = q - inverse.dot(residual)
        return None

    def adjoint(self, u: Array) -> "BalanceAdjoint":
        """As in Kernel."""
        from fenics_rom.runtime.steppers.balance_adjoint import BalancedPart, HeldStrokes

        (h, start, _, _, reactions, solved, residual), q = self._taken, self._coordinates().copy()
        u = u if self._actuators is None else self._actuators.split(u)[0]
        contact, is_kink = contact_adjoint(self._interface, solved)
        tangent = self._body.tangent(q) - self._load_slopes(u, reactions, q)
        which = self._held_strokes(reactions)[0]
        columns, moved = self._stroke_columns(q)[:, which], self._stroke_slopes(q)[:, which].T
        held = HeldStrokes(columns, h * moved, moved, 0 * moved, -1.0)  # strokes are what is given
        inputs = self._input_columns(q)
        part = BalancedPart(h, 0.0, h * tangent, tangent, inputs, held, self._Sᵀ, contact, residual)
        return self._balance_adjoint([part], [reactions], start, is_kink)
