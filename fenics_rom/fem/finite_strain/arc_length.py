"""An equilibrium path by its arc length, on beyond largest loads and displacements (Riks, 1979; Crisfield, 1981).

What acts is f₀ + λ f₁, of a load factor λ that is an unknown of a step as its displacement Δx is:

    f₀(x⁺) + λ f₁(x⁺) = K_s x⁺ + ∫ P : ∇δ,    Δxᵀ M Δx = s²

Newton's method has two right-hand sides, r and f₁; of the two changes of λ that keep s it takes the one that turns Δx
less. The first Δx of a step is along the path, on from where the last one led. A step that takes few iterations is
followed by a longer one; one that does not converge, or bends too much, is taken again with half of s.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SolverError
from fenics_rom.fem.finite_strain.equilibria import FactoredTangent, solve_equilibrium
from fenics_rom.fem.finite_strain.found_forces import FoundForces
from fenics_rom.fem.finite_strain.model import ExternalForce, FiniteStrainModel
from fenics_rom.fem.finite_strain.newton import MAX_ITERATIONS, NewtonIterate, NotConvergedError
from fenics_rom.fem.finite_strain.residuals import NONE_FOUND, QuasiStaticResidual, StepStart, TrialStep
from fenics_rom.io.progress import Report, silent

TARGET_ITERATIONS = 5  # of a step
LONGER, SHORTER = 1.5, 0.5  # times the arc length before, at most
SHORTEST = 1 / 4096  # times the first arc length, below which none is tried
MAX_BEND = 0.3  # rad, between the path at the start of a step and its chord
CONVERGENCE_TOLERANCE = 1e-8  # of s, for the last change of Δx: what is left is some millionth of that


class PathStart(NamedTuple):
    """Where a step along a path begins."""

    model: FiniteStrainModel
    start: StepStart
    load: Callable[[float], ExternalForce]  # by load factor
    h: float  # the time that it is to take, s
    tangent: FactoredTangent

    def equation(self, factor: float) -> QuasiStaticResidual:
        """Of equilibrium under a load factor."""
        zero = np.zeros_like(self.start.x)
        return QuasiStaticResidual(self.model, self.start, self.load(factor), self.h, zero)

    def growth(self, u: Array) -> Array:
        """f₁ (rows here, 1), N, at displacements of all nodes (N, 3)."""
        return self.load(1.0).at(self.model, u) - self.load(0.0).at(self.model, u)

    def displacement(self, equation: QuasiStaticResidual, trial: TrialStep, force: Array) -> Array:
        """K⁻¹ force (rows here, 1), m, at a trial."""
        return self.h * self.tangent.solve(equation, trial, force, near=True)

    def dot(self, left: Array, right: Array) -> float:
        """leftᵀ M right of columns (rows here, 1)."""
        return self.model.dot(left, self.model.mass @ right)


class ArcLength:
    """A path from rest, and how far it was followed; every rank must call every method.

    Args:
        first: load factor at the end of its first step, about.
        report: told of load factor, residual and iteration.

    Attributes:
        factor: λ where the path has come to; 1: the whole load is on, and it goes no further.
        steps: how many were taken.
        messages: largest and smallest loads, and where negative pivots of the tangent came or went.
    """

    def __init__(self, first: float, report: Report = silent):
        self._first, self._report = first, report
        self.factor, self.steps = 0.0, 0
        self.messages: list[str] = []
        self._length: float | None = None
        self._shortest = 0.0
        self._last: tuple[Array, float, float] | None = None  # Δx of the step before, λ and dλ/ds at its start
        self._pivots = 0

    @property
    def diagnostics(self) -> tuple[str, ...]:
        """What the user should know of the path."""
        short = (
            f"the path ends at {self.factor:.4g} of the load, after all of the {self.steps} steps that dt and duration "
            "give: more steps follow it further"
        )
        return (*self.messages, *([] if self.is_complete else [short]))

    @property
    def is_complete(self) -> bool:
        """Whether the whole load is on."""
        return self.factor == 1.0

    def step(self, at: PathStart) -> tuple[QuasiStaticResidual, NewtonIterate]:
        """The next step: its equation, and the equilibrium that it leads to.

        Raises:
            SolverError: none was found, however short the arc.
        """
        while True:
            try:
                equation, solution, factor = self._tried(at)
            except NotConvergedError:
                at.tangent.close()
                assert self._length is not None
                self._length /= 2
                if self._length < self._shortest:
                    raise SolverError(
                        f"arc length: no equilibrium was found beyond {self.factor:.4g} of the load, {self.steps} "
                        "steps from its start, however short the step: the mesh may be too coarse for what comes, or "
                        "two paths cross there; smaller steps (dt), or a load that is a little off, may pass it"
                    ) from None
                continue
            self._note(at, solution, factor)
            return equation, solution

    def _tried(self, at: PathStart) -> tuple[QuasiStaticResidual, NewtonIterate, float]:
        """A step of the arc length as it is, and its load factor."""
        equation, zero = at.equation(self.factor), np.zeros_like(at.start.x)
        trial = equation.evaluate(zero)
        along = at.displacement(equation, trial, at.growth(trial.u))
        speed = math.sqrt(at.dot(along, along))
        if not (math.isfinite(speed) and speed > 0):
            raise SolverError("arc length: what grows of the load moves no part of the body")
        if self._length is None:
            self._length = self._first * speed
            self._shortest = SHORTEST * self._length
        slope = 1 / speed
        if self._last is not None and at.dot(along, self._last[0]) < 0:
            slope = -slope
        self._note_limit(at, slope)
        change = slope * self._length
        factor, Δx = self.factor + change, change * along
        ahead = Δx
        for iteration in range(1, MAX_ITERATIONS + 1):
            equation = at.equation(factor)
            trial = self._evaluated(at, equation, Δx)
            by_rest = at.displacement(equation, trial, trial.residual)
            by_load = at.displacement(equation, trial, at.growth(trial.u))
            δλ = self._change(at, Δx, Δx + by_rest, by_load)
            correction = by_rest + δλ * by_load
            size = math.sqrt(at.dot(correction, correction)) / self._length
            self._report(f"arc length: load {factor:.4g}, residual {size:.0e}, iteration", iteration, MAX_ITERATIONS)
            factor, Δx = factor + δλ, Δx + correction
            if size <= CONVERGENCE_TOLERANCE:
                break
        else:
            raise NotConvergedError
        if at.dot(ahead, Δx) < math.cos(MAX_BEND) * self._length**2:
            raise NotConvergedError
        self._slope = slope
        if self.factor < 1.0 <= factor:
            return self._end(at)
        equation = at.equation(factor)
        trial = self._evaluated(at, equation, Δx)
        at.tangent.factor(trial)
        found = FoundForces(None, NONE_FOUND)
        return equation, NewtonIterate(trial, found, trial.residual, zero, size, iteration), factor

    def _end(self, at: PathStart) -> tuple[QuasiStaticResidual, NewtonIterate, float]:
        """The last step, to the whole load."""
        equation = at.equation(1.0)
        solution = solve_equilibrium(
            equation, at.tangent, FoundForces(None, NONE_FOUND), at.model.dot, lambda iteration, residual: None
        )
        return equation, solution, 1.0

    @staticmethod
    def _evaluated(at: PathStart, equation: QuasiStaticResidual, Δx: Array) -> TrialStep:
        with np.errstate(all="ignore"):
            trial = equation.evaluate(Δx / at.h)
        if not math.isfinite(at.model.dot(trial.residual, trial.residual)):
            raise NotConvergedError
        return trial

    def _change(self, at: PathStart, Δx: Array, at_rest: Array, by_load: Array) -> float:
        """δλ with |at_rest + δλ by_load| = s, of two the one that turns Δx less."""
        assert self._length is not None
        a, b = at.dot(by_load, by_load), at.dot(by_load, at_rest)
        c = at.dot(at_rest, at_rest) - self._length**2
        if b * b < a * c:
            raise NotConvergedError
        root = math.sqrt(b * b - a * c)
        return ((root if at.dot(Δx, by_load) > 0 else -root) - b) / a

    def _note_limit(self, at: PathStart, slope: float) -> None:
        """Notes that the load had a limit on the last step, where dλ/ds now has another sign than at its start.

        It is that of the cubic with the load factors and slopes at both ends.
        """
        if self._last is None or slope * self._last[2] > 0:
            return
        Δx, before, slope_before = self._last
        self._last = Δx, before, slope  # as this may be looked at again
        s = math.sqrt(at.dot(Δx, Δx))
        rise, a, b = self.factor - before, s * slope_before, s * slope
        cubic = np.polynomial.Polynomial([before, a, 3 * rise - 2 * a - b, a + b - 2 * rise])
        limit = next(float(cubic(z.real)) for z in cubic.deriv().roots() if 0 <= z.real <= 1)
        which = "largest" if slope < 0 else "smallest"
        self.messages.append(
            f"limit point: the load has a {which} value, {limit:.4g} of that of the run, in step {self.steps}"
        )

    def _note(self, at: PathStart, solution: NewtonIterate, factor: float) -> None:
        """Where the path has come to, what there was on the way, and how long the next step is to be."""
        assert self._length is not None
        self.steps += 1
        self._last = at.h * solution.trial.v, self.factor, self._slope
        pivots = at.tangent.negative_pivots
        if pivots != self._pivots:
            self.messages.append(
                f"at {self.factor:.4g} to {factor:.4g} of the load, in step {self.steps}, the tangent gets {pivots} "
                f"negative pivots, where it had {self._pivots}: a limit point, or another path crosses this one"
            )
        self.factor, self._pivots = factor, pivots
        grown = math.sqrt(TARGET_ITERATIONS / max(solution.iterations, 1))
        self._length *= min(LONGER, max(SHORTER, grown))
