"""Newton's method for an equilibrium: whole steps with the consistent tangent K, which is factored as L D Lᵀ.

A thin body's residual grows by orders of magnitude with the first step, which stretches what it should turn, and is
gone a few steps later; so no step is shortened for it. The negative pivots of K at an equilibrium are the directions in
which the body would leave it: none where it is stable, some beyond a limit point or where it buckles.
"""

import math
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SolverError
from fenics_rom.fem.direct import MemoryShortage, PetscFactor
from fenics_rom.fem.finite_strain.found_forces import FoundForces
from fenics_rom.fem.finite_strain.gmres import Gmres
from fenics_rom.fem.finite_strain.model import FiniteStrainModel
from fenics_rom.fem.finite_strain.newton import (
    CONVERGENCE_TOLERANCE,
    MAX_ITERATIONS,
    MIN_STEP_SHARE,
    STAGNATION_TOLERANCE,
    NewtonIterate,
    NotConvergedError,
)
from fenics_rom.fem.finite_strain.residuals import QuasiStaticResidual, TrialStep
from fenics_rom.fem.finite_strain.stresses import IDENTITY
from fenics_rom.fem.finite_strain.tangent_matrix import OF_EQUILIBRIUM, TangentMatrix
from fenics_rom.fem.petsc_matrix import PetscMatrix

LIMIT_STIFFNESS = 0.25  # share of the stiffness without stress; less, where no load is too small, is a limit point
INVERSE_ITERATIONS = 10  # that find the weakest direction
LINEAR_RESIDUAL = 1e-6  # that linear systems are solved to
PATIENCE = 5  # iterations with none better than the best one before, after which there is no hope for more
KEEPING_SHARE = (
    0.1  # of a residual that the next one is below, where the body has moved so little that a factor is kept
)
MAX_KEPT_PRODUCTS = 12  # products with the tangent, for one solution, that are still less than a new factor


class FactoredTangent:
    """K, factored at an iterate and kept for later ones as long as a few products with the tangent make up for it.

    Attributes:
        negative_pivots: of the last factor.
        factors: how many there were.
    """

    def __init__(self, matrix: TangentMatrix, gmres: Gmres):
        self._matrix, self._gmres = matrix, gmres
        self._factor: PetscFactor | None = None
        self._at: TrialStep | None = None
        self.negative_pivots = self.factors = 0

    def factor(self, trial: TrialStep) -> PetscFactor:
        """Of the tangent at a trial; every rank must call it.

        Raises:
            NotConvergedError: it has none.
        """
        if self._factor is not None and self._at is trial:
            return self._factor
        self.close()
        try:
            matrix = self._matrix.consistent(trial.stresses, trial.external.stiffness(trial.u))
            self._factor = PetscFactor(matrix, definite=False)
        except MemoryShortage:
            raise
        except SolverError:
            raise NotConvergedError from None
        self._at = trial
        self.factors += 1
        self.negative_pivots = self._factor.negative_pivots
        return self._factor

    @property
    def factor_at_hand(self) -> PetscFactor:
        """The last one."""
        assert self._factor is not None
        return self._factor

    def solve(self, equation: QuasiStaticResidual, trial: TrialStep, force: Array, near: bool) -> Array:
        """Velocity (rows here, 1) that a force (rows here, 1) asks for at a trial, `near` to that of the factor."""
        tangent = partial(equation.apply_tangent, trial)
        if self._factor is not None and self._at is not trial and near:
            solution = self._gmres.solve(tangent, self._factor, force, LINEAR_RESIDUAL, MAX_KEPT_PRODUCTS)
            if self._gmres.converged:
                return solution
        return self._gmres.solve(tangent, self.factor(trial), force, LINEAR_RESIDUAL)

    def limit_point(self, trial: TrialStep, model: FiniteStrainModel, nodes: Array) -> str:
        """What K at a trial says of a limit point or buckling there, of a body whose nodes are at (N, 3) at rest."""
        share, φ = self._weakest(trial, model)
        if share > LIMIT_STIFFNESS:
            return ""
        place = nodes[np.square(model.nodal_field(φ)).sum(axis=1).argmax()]
        return (
            f", as the body comes to a limit point: the tangent keeps {share:.2g} of its stiffness without stress "
            f"against a motion that is largest at ({', '.join(f'{x:.3g}' for x in place)}) m; "
            "`arc_length` follows its equilibria beyond it"
        )

    def _weakest(self, trial: TrialStep, model: FiniteStrainModel) -> tuple[float, Array]:
        """Least share φᵀKφ/φᵀAφ that K at a trial keeps of A, the tangent without stress, and its φ (rows here, 1)."""
        factor = self.factor(trial)
        unstressed = PetscMatrix(self._matrix.definite(trial.stresses.F - IDENTITY, OF_EQUILIBRIUM))
        φ, share = np.ones_like(trial.residual), 1.0
        for _ in range(INVERSE_ITERATIONS):
            Aφ = unstressed @ φ
            φ = factor.solve(Aφ)
            energy = model.dot(φ, unstressed @ φ)
            share, φ = model.dot(φ, Aφ) / energy, φ / math.sqrt(energy)
        unstressed.destroy()
        return share, φ

    def close(self) -> None:
        """Gives the factor back."""
        if self._factor is not None:
            self._factor.close()
            self._factor = self._at = None


