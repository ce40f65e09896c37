"""Contact of held bodies with themselves, as their compiled steps are told of it, and tell of it."""

from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit
from fenics_rom.mechanics.compiled.contact_law import Law
from fenics_rom.mechanics.compiled_contact import Told
from fenics_rom.mechanics.compiled_self_contact import CompiledSelfContact
from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion, Opposite, PointMotion
from fenics_rom.runtime.compiled import held_touch
from fenics_rom.runtime.compiled.held_own import Own
from fenics_rom.runtime.compiled.held_step import Step
from fenics_rom.runtime.compiled.held_touch import Among
from fenics_rom.runtime.compiled.touching import Begun, Last, StepContact
from fenics_rom.runtime.steppers.held_contact import HeldContact
from fenics_rom.runtime.steppers.residual_motion import ResidualMotion

_NO_SHAPES, _NO_OPERATOR = np.empty((0, 17)), np.empty((0, 0))
set_delassus = jit(held_touch.set_delassus)


class HeldSelfContact(HeldContact):
    """Of a body that touches itself, and no obstacles. Arguments as in HeldContact.

    Args:
        factor: of the last step's matrix (m, m), which steps set.
    """

    def __init__(
        self, solver: CompiledSelfContact, points: Array, residual: ResidualMotion | None, h: float, factor: Array
    ):
        super().__init__(solver, points, residual, h)  # type: ignore[arg-type]
        self._found_by, self._factor, P = solver, factor, len(solver.points)
        opposite = (np.zeros((P, 3), dtype=np.int64), np.zeros((P, 3)))
        self._own = Own(*solver.surface.in_loops(P), *opposite, *map(np.copy, opposite))
        self._own_law, self._nothing_swung = solver.own_law(h), np.zeros(P, dtype=np.int64)

    @property
    def _law(self) -> Law:
        return self._own_law

    def _begun(self) -> Begun:
        search = self._found_by.search
        return Begun(search.forces, self._nothing_swung if search.swung is None else search.swung)

    def among(self, obstacles: ObstacleMotion) -> Among:
        """As in HeldContact."""
        return self._among(obstacles, self._own_law, _NO_SHAPES, _NO_OPERATOR, self._own)

    def keep_last(self, step: Step, among: Among, last: Last) -> ContactSolution | None:
        """As in HeldContact."""
        own = self._own
        own.nodes[:], own.weights[:] = own.nodes_before, own.weights_before
        return super().keep_last(step, among, last)

    def _keep(
        self, found: StepContact, W: Array, obstacles: ObstacleMotion, sweeps: int, normal_power: float
    ) -> ContactSolution | None:
        (pairs, gaps, motion, forces), law, factor = found, self._own_law, self._factor.copy()
        self._rates = motion[3]
        power = normal_power if law.friction > 0 else None
        told = Told(law, pairs, gaps, forces.reshape(-1, 3), sweeps, power, self._found_by.search.swung)

        def tell() -> tuple[Any, ...]:
            n = motion.shape[1]
            delassus = np.empty((n, n))
            set_delassus(self.touch, factor, np.empty_like(self.touch.points), delassus)
            return PointMotion(*motion[:3].reshape(3, -1, 3)), delassus, self._h, obstacles, False

        opposite = Opposite(self._own.nodes, self._own.weights)
        return self._found_by.keep(told, opposite, tell, obstacles)
