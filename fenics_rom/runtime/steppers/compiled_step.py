"""Steps of a linear body among obstacles by one compiled function: what `ContactMidpoint` tries first."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import in_plain, or_numpy
from fenics_rom.mechanics.compiled.contact_law import OTHERWISE
from fenics_rom.mechanics.compiled_contact import CompiledContact
from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion
from fenics_rom.runtime.compiled.linear_step import Body, State, Step, Taken, take_step, take_steps
from fenics_rom.runtime.steppers.contact_in_loops import ContactInLoops

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


class CompiledStep(ContactInLoops):
    """Steps of a body. Arguments as in ContactInLoops.

    Args:
        body: what moves.
        state: what steps change, and where they note it before.
    """

    def __init__(self, body: Body, state: State, solver: CompiledContact, h: float):
        super().__init__(solver, h)
        self.body, self._state = body, state

    @or_numpy
    def take(self, u: Array, obstacles: ObstacleMotion) -> tuple[Step, ContactSolution | None] | None:
        """Takes a step under u (p,); None where the loops do not find its forces, and nothing is changed."""
        found = self._for_found()
        step = take_step(
            self.body, self._law, self._solver.shapes, in_plain(u), *obstacles, self._begun(), self._state, found,
        )  # fmt: skip
        if step.status == OTHERWISE:
            return None
        return step, self._keep(found, self.body.W, obstacles, step.sweeps, step.normal_power)

    @or_numpy
    def take_many(self, inputs: Array, obstacles: ObstacleMotion) -> StepsTaken | None:
        """Takes steps under inputs (n, p) among obstacles that stand still, as many as the loops find; None: none."""
        n, (before, last) = len(inputs), self._for_many()
        taken = Taken(np.empty((n, 5)), np.empty((n, len(self.body.ω))), np.empty((n, self._state.beyond.shape[1])))
        count, step = take_steps(
            self.body, self._law, self._solver.shapes, in_plain(inputs), obstacles.start, before, self._state,
            self._for_found(), *last, taken,
        )  # fmt: skip
        if not count:
            return None
        self._begin_last(last.begun)
        contact = self._keep(last.found, self.body.W, obstacles, step.sweeps, step.normal_power)
        return StepsTaken(Taken(*(rows[:count] for rows in taken)), step, contact)

    @property
    def beyond(self) -> Array:
        """Velocities (P, 3) of the contact points beyond the basis in the last step, m/s."""
        return self._rates.reshape(-1, 3)