def solve_equilibrium(
    equation: QuasiStaticResidual,
    tangent: FactoredTangent,
    found: FoundForces,
    dot: Callable[[Array, Array], float],
    tell: Callable[[int, float], None],
) -> NewtonIterate:
    """Solves the equations of an equilibrium, from where the body is; every rank must call it.

    Args:
        equation: of the equilibrium.
        tangent: what linear systems are solved with; afterwards it has the factor of the equilibrium.
        found: what the iterates are handed back with.
        dot: product of columns (rows here, 1).
        tell: called with each iteration and its residual, as a share of the forces.

    Raises:
        NotConvergedError: there is none that whole steps lead to.
    """

    def evaluate(v: Array) -> TrialStep:
        with np.errstate(all="ignore"):  # a shape without an energy is refused below
            return equation.evaluate(v)

    trial, previous, near = evaluate(np.zeros_like(equation.start.x)), math.inf, True
    smallest, last_better, scale_before = math.inf, 0, 0.0
    for iteration in range(MAX_ITERATIONS + 1):
        residual = trial.residual
        if not residual.any():
            return NewtonIterate(trial, found, residual, residual, 0.0, iteration)
        direction = tangent.solve(equation, trial, residual, near)
        size = math.sqrt(abs(dot(residual, direction)))
        terms = equation.terms(trial)
        shapes = tangent.factor_at_hand.solve(terms) / equation.h
        scale = math.sqrt(max(abs(dot(terms[:, [k]], shape[:, None])) for k, shape in enumerate(shapes.T)))
        # Where a load is let go no force is left at the solution, but the round-off of those that were there before.
        scale_before = scale_before or scale
        scale = max(scale, scale_before)
        tell(iteration, size / scale if scale else 0.0)  # of forces whose squares are no numbers
        if size <= CONVERGENCE_TOLERANCE * scale or STAGNATION_TOLERANCE * scale >= size > previous / 2:
            tangent.factor(trial)
            return NewtonIterate(trial, found, residual, direction, size, iteration)
        if size < smallest:
            smallest, last_better = size, iteration
        elif iteration - last_better >= PATIENCE:
            raise NotConvergedError
        near = size < KEEPING_SHARE * previous
        previous, share = size, 1.0
        while True:
            ahead = evaluate(trial.v + share * direction)
            if math.isfinite(dot(ahead.residual, ahead.residual)):
                break
            share /= 2
            if share < MIN_STEP_SHARE:
                raise NotConvergedError
        trial = ahead
    raise NotConvergedError


def unstable_message(time: float, done: float, share: float, negative_pivots: int) -> str:
    """What to say of an equilibrium at a time, s, that a share of a step's load makes unstable, when `done` is on."""
    return (
        f"at t = {time:.6g} s, at {done:.3g} to {done + share:.3g} of the step's change of load, the body comes to a "
        f"limit point or buckles: from there on its equilibrium is not stable ({negative_pivots} negative pivots of "
        "the tangent), and a real one would leave it; a run with inertia tells where to; `arc_length` goes on along "
        "equilibria"
    )
