"""Equilibria of a full-order body of small strains that a rigid base carries.

In the axes of the base K q = f, with the loads as the base sees them where it is at the end of a step. Springs to the
ground are in K, as they are the same in all axes, and what they pull the unbent body with there is in f.
"""

from dataclasses import replace

import numpy as np
from numpy import ndarray as Array

from fenics_rom.fem.linear_stepper import FullOrderStepper
from fenics_rom.fem.on_base import OnBase
from fenics_rom.fem.petsc_matrix import PetscMatrix, combination
from fenics_rom.fem.points_of_step import CarriedPoints
from fenics_rom.fem.springs import of_components, with_attached
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.step import MOVING_FRAME, StepInput
from fenics_rom.system.system import System


class CarriedAtRest(OnBase, FullOrderStepper):
    """Arguments and attributes as in FullOrderStepper and OnBase."""

    _points: CarriedPoints | None

    def __init__(self, system: System, dt: float, environment: ActiveEnvironment, *, ledger: bool = True):
        self._put_on_base(system, environment)
        springs = of_components(self._frame.springs)
        K = with_attached(PetscMatrix(combination((1.0, system.stiffness))), springs, system.body.unknowns)
        super().__init__(replace(system, stiffness=K), dt, environment, ledger=ledger)
        self.kind, self.reason = MOVING_FRAME, "a rigid base carries the body, which has no inertia"
        self._base_before = self._base, self.wrench

    @property
    def energy(self) -> float:
        """Stored, J."""
        return super().energy + self._beyond_springs(self._motion(self._base))

    def step(self, inputs: StepInput) -> float:
        """As in FullOrderStepper."""
        start, before, x, wrench = self._base, self.contact, self.x, self.wrench
        self._end, beyond = self._base_at(self.time + self.dt), self._beyond_springs(self._motion(start))
        super().step(inputs)
        self._base, self._base_before = self._end, (start, wrench)
        now, turn, v = self._motion(self._end), self._geometry(self._end, self._end, self.dt), (self.x - x) / self.dt
        if self.ledger is not None:
            more = self._beyond_springs(now) - beyond
            self.ledger.book(supplied=self._supplied_at_rest(before, v, self.dt, more))
        if self.actuators is not None:
            acting = inputs.u.copy()
            acting[self.actuators.columns] = self.reactions
            self._take_loads(acting, self._end)
        others = self._pulled_by_springs(now, turn)
        self.wrench = self._wrench_of((now, now), turn, np.zeros((2, 3)), others, v)
        self._look_at_base(start)
        return self.energy if self.ledger is not None else np.nan

    def rollback(self) -> None:
        """As in FullOrderStepper."""
        super().rollback()
        self._base, self.wrench = self._base_before

    def close(self) -> None:
        """As in FullOrderStepper."""
        super().close()
        self._body.close()

    def _force(self, u: Array) -> Array:
        """As in FullOrderStepper."""
        return self._take_loads(u, self._end)[:, 0]

    def _points_in(self, h: float) -> CarriedPoints | None:
        """As in FullOrderStepper."""
        return self._points_on_base(h, at_rest=True)
