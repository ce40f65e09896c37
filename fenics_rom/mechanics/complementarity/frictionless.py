"""Contact without friction: a linear complementarity problem, by a primal-dual active set or by interior points."""

from contextlib import suppress

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.complementarity.delassus import FramedDelassus
from fenics_rom.mechanics.complementarity.solution import (
    CONVERGENCE_TOLERANCE,
    FINISH_REDUCTION,
    FIRST_FINISH_RESIDUAL,
    INTERIOR_POINT_ACCURACY,
    INTERIOR_POINT_ITERATIONS,
    NEGLIGIBLE_RESIDUAL,
    NEWTON_ITERATIONS,
    PROXIMAL_COMPLIANCE,
    STAGNATION_RESIDUAL,
    STEP_FRACTION,
    KeptLaw,
    Solution,
    centering,
    check_residual,
    largest,
)


class FrictionlessProblem:
    """0 <= λ ⟂ M λ + r >= 0 of the normal forces λ, with M and r the normal parts of W and q."""

    def __init__(self, operator: FramedDelassus, q: Array):
        C = q.shape[1]
        self.operator, self.q = operator, q
        self.M, self.r = operator.matrix[:C, :C], q[0]
        self.compliance = np.maximum(self.M.diagonal(), 1e-12 * operator.compliance)
        self.speed = largest(np.abs(self.r))
        self.best, self.error, self.iterations = self.r, np.inf, 0

    def solve(self, start: Array, kept: KeptLaw | None = None) -> Solution:
        """See `complementarity.solve`."""
        if not self.search_active_set(start[0]):
            converged = False
            with np.errstate(all="ignore"), suppress(np.linalg.LinAlgError):  # what diverges ends
                converged = self.search_interior()
            if not converged:
                check_residual(self.error / self.speed, len(self.r), self.iterations)
        return self._solution(self._to_keep(kept))

    def _solution(self, kept: KeptLaw | None) -> Solution:
        f = np.zeros_like(self.q)
        f[0] = self.best
        u = self.operator.moved(f) + self.q
        return Solution(f, u, self.iterations, self.error / self.speed, kept)

    def _to_keep(self, kept: KeptLaw | None) -> KeptLaw | None:
        """What to begin the next search with: an inverse where the same pairs push as in the search before this."""
        closed = self.best > 0
        statuses = closed.tobytes()
        if kept is None or kept.statuses != statuses:
            zero = np.zeros(self.q.shape)
            return KeptLaw(statuses, None, zero, zero) if self.operator.is_regular else None
        if kept.inverse is not None:
            return kept
        inverse, among = np.zeros((self.q.size, self.q.size)), closed.nonzero()[0]
        inverse[among[:, None], among] = -np.linalg.inv(self.M[among[:, None], among])
        return kept._replace(inverse=self.operator.in_lasting_axes(inverse))

    def search_active_set(self, λ: Array) -> bool:
        """Whether the active set settles, beginning with that of λ (Hintermüller, Ito & Kunisch, 2002)."""
        for _ in range(NEWTON_ITERATIONS):
            if self._arrives_at(λ):
                return True
            self.iterations += 1
            closed = np.flatnonzero(self._z > 0)
            M = self.M[closed[:, None], closed]
            residual = M.dot(λ[closed]) + self.r[closed]
            M.ravel()[:: len(closed) + 1] += PROXIMAL_COMPLIANCE * self.compliance[closed]
            λ, previous = np.zeros_like(λ), λ
            λ[closed] = previous[closed] - np.linalg.solve(M, residual)
        return False

    def _arrives_at(self, λ: Array) -> bool:
        """Looks at forces λ, and whether they solve the problem."""
        self._z = λ - (self.M.dot(λ) + self.r) / self.compliance
        projected = np.maximum(self._z, 0.0)
        error, before = largest(np.abs((λ - projected) * self.compliance)), self.error
        if error < before:
            self.best, self.error = projected, error
        stagnates = before / 2 < self.error <= STAGNATION_RESIDUAL * self.speed
        return error <= CONVERGENCE_TOLERANCE * self.speed or stagnates

    def search_interior(self) -> bool:
        """Whether the active set settles from an approximation by Mehrotra's predictor-corrector method (1992)."""
        root = np.sqrt(self.compliance)
        M, p = self.M / (root * root[:, None]), self.r / root
        scale = float(np.abs(p).max())
        p /= scale
        y, z = np.ones_like(p), np.ones_like(p)
        finish_residual, error = FIRST_FINISH_RESIDUAL, np.inf
        for _ in range(INTERIOR_POINT_ITERATIONS):
            self.iterations += 1
            τ = float(y.dot(z)) / len(y)
            residual = M.dot(y) + p - z
            error = max(float(np.abs(residual).max()), τ)
            if not INTERIOR_POINT_ACCURACY < error < 1 / INTERIOR_POINT_ACCURACY:
                break
            if error < finish_residual:
                finish_residual = error / FINISH_REDUCTION
                if self.search_active_set(scale * y / root):
                    return True
            G = M.copy()
            G.ravel()[:: len(y) + 1] += z / y
            target = -y * z
            for is_corrector in (False, True):
                Δy = np.linalg.solve(G, target / y - residual)
                Δz = M.dot(Δy) + residual
                α = min(_step_to_border(y, Δy), _step_to_border(z, Δz))
                if not is_corrector:
                    target += centering(α, τ) - Δy * Δz
            y, z = y + STEP_FRACTION * α * Δy, z + STEP_FRACTION * α * Δz
        if not (error <= NEGLIGIBLE_RESIDUAL / 10 and np.isfinite(y).all()):
            return False
        self.best, self.error = scale * y / root, error * self.speed
        return True


def _step_to_border(y: Array, Δy: Array) -> float:
    """The largest α <= 1 with y + α Δy >= 0."""
    falls = Δy < 0
    return min(1.0, float((y[falls] / -Δy[falls]).min(initial=1.0)))
