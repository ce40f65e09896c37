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
from fenics_rom.runtime.steppers.elastic.sampled import RestingAdjoint
from fenics_rom.runtime.steppers.held import MAX_ITERATIONS, MAX_PARTS, HeldBody, is_solved
from fenics_rom.runtime.steppers.held_adjoint import Part
from fenics_rom.runtime.steppers.held_part import HeldPart
from fenics_rom.runtime.steppers.kernel import StepWork, symmetric

if TYPE_CHECKING:
    from fenics_rom.runtime.steppers.adjoint import StepAdjoint

SMALLEST_DISPLACEMENT = 1e-9  # of the training radius: what is beside it a share of CONVERGENCE_TOLERANCE is at rest


class Equilibrium(HeldBody):
    """A step of a quasi-static run: Φ'(q⁺) = G u, from the step before by Newton's iteration under a growing load.

    Arguments and attributes as in HeldBody; the velocity stays zero.
    """

    @property
    def energy(self) -> float:
        """Stored, J."""
        return self._with_carried_energy(self._body.energy(self._coordinates()))

    def step(self, u: Array, obstacles: ObstacleMotion | None = None) -> float:
        """As in Kernel."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            start, reactions, given = self._coordinates().copy(), self.reactions, u
            strokes, u = np.empty(0) if self._found is None else self._found.strokes(start), self.loads.without_found(u)
            given = strokes if self._actuators is None else given[self._actuators.columns]
            held = elastic = self._body.force(start)
            if self._interface is not None and self.contact is not None:
                held = held - self._pushed(self.contact)
            unbalanced = elastic - self.loads.force(u, start)
            if self._found is not None:
                by_strokes, rubbed_before = self._found.actuators.parts(self._found.columns(start), reactions)
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
            moved, pushed, rubbed_away, lag = q - start, self.loads.force(u, q), 0.0, 0.0
            if self._found is not None:
                by_strokes, rubbed = self._found.actuators.parts(self._found.columns(q), reactions)
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
            self.taken = (Part(self.h, start, self._r, moved / self.h, reactions, self._contact_step, maps, None),)
            np.multiply(q, self._ω, self._e)
            self.contact, self.reactions = contact, reactions
            assert self._extent is not None
            self._extent.look(self.notes, self.loads.with_found(u, reactions), q, E, contact, self.h)
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
            elastic, force = body.force(q), self.loads.force(u, q)
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
            if self._found is None:
                contact = self._solve_contact(*motion)
            else:
                columns, angles = self._found.columns(q), self._found.angles(q)
                gone = self._found.strokes(q) - (q - start).dot(columns)
                targets = self._found.actuators.resting_rates(given, gone, self.h)
                spread = inverse.dot(columns) / self.h
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

    def adjoint(self, u: Array) -> "StepAdjoint":
        """As in Kernel."""
        from fenics_rom.runtime.steppers.acts.found_slopes import FoundIn

        (h, start, r, v, reactions, solved, residual, _), q = self.taken[0], self._coordinates().copy()
        contact, is_kink = contact_adjoint(self._interface, solved)
        found, forces = None, self.loads.without_found(u)
        if self._found is not None:
            found = FoundIn(self._found, forces, reactions, h, start, r, v, q).resting_slopes()
        law, turned = (
            RestingAdjoint(self._body.tangent(q), h, self._body.force(q)),
            self.loads.slope(forces, reactions, q),
        )
        part = HeldPart(h, 0.0, law, self.loads.all_columns(q), turned, h, found, self._Sᵀ, contact, residual, 0 * q)
        return self._parted_adjoint([part], is_kink)
