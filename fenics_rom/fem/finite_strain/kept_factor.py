"""What stands for the tangent over dozens of steps: a factor that turns with the body, and the secants of it."""

import numpy as np

from fenics_rom.fem.direct import PetscFactor
from fenics_rom.fem.finite_strain.residuals import StepResidual
from fenics_rom.fem.finite_strain.secants import Secants
from fenics_rom.fem.finite_strain.stresses import EquilibriumStresses
from fenics_rom.fem.finite_strain.tangent_matrix import TangentMatrix
from fenics_rom.fem.finite_strain.turned_factor import TurnedFactor

LATE = 0.75  # share of a step after which the tangent is of its mean shape: that of the middle and of the end
STEPS_AHEAD = 4  # of which shape a factor of smooth motion is
FACTOR_WORK = 25  # iterations that a factor is worth
MAX_WORK = 15  # iterations and products with the tangent in a step that are too many, whatever a factor is worth


class KeptFactor:
    """Of A at the start of a step, or with its stresses, which may make it indefinite; every rank must call everything.

    Args:
        matrix: that assembles A.
        equation: of the step that it is made for.
        found: forces (n,) of actuators in the step before.
        stressed: whether with stresses.
        is_smooth: whether the body moves smoothly: a shape some steps ahead then serves more steps than this one.

    Attributes:
        factor: of A, turned.
        secants: of it.

    Raises:
        SolverError: A is not positive definite.
    """

    def __init__(
        self, matrix: TangentMatrix, equation: StepResidual, found: np.ndarray, stressed: bool, is_smooth: bool
    ):
        model, start, self._coefficients = equation.model, equation.start, equation.coefficients
        H, u = start.H, start.u
        if stressed and is_smooth:
            u = u + model.nodal_field(STEPS_AHEAD * equation.h * start.v)
            H = model.points.gradients(u)
        if stressed:
            stresses = EquilibriumStresses(model.material, H)
            assembled = matrix.stressed(stresses, self._coefficients, equation.external.with_found(found).stiffness(u))
        else:
            assembled = matrix.definite(H, self._coefficients)
        self.factor = TurnedFactor(PetscFactor(assembled, one_by_one=True), model.points, H, model.components)
        self.secants = Secants(len(start.x), model.algebra.inner)
        self._steps, self._work = 0, FACTOR_WORK
        self._is_turned = self._is_due = False

    def serves(self, equation: StepResidual) -> bool:
        """Whether it is one for an equation."""
        return self._coefficients == equation.coefficients

    def turn(self, equation: StepResidual, v: np.ndarray, is_dear: bool) -> bool:
        """Turns it to where a step with the mid-step velocity (rows here, 1) leads; only if due where that is dear."""
        self._is_turned, self._is_due = self._is_due or not is_dear, False
        if self._is_turned:
            points = equation.model.points
            self.factor.turn(points.gradients(equation.start.u + LATE * equation.h * equation.model.nodal_field(v)))
        return self._is_turned

    def is_worth_keeping(self, work: int) -> bool:
        """Whether after a step of so many iterations and products with the tangent, or a turn is all that is due.

        It is as long as no step takes more than the mean one, the factor among them.
        """
        self._steps, self._work = self._steps + 1, self._work + work
        if work * self._steps <= self._work and work <= MAX_WORK:
            return True
        self._is_due = not self._is_turned
        return self._is_due

    def close(self) -> None:
        """Gives the memory back."""
        self.factor.close()
