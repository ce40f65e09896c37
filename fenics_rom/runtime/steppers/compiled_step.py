"""Steps of a linear body among obstacles by one compiled function: what `ContactMidpoint` tries first."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import in_plain, or_numpy
from fenics_rom.mechanics.compiled.contact_law import OTHERWISE, Law, pairs_from
from fenics_rom.mechanics.compiled_contact import CompiledContact, Told
from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion, PointMotion
from fenics_rom.mechanics.contact_search import ContactSearch
from fenics_rom.runtime.compiled.linear_step import Body, State, Step, Taken, take_step, take_steps
from fenics_rom.runtime.compiled.touching import Begun, StepContact

LARGEST_CONDITION, MOST_ROWS = 1e8, 300  # of Delassus operators whose inverses are kept


def inverse_of(W: Array) -> Array:
    """Of a symmetric matrix (n, n); (0, 0) where it is large, or hardly tells forces apart."""
    if len(W) <= MOST_ROWS and np.isfinite(W).all():
        values, vectors = np.linalg.eigh(W)
        if values[0] * LARGEST_CONDITION > values[-1]:
            root = vectors / np.sqrt(values)
            return np.ascontiguousarray(root @ root.T)
    return np.empty((0, 0))


class StepsTaken(NamedTuple):
    """Steps in a row."""

    steps: Taken
    last: Step
    contact: ContactSolution | None  # in the last one


class CompiledStep:
    """Steps of h s.

    Args:
        body: what moves.
        state: what steps change, and where they note it before.
        solver: whose obstacles are met, by whose law.
        h: s.
    """

    def __init__(self, body: Body, state: State, solver: CompiledContact, h: float):
        self.body, self._state, self._solver = body, state, solver
        self._h = h
        self._beyond = np.zeros(3 * len(solver.points))

    @or_numpy
    def take(self, u: Array, obstacles: ObstacleMotion) -> tuple[Step, ContactSolution | None] | None:
        """Takes a step under u (p,); None where the loops do not find its forces, and nothing is changed."""
        begun = self._solver.search
        found = self._found(begun)
        step = take_step(
            self.body, self._law, self._solver.shapes, in_plain(u), *obstacles,
            Begun(begun.forces, self._solver.swung(begun)), self._state, found, True,
        )  # fmt: skip
        if step.status == OTHERWISE:
            return None
        return step, self._keep(step, found, begun, obstacles)

    @or_numpy
    def take_many(self, inputs: Array, obstacles: ObstacleMotion) -> StepsTaken | None:
        """Takes steps under inputs (n, p) among obstacles that stand still, as many as the loops find; None: none."""
        begun, n = self._solver.search, len(inputs)
        before = Begun(begun.forces.copy(), self._solver.swung(begun).copy())
        taken = Taken(np.empty((n, 5)), np.empty((n, len(self.body.ω))), np.empty((n, self._state.beyond.shape[1])))
        last_begun, last = Begun(*map(np.empty_like, before)), self._found(begun)
        count, step = take_steps(
            self.body, self._law, self._solver.shapes, in_plain(inputs), obstacles.start, before, self._state,
            self._found(begun), last_begun, last, taken,
        )  # fmt: skip
        if not count:
            return None
        swung = last_begun.swung if last_begun.swung.any() else None
        self._solver.search = begun = begun._replace(forces=last_begun.forces, swung=swung)
        contact = self._keep(step, last, begun, obstacles)
        return StepsTaken(Taken(*(rows[:count] for rows in taken)), step, contact)

    @property
    def _law(self) -> Law:
        return self._solver.law_in_steps(self._h)

    @property
    def beyond(self) -> Array:
        """Velocities (P, 3) of the contact points beyond the basis in the last step, m/s."""
        return self._beyond.reshape(-1, 3)

    def _found(self, begun: ContactSearch) -> StepContact:
        """For what a step finds that begins so."""
        P, pairs = len(self._solver.points), pairs_from(begun.forces, self._law.friction)
        return StepContact(pairs, np.empty(len(begun.forces)), np.zeros((4, 3 * P)), np.empty(3 * P))

    def _keep(
        self, step: Step, found: StepContact, begun: ContactSearch, obstacles: ObstacleMotion
    ) -> ContactSolution | None:
        """Contact of a step that was taken; the next search begins with it."""
        pairs, gaps, motion, forces = found
        self._beyond = motion[3]
        law = self._law
        power = step.normal_power if law.friction > 0 else None
        told = Told(law, pairs, gaps, forces.reshape(-1, 3), step.sweeps, power, begun.swung)

        def points() -> PointMotion:
            return PointMotion(*motion[:3].reshape(3, -1, 3))

        return self._solver.keep(told, points, self.body.W, self._h, obstacles)
