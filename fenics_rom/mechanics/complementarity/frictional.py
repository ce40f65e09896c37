"""Contact with Coulomb's friction: semismooth Newton, then interior points, then paths of shrinking compliance.

With z = f - ρ u for any ρ > 0 the conditions are f = P(z), P(z) = z_n⁺ n + z_t min(1, μ z_n⁺/|z_t|) (Alart & Curnier,
CMAME 92, 1991), which tells for each pair whether it is open, sticks or slips. Newton's method on it is an active-set
method with three unknowns for a pair that sticks and two for one that slips.
"""

from contextlib import suppress

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.complementarity.delassus import Delassus
from fenics_rom.mechanics.complementarity.interior_point import find_interior_point
from fenics_rom.mechanics.complementarity.linearised import Linearisation
from fenics_rom.mechanics.complementarity.solution import (
    CONVERGENCE_TOLERANCE,
    NEGLIGIBLE_RESIDUAL,
    NEWTON_ITERATIONS,
    PROXIMAL_COMPLIANCE,
    STAGNATION_RESIDUAL,
    Solution,
    check_residual,
)

_ONES = np.ones(3)
_FIRST_COMPLIANCE = 1e-4  # proximal, to begin with: where W hardly tells forces apart, Newton's method would cycle
_FIRST_ITERATIONS = 8  # of Newton's method, with it
_PATH_RESIDUAL = 1e-6  # below it following a path, the slowest method, is not worth its time
_PATHS = ((0.3, 10), (0.6, 30))  # of shrinking compliance: the factor, and Gauss-Seidel sweeps where Newton cycles
_PATH_TOLERANCE = 1e-6  # of Newton's method on a path


