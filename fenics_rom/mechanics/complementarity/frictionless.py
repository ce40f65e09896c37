"""Contact without friction: a linear complementarity problem, by a primal-dual active set or by Lemke's pivots."""

from contextlib import suppress

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.complementarity.delassus import FramedDelassus
from fenics_rom.mechanics.complementarity.pivoting import solve_by_pivots
from fenics_rom.mechanics.complementarity.solution import (
    CONVERGENCE_TOLERANCE,
    NEWTON_ITERATIONS,
    PROXIMAL_COMPLIANCE,
    STAGNATION_RESIDUAL,
    KeptLaw,
    Solution,
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
            with np.errstate(all="ignore"), suppress(np.linalg.LinAlgError):  # what diverges ends
                self.search_by_pivots()
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

    def search_by_pivots(self) -> bool:
        """Whether the active set settles from the forces that pivots find."""
        root = np.sqrt(self.compliance)
        M, p = self.M / (root * root[:, None]), self.r / root
        scale = float(np.abs(p).max())
        y = solve_by_pivots(M, p / scale)
        if y is None:
            return False
        λ = scale * y / root
        return self._arrives_at(λ) or self.search_active_set(λ)
