"""Forces that are found inside Newton's method: of contact, of actuators by stroke, and at guides that rub.

The iteration knows the forces f it has and asks for those that a velocity v̂ needs, found with them: free = S v̂ - W f is
what the points would do without, and after the change of f is put through A⁻¹, S v̂ = free + W f obeys the contact law
exactly, whatever W = S A⁻¹ Sᵀ stands for. So only the balance of momentum is left to converge. Strokes of actuators are
met likewise, with the columns B of unit forces where v̂ leads to in place of Sᵀ. With the change of v̂ B changes; what
strokes miss by that is of second order, and gone where momentum has converged. Where a base turns the body, W is off by
its turn: what points miss by that, `lag`, has to converge, too.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.fem.finite_strain.residuals import StepResidual
from fenics_rom.fem.finite_strain.turned_factor import TurnedFactor
from fenics_rom.fem.full_order_body import FullOrderInterface
from fenics_rom.fem.points_of_step import PointsOfStep
from fenics_rom.mechanics.actuator_forces import ActuatorForces
from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion, mean_contact
from fenics_rom.mechanics.points_held_back import PointsHeldBack
from fenics_rom.mechanics.points_operator import Operator, moved_by


class FoundForces(NamedTuple):
    """What was found in a step."""

    contact: ContactSolution | None  # None where nothing touches
    actuators: Array  # (n,), N or Pa

    @property
    def act(self) -> bool:
        """Whether there are any."""
        return self.contact is not None or bool(self.actuators.any())


def mean_forces(parts: Sequence[tuple[float, FoundForces]]) -> FoundForces:
    """Of a step that was taken in parts, by their shares of it: they have the impulses of all parts."""
    actuators = np.sum([share * part.actuators for share, part in parts], axis=0)
    return FoundForces(mean_contact([(share, part.contact) for share, part in parts]), actuators)


class ForcesInNewton:
    """Forces in the iteration of a step, of contact or actuators; for each part of one `begin`, then `resolve`."""

    def __init__(self, interface: FullOrderInterface | None, actuators: ActuatorForces | None):
        self._interface, self._actuators = interface, actuators
        self._is_rigid = interface is not None and not interface.solver.law.stiffness
        self._factor: TurnedFactor | None = None
        self._points: PointsOfStep | None = None
        self._spread: Array | None = None  # A⁻¹ Sᵀ, of few points
        self._delassus: Operator | None = None

    def begin(
        self,
        equation: StepResidual,
        points: PointsOfStep | None,
        obstacles: ObstacleMotion | None,
        u: Array,
        given: Array,
        is_patient: bool,
    ) -> None:
        """Notes where a part of a step begins, its input (p,) and the strokes (n,) that are given at its end.

        And whether forces of contact that are hard to find are to be looked for.
        """
        self._equation, self._obstacles, self._u, self._is_patient = equation, obstacles, u, is_patient
        self._points = points
        if self._actuators is not None:
            self._targets = equation.targets(self._actuators, given)
        if self._interface is not None and obstacles is not None:
            assert points is not None
            self._before = self._interface.solver.search

    def use(self, factor: TurnedFactor) -> None:
        """The factor of A, as it is now; W (3P, 3P), m/s/N, is made of it as soon as an obstacle is within reach."""
        self._factor, self._spread, self._delassus = factor, None, None

    def depend_on(self, factor: TurnedFactor) -> bool:
        """Whether W was made of a factor, as dear as a good part of it."""
        return self._factor is factor and self._delassus is not None

    def resolve(self, v: Array, last: FoundForces) -> FoundForces:
        """Forces at a mid-step velocity (rows here, 1) that was found with the last ones of this step."""
        self.rollback()
        free, self._near = np.empty((0, 3)) if self._points is None else self._points.velocities(v), v
        if last.contact is not None:
            free = free - moved_by(self._points_operator(), last.contact.forces).reshape(-1, 3)
        if self._actuators is None:
            return FoundForces(self._touched(free, last.contact), last.actuators)
        assert self._factor is not None
        columns, rates, angles = self._equation.strokes(v)
        inner, spread = self._equation.model.algebra.inner, self._factor.solve(columns)
        W = inner(columns, spread)
        X = np.empty((0, len(W)))
        if self._points is not None:
            X = self._points.spread(inner(self._points.interface.Sᵀ, spread))
        self._columns, self._by_actuators, rates = columns, spread, rates - W @ last.actuators
        if last.contact is not None:
            rates = rates - X.T @ last.contact.forces.ravel()
        W, held = self._actuators.compliance(W), None

        def touch(z: Array, holding: Array, *, gives: Array | None) -> tuple[ContactSolution | None, Array]:
            nonlocal held
            moved = free + (X @ (z - last.actuators)).reshape(-1, 3)
            if self._is_untouched(moved, last.contact):
                return None, np.zeros(len(z))
            held = PointsHeldBack(self._points_operator(), X, W) if held is None else held
            contact = self._touched(moved, last.contact, held.delassus(holding, gives))
            return contact, np.zeros(len(z)) if contact is None else X.T @ contact.forces.ravel()

        z, contact = self._actuators.solve(self._u, rates, W, self._targets, last.actuators, touch, angles)
        return FoundForces(contact, z)

    def force(self, found: FoundForces) -> Array:
        """Of what was found (rows here, 1), N, with actuators where they were last looked for."""
        force = self.contact_force(found.contact)
        return force if self._actuators is None else force + self._columns @ found.actuators[:, None]

    def contact_force(self, contact: ContactSolution | None) -> Array:
        """(rows here, 1), N."""
        return np.zeros_like(self._equation.start.x) if self._points is None else self._points.force(contact)

    def lag(self, found: FoundForces, before: FoundForces) -> float:
        """What the law lacks of what was found after what was before, as newton.py measures residuals."""
        if self._points is None or not self._points.turn or (found.contact is None and before.contact is None):
            return 0.0
        change, spread = self.force(found) - self.force(before), self.spread(found, before)
        return self._points.turn * math.sqrt(max(self._equation.model.dot(change, spread), 0.0))

    def spread(self, found: FoundForces, before: FoundForces) -> Array:
        """A⁻¹ times the change (rows here, 1) of forces that were found before."""
        moved = np.zeros_like(self._equation.start.x)
        if self._actuators is not None:
            moved = self._by_actuators @ (found.actuators - before.actuators)[:, None]
        change = np.zeros((1, 3))
        if found.contact is not None:
            change = change + found.contact.forces
        if before.contact is not None:
            change = change - before.contact.forces
        pushed = np.flatnonzero(change)
        if not len(pushed) or self._points is None:
            return moved
        change = self._points.seen(change).reshape(-1, 1)
        self._points_operator()
        if self._spread is None:
            assert self._factor is not None
            return moved + self._factor.solve(self._points.interface.Sᵀ @ change)
        pushed = np.flatnonzero(change)
        return moved + self._spread[:, pushed] @ change[pushed]

    def rollback(self) -> None:
        """Forgets the contact that was found since `begin`."""
        if self._interface is not None and self._obstacles is not None:
            self._interface.solver.search = self._before

    def _points_operator(self) -> Operator:
        assert self._factor is not None
        assert self._interface is not None
        assert self._points is not None
        if self._delassus is None and self._interface.has_many:
            self._delassus = self._interface.operator(self._factor.solve)
        elif self._delassus is None:
            self._spread = np.asfortranarray(self._factor.solve(self._interface.Sᵀ.toarray()))
            self._delassus = self._interface.delassus(self._spread)
        return self._points.operator(self._delassus)

    def _touched(self, free: Array, last: ContactSolution | None, W: Operator | None = None) -> ContactSolution | None:
        """Contact of points that would move at velocities (P, 3), with a Delassus operator where it is another."""
        if self._is_untouched(free, last):
            return None
        assert self._interface is not None
        assert self._points is not None
        assert self._obstacles is not None
        points, h = self._points.motion(self._near, free), self._equation.h
        operator = self._points_operator() if W is None else W
        of_step = h, self._obstacles, self._equation.is_quasi_static
        return self._interface.solver.solve(points, operator, *of_step, is_patient=self._is_patient)

    def _is_untouched(self, v: Array, last: ContactSolution | None) -> bool:
        """Whether no pair of the rigid law can come too close at velocities v (P, 3) of the points."""
        if self._obstacles is None or self._points is None:
            return True
        if not self._is_rigid or last is not None:
            return False
        assert self._interface is not None
        points = self._points.motion(self._near, v)
        return not len(self._interface.solver.within_reach(points, self._equation.h, self._obstacles))
