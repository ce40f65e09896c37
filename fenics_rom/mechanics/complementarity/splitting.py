"""Contact forces of many bodies that share a Delassus operator: Douglas and Rachford's splitting (ADMM).

With velocities y = ρ f in place of forces, and Alart and Curnier's Π of a pair (see `frictional`), what is searched for
is a fixed point z = ρ f - u of

    z ← z + α (N (2 Π(z) - z - q) - Π(z)),    N = ρ (W + ρ)⁻¹,    f = Π(z)/ρ,    u = Π(z) - z.

N is inverted once; an iteration is one product for all bodies and some thirty elementwise operations. With s = z + q
it is s ← s + α (N - ½) (2 Π(z) - s) - α/2 s. ρ = √(λmin λmax) of W makes it settle in some 16 iterations where W has a
condition of a few hundred. That W has one at all is owed to the residual compliance. After every two iterations s goes
as far again along the second change g₂ as g₂ - g₁ tells: Anderson's extrapolation, of which two changes are enough.

What all points moved at is tried first. Forces under which they move at u are W⁻¹ (u - q): where all pairs stick, as
they did, these are the solution. All others are iterated in single precision, as far as it goes, and once more go on
with the velocities found, from which forces are those of double precision. Few have to be iterated in that. What then
does not settle, and bodies with few pairs, are for Newton's method (`batched_newton`).

Arrays hold bodies along their last axis and axes x, y, z along their first, as the elementwise operations want them.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.body_axis import in_one_piece, put, taken
from fenics_rom.mechanics.complementarity.batched_newton import BatchedNewton
from fenics_rom.mechanics.complementarity.problems import Problems

RELAXATION = 1.4  # α
TOLERANCE = 5e-7  # residual, as a share of the velocities that the forces have to stop
FLOOR = 1e-3  # of λmax, that λmin is taken to be at least
MOST_ITERATIONS = 80
ROUND_OFF = 2  # times that of single precision: changes at which iterations in it stop
GROUP_BYTES = 1 << 19  # of an array of bodies that go through the iterations together: all of them stay in the cache
LEAVES_AT = 0.75  # of a group: when so few go on, the others are taken out of the arrays
POOLED_AT = 0.3  # of a group: when so few go on, they wait for those of the other groups
FEW = 8  # pairs, that Newton's method is faster for, where it leaves out most of the points
FEW_AT = 0.4  # of the points: so few they have to be


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
        root = 1 / np.sqrt(max(FLOOR, float(λ[0] / λ[-1])))  # of the condition
        self.ρ = float(λ[-1]) / root
        identity = np.eye(len(W))
        self._stiffness = self.ρ * np.linalg.inv(W)
        self._newton = BatchedNewton(W, TOLERANCE)
        # What an iteration changes bounds the residual by this, in the metric in which it contracts. z may be longer
        # than velocities by the root, and has its own round-off.
        stop, coarse = RELAXATION * TOLERANCE * 2 / (1 + root), ROUND_OFF * float(np.finfo(np.float32).eps) * root
        K = RELAXATION * (np.linalg.inv(W / self.ρ + identity) - identity / 2)
        self._coarse, self._fine = _Iteration(K.astype(np.float32), coarse), _Iteration(K, stop)

    def solve(self, problems: Problems, z: Array) -> tuple[Array, Array, Array]:
        """Forces (3, P, B), exactly in their cones, N; z (3, P, B) that led to them; bodies that did not settle.

        Args:
            problems: of the bodies.
            z: to begin with, m/s: where the last step's ended.
        """
        counts = np.count_nonzero(problems.due, axis=0)
        few = counts <= min(FEW, FEW_AT * len(problems.due))
        s = z + problems.q
        unsettled = self._go_on(problems, s, (~few).nonzero()[0])
        self._iterate(self._coarse, problems, s, unsettled)
        unsettled = self._go_on(problems, s, unsettled)
        unsettled = self._iterate(self._fine, problems, s, unsettled)
        z = s - problems.q
        forces = _projected(s, problems, _Spare.of(problems))
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

    def moved(self, forces: Array) -> Array:
        """W f (3, P, B), m/s."""
        return _times(self.W, forces, np.empty_like(forces))

    def _go_on(self, problems: Problems, s: Array, bodies: Array) -> Array:
        """Has the points of these bodies move at u = Π(z) - z; those that this does not settle."""
        left = [bodies[:0]]
        for group in _groups(bodies, self.W):
            part, own = problems.of(group), taken(s, in_one_piece(group))
            spare = _Spare.of(part)
            change = _projected(own, part, spare) - own
            left.append(group[self._move(part, s, group, change, spare)])
        return np.concatenate(left)

    def _move(self, part: Problems, s: Array, bodies: Array, change: Array, spare: "_Spare") -> Array:
        """Sets s of bodies whose points change their velocities by u - q (3, P, B); which that does not settle."""
        y = _times(self._stiffness, change, np.empty_like(change))  # ρ f
        own = np.subtract(y, change, out=change)
        put(s, in_one_piece(bodies), own)
        y -= _projected(own, part, spare)
        settled = np.abs(y, out=y).max(axis=(0, 1)) <= TOLERANCE * np.abs(part.q).max(axis=(0, 1))
        return ~settled

    def _iterate(self, iteration: "_Iteration", problems: Problems, s: Array, bodies: Array) -> Array:
        """Iterates s (3, P, B) of these bodies; those that did not settle."""
        waiting, begun = [bodies[:0]], MOST_ITERATIONS
        for group in _groups(bodies, iteration.K):
            left, count = iteration.run(problems, s, group, int(POOLED_AT * len(group)), 0)
            waiting.append(left)
            begun = min(begun, count)
        pooled = np.concatenate(waiting)
        unsettled = [iteration.run(problems, s, group, 0, begun)[0] for group in _groups(pooled, iteration.K)]
        return np.concatenate([pooled[:0], *unsettled])


class _Iteration(NamedTuple):
    """Of s, in one precision."""

    K: Array  # α (N - ½), (3P, 3P)
    stop: float  # at changes that are so small a share of the velocities

    def run(self, problems: Problems, s: Array, bodies: Array, least: int, begun: int) -> tuple[Array, int]:
        """Iterates s (3, P, B) of bodies until no more than `least` go on; those, and how many iterations it took.

        `begun`: iterations that were taken before.
        """
        own, part, count = taken(s, bodies).astype(self.K.dtype), problems.of(bodies).astype(self.K.dtype), begun
        speed, spare = np.abs(part.q).max(axis=(0, 1)), _Spare.of(part)
        while count < MOST_ITERATIONS:
            count += 2
            first, second = spare.first, spare.second
            for change in (first, second):
                own += self._change(own, part, spare, change)
            first -= second
            share = np.einsum("apb,apb->b", first, second)
            share /= np.maximum(np.einsum("apb,apb->b", first, first), spare.tiny)
            own += np.multiply(second, share, out=first)
            goes_on = np.abs(second, out=second).max(axis=(0, 1)) > self.stop * speed
            left = goes_on.nonzero()[0]
            if len(left) <= max(least, LEAVES_AT * len(bodies)):
                put(s, in_one_piece(bodies), own)
                bodies = bodies[left]
                if len(left) <= least:
                    return bodies, count
                own, part, speed = taken(own, left), part.of(left), speed[left]
                spare = _Spare.of(part)
        put(s, bodies, own)
        return bodies, count

    def _change(self, s: Array, part: Problems, spare: "_Spare", change: Array) -> Array:
        """What one iteration changes s by."""
        w = _projected(s, part, spare)
        w *= 2
        w -= s
        _times(self.K, w, change)
        change -= np.multiply(s, RELAXATION / 2, out=w)
        return change


class _Spare(NamedTuple):
    """Arrays to work in."""

    w: Array  # (3, P, B)
    first: Array  # (3, P, B)
    second: Array  # (3, P, B)
    pairs: Array  # (4, P, B)
    all_due: bool
    tiny: float  # the least number that is not rounded to fewer digits

    @staticmethod
    def of(problems: Problems) -> "_Spare":
        """For some bodies."""
        dtype = problems.q.dtype
        w, first, second = np.empty((3, *problems.q.shape), dtype)
        pairs = np.empty((4, *problems.due.shape), dtype)
        return _Spare(w, first, second, pairs, bool(problems.due.all()), float(np.finfo(dtype).tiny))


def _groups(bodies: Array, matrix: Array) -> Iterator[Array]:
    """Bodies, so few at a time that arrays (3, P, B), in the precision of a matrix (3P, 3P), stay in the cache."""
    size = max(1, GROUP_BYTES // matrix[0].nbytes)
    for first in range(0, len(bodies), size):
        yield bodies[first : first + size]


def _times(matrix: Array, vectors: Array, out: Array) -> Array:
    """The product of a matrix (3P, 3P) with each of the vectors (3, P, B), contiguous as is `out`."""
    np.matmul(matrix, vectors.reshape(len(matrix), -1), out=out.reshape(len(matrix), -1))
    return out


def _projected(s: Array, problems: Problems, spare: _Spare) -> Array:
    """Π(s - q) (3, P, B), which the next call overwrites."""
    z, along = np.subtract(s, problems.q, out=spare.w), spare.second
    normal, tangential = factors_of_projection(z, problems, spare)
    z *= tangential
    z += np.multiply(problems.normals, normal, out=along)
    return z


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
    np.maximum(length, spare.tiny, out=length)  # round-off of a z along n: it sticks in any case
    np.sqrt(length, out=length)
    np.multiply(pressure, problems.friction, out=ratio)
    np.maximum(length, ratio, out=length)
    ratio /= length
    zn *= ratio
    pressure -= zn
    return pressure, ratio
