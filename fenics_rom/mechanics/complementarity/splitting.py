"""Contact forces of many bodies that share a Delassus operator: Douglas and Rachford's splitting (ADMM).

With velocities y = ρ f in place of forces, and Alart and Curnier's Π of a pair (see `frictional`), what is searched for
is a fixed point z of

    z ← z + α (N (2 Π(z) - z - q) - Π(z)),    N = ρ (W + ρ)⁻¹,    f = Π(z)/ρ.

N is inverted once; an iteration is one product for all bodies and some thirty elementwise operations. With s = z + q
and w = 2 Π(z) - s it is s ← (1 - α/2) s + α (N - ½) w. ρ = √(λmin λmax) of W makes it settle in some 16 iterations
where W has a condition of a few hundred. That W has one at all is owed to the residual compliance. What does not
settle, and bodies with few pairs, are for Newton's method (`batched_newton`).

Arrays hold bodies along their last axis and axes x, y, z along their first, as the elementwise operations want them.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.body_axis import put, taken
from fenics_rom.mechanics.complementarity.batched_newton import BatchedNewton
from fenics_rom.mechanics.complementarity.problems import Problems

RELAXATION = 1.85  # α
TOLERANCE = 5e-7  # residual, as a share of the velocities that the forces have to stop
FLOOR = 1e-3  # of λmax, that λmin is taken to be at least
CHECKS_EVERY, MOST_ITERATIONS = 2, 80
GROUP = 512  # bodies that go through the iterations together, so that their arrays stay in the cache
LEAVES_AT = 0.75  # of a group: when so few go on, the others are taken out of the arrays
POOLED_AT = 0.3  # of a group: when so few go on, they wait for those of the other groups
FEW = 8  # pairs, that Newton's method is faster for, where it leaves out most of the points
FEW_AT = 0.4  # of the points: so few they have to be
_TINY = 1e-300  # m/s


class Splitting:
    """A Delassus operator of P points that many bodies share.

    Args:
        W: (3P, 3P), symmetric and positive definite, m/s/N; rows are all x, then all y, then all z.

    Attributes:
        W: as given.
        ρ: m/s/N.
    """

    def __init__(self, W: Array):
        self.W = W
        λ = np.linalg.eigvalsh(W)
        condition = 1 / max(FLOOR, float(λ[0] / λ[-1]))
        self.ρ = float(λ[-1]) / np.sqrt(condition)
        identity = np.eye(len(W))
        self._K = RELAXATION * (np.linalg.inv(W / self.ρ + identity) - identity / 2)
        self._newton = BatchedNewton(W, TOLERANCE)
        # What an iteration changes bounds the residual by this, in the metric in which it contracts.
        self._stop = RELAXATION * TOLERANCE * 2 / (1 + np.sqrt(condition))

    def solve(self, problems: Problems, z: Array) -> tuple[Array, Array, Array]:
        """Forces (3, P, B), exactly in their cones, N; z (3, P, B) that led to them; bodies that did not settle.

        Args:
            problems: of the bodies.
            z: to begin with, m/s: where the last step's ended.
        """
        counts = np.count_nonzero(problems.due, axis=0)
        few = counts <= min(FEW, FEW_AT * len(problems.due))
        s = (z + problems.q).reshape(len(self.W), -1)
        unsettled = self._split(problems, s, (~few).nonzero()[0])
        z = s.reshape(problems.q.shape) - problems.q
        spare = _Spare.of(problems)
        normal, tangential = factors_of_projection(z, problems, spare)
        forces = normal * problems.normals
        forces += np.multiply(tangential, z, out=spare.w)
        forces /= self.ρ
        failed = []
        for bodies in (few.nonzero()[0], unsettled):
            if not len(bodies):
                continue
            slots = max(1, int(counts[bodies].max()))
            found, left = self._newton.solve(problems, taken(forces, bodies), bodies, slots)
            put(forces, bodies, found)
            put(z, bodies, self.ρ * found - taken(problems.q, bodies) - self.moved(found))
            failed.append(bodies[left])
        return forces, z, np.concatenate(failed) if failed else unsettled

    def _split(self, problems: Problems, s: Array, bodies: Array) -> Array:
        """Iterates s (3P, B) of these bodies; those that did not settle."""
        waiting = []
        for first in range(0, len(bodies), GROUP):
            group = bodies[first : first + GROUP]
            waiting.append(self._iterate(problems, s, group, int(POOLED_AT * len(group)), 0))
        left = [(group, count) for group, count in waiting if len(group)]
        pooled = np.concatenate([group for group, _ in left]) if left else np.empty(0, int)
        begun = min((count for _, count in left), default=0)
        unsettled = [
            self._iterate(problems, s, pooled[first : first + GROUP], 0, begun)[0]
            for first in range(0, len(pooled), GROUP)
        ]
        return np.concatenate(unsettled) if unsettled else pooled

    def moved(self, forces: Array) -> Array:
        """W f (3, P, B), m/s."""
        velocities: Array = np.matmul(self.W, forces.reshape(len(self.W), -1)).reshape(forces.shape)
        return velocities

    def _iterate(self, problems: Problems, s: Array, bodies: Array, least: int, begun: int) -> tuple[Array, int]:
        """Iterates s (3P, B) of these bodies until no more than `least` go on; those, and how many iterations it took.

        `begun`: iterations that were taken before.
        """
        own, part, iteration = taken(s, bodies), problems.of(bodies), begun
        speed = np.abs(part.q).max(axis=(0, 1))
        spare = _Spare.of(part)
        while iteration < MOST_ITERATIONS:
            iteration += 1
            looks = iteration % CHECKS_EVERY == 0
            before = own.copy() if looks else own
            w, moved = spare.w, spare.moved
            np.subtract(own.reshape(w.shape), part.q, out=w)
            normal, tangential = factors_of_projection(w, part, spare)
            tangential *= 2
            tangential -= 1
            normal *= 2
            w *= tangential
            w -= part.q
            np.multiply(part.normals, normal, out=moved)
            w += moved  # 2 Π(z) - s
            np.matmul(self._K, w.reshape(own.shape), out=moved.reshape(own.shape))
            own *= 1 - RELAXATION / 2
            own += moved.reshape(own.shape)
            if not looks:
                continue
            before -= own
            goes_on = np.abs(before, out=before).max(axis=0) > self._stop * speed
            left = goes_on.nonzero()[0]
            if len(left) <= max(least, LEAVES_AT * len(bodies)):
                put(s, bodies, own)
                bodies = bodies[left]
                if len(left) <= least:
                    return bodies, iteration
                own, part, speed = taken(own, left), part.of(left), speed[left]
                spare = _Spare.of(part)
        put(s, bodies, own)
        return bodies, iteration


class _Spare(NamedTuple):
    """Arrays to work in."""

    w: Array  # (3, P, B)
    moved: Array  # (3, P, B)
    pairs: Array  # (4, P, B)
    all_due: bool

    @staticmethod
    def of(problems: Problems) -> "_Spare":
        """For some bodies."""
        w, moved = np.empty((2, *problems.q.shape))
        return _Spare(w, moved, np.empty((4, *problems.due.shape)), bool(problems.due.all()))


def factors_of_projection(z: Array, problems: Problems, spare: _Spare) -> tuple[Array, Array]:
    """a and b (P, B), which a later call overwrites, of Π(z) = a n + b z = z_n⁺ n + min(1, μ z_n⁺/|z_t|) z_t.

    Where a pair is not due both are 0. z_t is z - z_n n, and b z_n is taken out of a.
    """
    zn, length, pressure, ratio = spare.pairs
    np.einsum("apb,apb->pb", z, problems.normals, out=zn)
    np.einsum("apb,apb->pb", z, z, out=length)
    np.maximum(zn, 0.0, out=pressure)
    if not spare.all_due:
        pressure *= problems.due
    np.multiply(zn, zn, out=ratio)
    length -= ratio
    np.maximum(length, _TINY, out=length)  # round-off of a z along n: it sticks in any case
    np.sqrt(length, out=length)
    np.multiply(pressure, problems.friction, out=ratio)
    np.maximum(length, ratio, out=length)
    ratio /= length
    zn *= ratio
    pressure -= zn
    return pressure, ratio
