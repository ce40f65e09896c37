"""Contact with Coulomb's friction: semismooth Newton, then interior points.

With z = f - ρ u for any ρ > 0 the conditions are f = P(z), P(z) = z_n⁺ n + z_t min(1, μ z_n⁺/|z_t|) (Alart & Curnier,
CMAME 92, 1991), which tells for each pair whether it is open, sticks or slips. Newton's method on it is an active-set
method with three unknowns for a pair that sticks and two for one that slips.
"""

from contextlib import suppress
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.complementarity.delassus import FramedDelassus
from fenics_rom.mechanics.complementarity.interior_point import STARTS, find_interior_point
from fenics_rom.mechanics.complementarity.linearised import Linearisation, LinearisationByVelocities, linearised
from fenics_rom.mechanics.complementarity.solution import (
    CONVERGENCE_TOLERANCE,
    NEGLIGIBLE_RESIDUAL,
    NEWTON_ITERATIONS,
    PROXIMAL_COMPLIANCE,
    REGULAR_SHARE,
    STAGNATION_RESIDUAL,
    KeptLaw,
    Solution,
    check_residual,
    largest,
    statuses_of,
)

SHARES = REGULAR_SHARE, 1.0  # ρ in parts of each pair's stiffness; where one share cycles, another may not
_FIRST_COMPLIANCE = 1e-4  # proximal, to begin with: where W hardly tells forces apart, Newton's method would cycle
_FIRST_ITERATIONS = 8  # of Newton's method, with it
_NEAR_ENOUGH = 1e-6  # residual below which other starts of the interior-point method are not worth their time


class _Law(NamedTuple):
    """What the law says at forces f with velocities u."""

    z: Array  # f - ρ u (3, C), N
    length: Array  # |z_t| (C,), N
    cone: Array  # μ z_n (C,), N; 0 where a pair is open
    projected: Array  # P(z) (3, C), N

    @property
    def statuses(self) -> bytes:
        """Of each pair whether it is open, sticks or slips."""
        return statuses_of(self.length, self.cone)


def look_at(
    f: Array, u: Array, ρ: Array, compliance: Array, friction: float
) -> tuple[Array, Array, Array, Array, float]:
    """What _Law has of forces f with velocities u (3, C), and how far f is from P(z), m/s; compliance is 1/ρ."""
    z = f - ρ * u
    length, cone = np.hypot(z[1], z[2]), friction * z[0]
    if not largest(length >= cone):  # all stick
        return z, length, cone, z, largest(np.abs(u))
    np.maximum(cone, 0.0, out=cone)
    projected = z * (cone / (np.maximum(length, cone) + 1e-300))
    np.maximum(z[0], 0.0, out=projected[0])
    return z, length, cone, projected, largest(np.abs((f - projected) * compliance))


def response(operator: FramedDelassus, friction: float, forces: Array, velocities: Array, change: Array) -> Array:
    """What forces that solve a problem change by, (3, C), N, as long as all pairs do what they do.

    Args:
        operator, friction: as in `complementarity.solve`.
        forces, velocities: the solution, (3, C) each.
        change: of q, (3, C), m/s.

    Raises:
        LinAlgError: they are not determined.
    """
    proximal = 0.0 if operator.is_regular else PROXIMAL_COMPLIANCE
    ρ, compliance = operator.scaled(SHARES[0])
    z, length, cone, *_ = look_at(forces, velocities, ρ, compliance, friction)
    return linearised(operator, friction, compliance, z, length, cone, proximal).change(change)


