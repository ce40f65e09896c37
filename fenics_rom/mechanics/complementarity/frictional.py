"""Contact with Coulomb's friction: semismooth Newton, then interior points, then paths of shrinking compliance.

With z = f - ρ u for any ρ > 0 the conditions are f = P(z), P(z) = z_n⁺ n + z_t min(1, μ z_n⁺/|z_t|) (Alart & Curnier,
CMAME 92, 1991), which tells for each pair whether it is open, sticks or slips. Newton's method on it is an active-set
method with three unknowns for a pair that sticks and two for one that slips.
"""

from contextlib import suppress
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from fenics_rom.mechanics.complementarity.interior_point import find_interior_point
from fenics_rom.mechanics.complementarity.solution import (
    CONVERGENCE_TOLERANCE,
    NEGLIGIBLE_RESIDUAL,
    NEWTON_ITERATIONS,
    PROXIMAL_COMPLIANCE,
    STAGNATION_RESIDUAL,
    Array,
    Solution,
    check_residual,
)

_ONES, _XYZ, _NEXT, _LAST = np.ones(3), np.arange(3), np.array([1, 2, 0]), np.array([2, 0, 1])
_OPEN, _STICK, _SLIP = np.int8(0), np.int8(1), np.int8(2)
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

    def __init__(self, W: Array, q: Array, normals: Array, friction: float, compliance: Array):
        self.W, self.q, self.normals, self.μ, self.compliance = W, q, normals, friction, compliance[:, None]
        self.ρ = 1 / self.compliance
        self.speed = float(np.abs(q).max())
        self.best, self.velocities, self.error, self.iterations = q, q, np.inf, 0

    def solve(self, start: Array) -> Solution:
        """See `complementarity.solve`."""
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
            ratio = cone / (np.maximum(length, cone) + 1e-300)
            projected = pressure[:, None] * n + ratio[:, None] * zt
            error, before = float(np.abs((f - projected) * self.compliance).max()), self.error
            if error < before:
                self.best, self.velocities, self.error = projected, u, error
            if error <= allowed or before / 2 < self.error <= STAGNATION_RESIDUAL * self.speed:
                return True
            status = np.where(length > cone, _SLIP, _STICK)
            status[zn <= 0] = _OPEN
            self.iterations += 1
            try:
                f = self._solve_linearised(f, status, zt, length, cone, proximal)
            except np.linalg.LinAlgError:
                return False
        return False

    def _solve_linearised(
        self, f: Array, status: Array, zt: Array, length: Array, cone: Array, proximal: float
    ) -> Array:
        """The forces that solve the equations linearised at f with the given statuses.

        A pair that sticks keeps f as its unknowns and u = 0 as equations. For one that slips to d = z_t/|z_t|, with
        p = n x d, f = λ (n + μ d) + θ p; n·u = 0 and p·u + (|z_t|/(μ z_n) - 1)/ρ θ = 0.
        """
        layout = _lay_out(status.tobytes())
        if not layout.unknowns:
            return np.zeros_like(f)
        if 3 * len(f) == layout.unknowns:  # everything sticks: E = T = I
            G = self.W.copy()
            G.ravel()[:: len(G) + 1] += proximal * self.compliance[layout.pairs, 0]
            return f - np.linalg.solve(G, self.W.dot(f.ravel()) + self.q.ravel()).reshape(f.shape)
        E = np.zeros((f.size, layout.unknowns))
        E.ravel()[layout.stick_entries] = 1.0
        added_compliance = proximal * self.compliance[layout.pairs, 0]
        slip = layout.slip
        if len(slip):
            T = E.copy()
            n, tangential = self.normals[slip], length[slip]
            d = zt[slip] / tangential[:, None]
            basis = np.empty((len(slip), 3, 2))
            basis[:, :, 0] = n
            basis[:, :, 1] = n[:, _NEXT] * d[:, _LAST] - n[:, _LAST] * d[:, _NEXT]
            T.ravel()[layout.slip_entries] = basis
            start = T.T.dot(f.ravel())
            basis[:, :, 0] += self.μ * d
            E.ravel()[layout.slip_entries] = basis
            slip_compliance = (tangential / cone[slip] - 1) * self.compliance[slip, 0]
        else:
            T, start = E, E.T.dot(f.ravel())
        WE = self.W.dot(E)
        residual = T.T.dot(WE.dot(start) + self.q.ravel())
        if len(slip):
            added_compliance[layout.sideways] += slip_compliance
            residual[layout.sideways] += slip_compliance * start[layout.sideways]
        G = T.T.dot(WE)
        G.ravel()[:: layout.unknowns + 1] += added_compliance
        return E.dot(start - np.linalg.solve(G, residual)).reshape(f.shape)

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
        compliance = self.compliance[:, 0]
        while path_compliance > PROXIMAL_COMPLIANCE:
            W = self.W.copy()
            W.ravel()[:: len(W) + 1] += path_compliance * np.repeat(self.compliance, 3)
            softer = FrictionalProblem(W, self.q, self.normals, self.μ, compliance)
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


class _Layout(NamedTuple):
    """Where the unknowns of all pairs are: three of each that sticks, then two of each that slips."""

    unknowns: int  # their number m
    pairs: Array  # (m,) whose each is
    slip: Array  # (b,) pairs that slip
    sideways: Array  # (b,) their second unknowns
    stick_entries: Array  # of the ones in a matrix (3C, m), flattened
    slip_entries: Array  # (b, 3, 2) of the directions of what slips


@lru_cache(maxsize=256)
def _lay_out(statuses: bytes) -> _Layout:
    status = np.frombuffer(statuses, np.int8)
    stick, slip = np.flatnonzero(status == _STICK), np.flatnonzero(status == _SLIP)
    a, b = 3 * len(stick), 2 * len(slip)
    columns = a + np.arange(b).reshape(-1, 1, 2)
    return _Layout(
        unknowns=a + b,
        pairs=np.concatenate([np.repeat(stick, 3), np.repeat(slip, 2)]),
        slip=slip,
        sideways=a + np.arange(1, b, 2),
        stick_entries=(3 * stick[:, None] + _XYZ).ravel() * (a + b) + np.arange(a),
        slip_entries=(3 * slip[:, None, None] + _XYZ[:, None]) * (a + b) + columns,
    )