class FrictionalProblem:
    """The conditions of C pairs as in `complementarity.solve`, and the best forces found so far.

    Attributes:
        best: (C, 3) forces in their cones, N.
        velocities: (C, 3) with them, m/s.
        error: their residual, m/s.
        iterations: of all methods.
    """

    def __init__(self, operator: Delassus, q: Array, normals: Array, friction: float):
        self.operator, self.W, self.compliance = operator, operator.matrix, operator.compliance[:, None]
        self.q, self.normals, self.μ = q, normals, friction
        self.ρ = operator.stiffness
        self.speed = float(np.abs(q).max())
        self.best, self.velocities, self.error, self.iterations = q, q, np.inf, 0
        self.closed_before = b""

    def solve(self, start: Array) -> Solution:
        """See `complementarity.solve`."""
        self.closed_before = start.any(axis=1).tobytes()
        if not self.search_newton(start, _FIRST_COMPLIANCE, _FIRST_ITERATIONS) and not self.search_newton(self.best):
            with np.errstate(all="ignore"):  # what diverges ends
                converged = self.search_interior()
                if not converged and not self.error <= _PATH_RESIDUAL * self.speed:
                    with suppress(np.linalg.LinAlgError):  # of compliances whose squares overflow
                        converged = any(self.follow_path(*path) for path in _PATHS)
            if not converged:
                check_residual(self.error / self.speed, len(self.q), self.iterations)
        return Solution(self.best, self.velocities, self.iterations, self.error / self.speed)

    def search_newton(
        self,
        f: Array,
        proximal: float = PROXIMAL_COMPLIANCE,
        iterations: int = NEWTON_ITERATIONS,
        tolerance: float = CONVERGENCE_TOLERANCE,
    ) -> bool:
        """Whether Newton's method arrives from f within so many iterations; the best forces are kept."""
        q, n, allowed = self.q, self.normals, tolerance * self.speed
        for _ in range(iterations):
            u = self.W.dot(f.ravel()).reshape(f.shape)
            u += q
            z = f - self.ρ * u
            zn = (z * n).dot(_ONES)
            zt = z - zn[:, None] * n
            length = np.sqrt((zt * zt).dot(_ONES))
            pressure = np.maximum(zn, 0.0)
            cone = self.μ * pressure
            if (length < cone).all():  # everything sticks
                projected, error = z, float(np.abs(u).max())
            else:
                ratio = cone / (np.maximum(length, cone) + 1e-300)
                projected = pressure[:, None] * n + ratio[:, None] * zt
                error = float(np.abs((f - projected) * self.compliance).max())
            before = self.error
            if error < before:
                self.best, self.velocities, self.error = projected, u, error
            if error <= allowed or before / 2 < self.error <= STAGNATION_RESIDUAL * self.speed:
                return True
            self.iterations += 1
            law = Linearisation(f, u, zn > 0, length > cone, zt, length, cone)
            try:
                f = self._solve_linearised(law, proximal)
            except np.linalg.LinAlgError:
                return False
        return False

    def _solve_linearised(self, law: Linearisation, proximal: float) -> Array:
        """The forces (C, 3) that solve the law linearised; where the same pairs as before touch, by a kept inverse."""
        n, μ, compliance = self.normals, self.μ, self.compliance[:, 0]
        if self.operator.is_regular:
            if law.closed.tobytes() == self.closed_before:
                return law.solved_with(self.operator.inverse(law.closed), self.W, self.q, n, μ, compliance)
            proximal = 0.0
        return law.solved(self.W, self.q, n, μ, compliance, proximal)

    def search_interior(self) -> bool:
        """Whether Newton's method arrives from an approximation by an interior-point method."""
        forces, residual, iterations, finished = find_interior_point(
            self.W, self.q, self.normals, self.μ, self.compliance, self.search_newton
        )
        self.iterations += iterations
        if finished or not (residual <= NEGLIGIBLE_RESIDUAL / 10 and np.isfinite(forces).all()):
            return finished
        self.best, self.error = forces, residual * self.speed
        self.velocities = self.W.dot(self.best.ravel()).reshape(self.q.shape) + self.q
        return True

    def follow_path(self, factor: float, sweeps: int) -> bool:
        """Whether Newton's method arrives along solutions of problems with a compliance that shrinks by the factor."""
        f, path_compliance = np.zeros_like(self.q), 10.0
        while path_compliance > PROXIMAL_COMPLIANCE:
            W = self.W.copy()
            W.ravel()[:: len(W) + 1] += path_compliance * np.repeat(self.compliance, 3)
            softer = FrictionalProblem(Delassus(W), self.q, self.normals, self.μ)
            if not softer.search_newton(f, tolerance=_PATH_TOLERANCE):
                softer.search_newton(softer.sweep_pairs(softer.best, sweeps), tolerance=_PATH_TOLERANCE)
            self.iterations += softer.iterations
            f = softer.best
            if path_compliance < 0.01 and self.search_newton(f):
                return True
            path_compliance *= factor
        return False

    def sweep_pairs(self, forces: Array, sweeps: int) -> Array:
        """Forces (C, 3) after that many sweeps of block Gauss-Seidel: slow, but it gets nearer where Newton cycles.

        One pair after the other, normal before tangent (Jean, CMAME 177, 1999).
        """
        W, n, pairs, floor = self.W, self.normals, np.arange(len(forces)), 1e-12 * self.compliance[:, 0]
        f, blocks = forces.copy(), W.reshape(len(pairs), 3, -1, 3)[pairs, :, pairs]
        normal_compliance = np.maximum(((blocks @ n[:, :, None])[:, :, 0] * n).dot(_ONES), floor)
        tangential = np.eye(3) - n[:, :, None] * n[:, None, :]
        tangential_compliance = np.maximum(np.linalg.eigvalsh(tangential @ blocks @ tangential)[:, -1], floor)
        for _ in range(sweeps):
            self.iterations += 1
            before = f.copy()
            for i in pairs:
                rows = W[3 * i : 3 * i + 3]
                λ = n[i].dot(f[i])
                λ_new = max(0.0, λ - n[i].dot(rows.dot(f.ravel()) + self.q[i]) / normal_compliance[i])
                f[i] += (λ_new - λ) * n[i]
                slip = tangential[i].dot(rows.dot(f.ravel()) + self.q[i]) / tangential_compliance[i]
                t = f[i] - λ_new * n[i] - slip
                f[i] = λ_new * n[i] + t * min(1.0, self.μ * λ_new / max(np.sqrt(t.dot(t)), 1e-300))
            if np.abs(f - before).max() <= 1e-15 * np.abs(f).max():
                break
        return f