class FrictionalProblem:
    """The conditions of C pairs as in `complementarity.solve`, and the best forces found so far.

    Attributes:
        best: (3, C) forces in their cones, N.
        velocities: (3, C) with them, m/s.
        error: their residual, m/s.
        iterations: of all methods.
    """

    def __init__(self, operator: FramedDelassus, q: Array, friction: float):
        self.operator, self.q, self.μ = operator, q, friction
        self._take_share(SHARES[0])
        self.speed = largest(np.abs(q))
        self.best, self.velocities, self.error, self.iterations = q, q, np.inf, 0
        self._law: _Law  # at the forces that were looked at last

    def solve(
        self, start: Array, kept: KeptLaw | None = None, is_steady: bool = False, is_patient: bool = True
    ) -> Solution:
        """See `complementarity.solve`."""
        if self.operator.is_regular:
            start = self._nearer(start)
        else:
            self._take_share(SHARES[1])
        found = self.search_newton(start, _FIRST_COMPLIANCE, _FIRST_ITERATIONS)
        if not found:
            self._take_share(SHARES[self.operator.is_regular])
            found = self.search_newton(self.best)
        if not (found or is_patient):
            raise StepError(f"contact of {self.q.shape[1]} pairs: Newton's method found no forces")
        if not found:
            with np.errstate(all="ignore"):  # what diverges ends
                self.search_interior()
            check_residual(self.error / self.speed, self.q.shape[1], self.iterations)
        law = self._to_keep(kept, is_steady)
        return Solution(self.best, self.velocities, self.iterations, self.error / self.speed, law)

    def _take_share(self, share: float) -> None:
        """Sets ρ, and 1/ρ, in the law that Newton's method solves: the solution is the same."""
        self.ρ, self.compliance = self.operator.scaled(share)

    def search_newton(
        self,
        f: Array,
        proximal: float = PROXIMAL_COMPLIANCE,
        iterations: int = NEWTON_ITERATIONS,
        tolerance: float = CONVERGENCE_TOLERANCE,
    ) -> bool:
        """Whether Newton's method arrives from f within so many iterations; the best forces are kept."""
        if self.operator.is_regular:
            proximal = 0.0
        self.operator.are_kept = True  # there are products enough for it to pay
        for _ in range(iterations):
            if self._arrives_at(f, tolerance):
                return True
            self.iterations += 1
            law = self._law
            try:
                f = law.projected + self._linearised(law, proximal).change(self._velocities(law.projected))
            except np.linalg.LinAlgError:
                return False
        return False

    def _nearer(self, start: Array) -> Array:
        """Forces with which all pairs would stick, brought into their cones, if nearer than those to start with."""
        sticking = -self.operator.inverse.dot(self.q.ravel()).reshape(self.q.shape)
        within = look_at(sticking, np.zeros_like(sticking), self.ρ, self.compliance, self.μ)[3]
        off = [look_at(f, self._velocities(f), self.ρ, self.compliance, self.μ)[-1] for f in (start, within)]
        return within if off[1] < off[0] else start

    def _arrives_at(self, f: Array, tolerance: float) -> bool:
        """Looks at forces f, and whether they solve the problem."""
        u = self._velocities(f)
        before = self.error
        *law, error = look_at(f, u, self.ρ, self.compliance, self.μ)
        self._law = _Law(*law)
        if error < before:
            self.best, self.velocities, self.error = self._law.projected, u, error
        return error <= tolerance * self.speed or before / 2 < self.error <= STAGNATION_RESIDUAL * self.speed

    def _velocities(self, f: Array) -> Array:
        """u (3, C) with forces f."""
        u = self.operator.moved(f)
        u += self.q
        return u

    def _linearised(self, law: _Law, proximal: float = 0.0) -> Linearisation | LinearisationByVelocities:
        return linearised(self.operator, self.μ, self.compliance, law.z, law.length, law.cone, proximal)

    def _to_keep(self, kept: KeptLaw | None, is_steady: bool) -> KeptLaw | None:
        """What to begin the next search with: an inverse where the next step may need none.

        That is where motion has been steady, or pairs stick and slip as in the search before this.
        """
        if not self.operator.is_regular:
            return None
        statuses, inverse = self._law.statuses, None
        if is_steady or (kept is not None and (kept.statuses == statuses or self._are_nearly(kept.statuses))):
            with suppress(np.linalg.LinAlgError):
                inverse = self.operator.in_lasting_axes(self._linearised(self._law).inverse())
        frames = self.operator.frames
        q, best = frames.to_lasting_axes(frames.in_space(self.q), frames.in_space(self.best))
        return KeptLaw(statuses, inverse, q, best)

    def _are_nearly(self, statuses: bytes) -> bool:
        """Whether pairs do what they did but for those at the border of their cones, where round-off decides."""
        differ = np.frombuffer(statuses, dtype=bool) != np.frombuffer(self._law.statuses, dtype=bool)
        off = np.abs(self._law.length - self._law.cone) * differ.reshape(2, -1).any(axis=0)
        return largest(off) <= NEGLIGIBLE_RESIDUAL * largest(self._law.cone)

    def search_interior(self) -> bool:
        """Whether Newton's method arrives from an approximation by an interior-point method."""
        for start in STARTS:
            if self._search_interior_from(start):
                return True
            if self.error <= _NEAR_ENOUGH * self.speed:
                break
        return False

    def _search_interior_from(self, start: tuple[float, float]) -> bool:
        forces, residual, iterations, finished = find_interior_point(
            self.operator.matrix, self.q, self.μ, self.compliance, self.search_newton, start
        )
        self.iterations += iterations
        if finished or not (residual <= NEGLIGIBLE_RESIDUAL / 10 and np.isfinite(forces).all()):
            return finished
        self.best, self.error = forces, residual * self.speed
        self.velocities = self._velocities(self.best)
        return True
