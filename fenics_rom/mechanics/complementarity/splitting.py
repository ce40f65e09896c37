"""Contact forces of many bodies that share a Delassus operator: Douglas and Rachford's splitting (ADMM).

With velocities y = ρ f in place of forces, and Alart and Curnier's Π of a pair (see `frictional`), what is searched for
is a fixed point z = ρ f - u of

    z ← z + α (N (2 Π(z) - z - q) - Π(z)),    N = ρ (W + ρ)⁻¹,    f = Π(z)/ρ,    u = Π(z) - z.

N is inverted once; an iteration is one product for all bodies and some twenty elementwise operations. Every point has a
ρ of its own, some share of how far it yields by itself, as points at a rim yield further than others: that takes half
of the condition of W away. √(λmin λmax) of what is left would be the share where as many pairs are open as stick, with
which it settles in some 16 iterations where W has a condition of a few hundred; less of it is better where most stick.
That W has a condition at all is owed to the residual compliance. After every two iterations z goes as far again along
the second change g₂ as g₂ - g₁ tells: Anderson's extrapolation, of which two changes are enough.

What all points moved at is tried first. Forces under which they move at u are W⁻¹ (u - q): where all pairs stick, as
they did, these are the solution. All others are iterated in single precision, as far as it goes, and once more go on
with the velocities found, from which forces are those of double precision. Few have to be iterated in that. What then
does not settle, and bodies with few pairs, are for Newton's method (`batched_newton`).

Arrays hold bodies along their last axis and axes x, y, z along their first, as the elementwise operations want them.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.body_axis import in_one_piece, put, taken
from fenics_rom.mechanics.complementarity.batched_newton import BatchedNewton
from fenics_rom.mechanics.complementarity.normals import NORMAL
from fenics_rom.mechanics.complementarity.problems import Problems

RELAXATION = 1.4  # α
STICKING = 0.6  # times ρ that is best if any pair may do anything: that for pairs of which most stick
TOLERANCE = 4e-7  # residual, as a share of the velocities that the forces have to stop
FLOOR = 1e-3  # of λmax, that λmin is taken to be at least
MOST_ITERATIONS = 80
ROUND_OFF = 0.7  # times that of single precision: changes at which iterations in it stop
LEAVES_AT = 0.75  # of the bodies: when so few go on, the others are taken out of the arrays
POINTS_AT = 12  # from so many on, it is found how few of them move while all others stick,
MOVING_AT = 0.25  # if these are no more than such a share of them
RARE = 0.04  # of the bodies: points that move in fewer are not among them
FEW = 8  # bodies that points have to move in at least; pairs that Newton's method is faster for,
FEW_AT = 0.4  # if these are no more than such a share of the points


class Splitting:
    """A Delassus operator of P points that many bodies share.

    Args:
        W: (3P, 3P), symmetric and positive definite, m/s/N; rows are all x, then all y, then all z.

    Attributes:
        W: as given.
        ρ: of each point (P, 1), m/s/N.
    """

    def __init__(self, W: Array):
        self.W, P = W, len(W) // 3
        own = np.einsum("apap->p", W.reshape(3, P, 3, P))
        scale = np.tile(1 / np.sqrt(own), 3)
        λ = np.linalg.eigvalsh(scale[:, None] * W * scale)
        λ = np.maximum(λ, FLOOR * λ[-1])
        share, root = STICKING * np.sqrt(λ[0] * λ[-1]), np.sqrt(λ[-1] / λ[0])
        self.ρ = share * own[:, None]
        ρ = np.tile(self.ρ, (3, 1))
        self._stiffness = ρ * np.linalg.inv(W)
        self._moving: _Moving | None = None
        self._newton = BatchedNewton(W, TOLERANCE)
        # What an iteration changes bounds the residual by this; it contracts in a metric in which points differ as much
        # as they yield. z may be longer than velocities by the root, and has its own round-off.
        stop = RELAXATION * TOLERANCE * 2 * min(share / (λ[-1] + share), λ[0] / (λ[0] + share))
        stop *= np.sqrt(own.min() / own.max())
        coarse = ROUND_OFF * float(np.finfo(np.float32).eps) * root
        N = np.linalg.inv(W / ρ.T + np.identity(3 * P))
        self._coarse, self._fine = _Iteration((2 * N).astype(np.float32), coarse), _Iteration(2 * N, stop)

    def solve(self, problems: Problems, forces: Array, u: Array) -> Array:
        """Finds forces, exactly in their cones, and the velocities under them; bodies that did not settle.

        Args:
            problems: of the bodies.
            forces: (3, P, B) of the last step, N; made those of this one.
            u: (3, P, B) in the last step, m/s; made those in this one.
        """
        left = self.look(problems, forces, u)
        if not len(left):
            return left
        begun = taken(forces, left), taken(u, left)
        unsettled = self.search(problems.of(left), *begun)
        for part, found in zip((forces, u), begun, strict=True):
            put(part, left, found)
        return left[unsettled]

    def look(self, problems: Problems, forces: Array, u: Array) -> Array:
        """As `solve`, for bodies whose points move as they did, or of which few do anything but stick."""
        few, done = self._is_few(problems), np.zeros(u.shape[-1], bool)
        bodies = (~few).nonzero()[0]
        if self._moving is not None:
            done[self._move(self._moving, problems, forces, u, bodies)] = True
        left = self._go_on(problems, forces, u, bodies)
        if len(left) > max(RARE * len(few), FEW):
            self._learn_moving(u, left)
            if self._moving is not None:
                own = self._move(self._moving, problems, forces, u, left[~done[left]])
                left = np.concatenate([np.setdiff1d(left, own), self._go_on(problems, forces, u, own)])
        return np.concatenate([few.nonzero()[0], left])

    def search(self, problems: Problems, forces: Array, u: Array) -> Array:
        """As `solve`, from forces and velocities as a look leaves them."""
        few = self._is_few(problems)
        many = (~few).nonzero()[0]
        self._iterate(self._coarse, problems, forces, u, many)
        unsettled, failed = self._iterate(self._fine, problems, forces, u, self._go_on(problems, forces, u, many)), []
        for bodies in (few.nonzero()[0], unsettled):
            if not len(bodies):
                continue
            part = problems.of(bodies)
            slots = max(1, int(part.due.sum(axis=0).max()))
            begun = _projected(self.ρ * taken(forces, bodies) - taken(u, bodies), part) / self.ρ
            found, left = self._newton.solve(part, begun, slots)
            put(forces, bodies, found)
            put(u, bodies, part.q + self.moved(found))
            failed.append(bodies[left])
        return np.concatenate(failed) if failed else unsettled

    def moved(self, forces: Array) -> Array:
        """W f (3, P, B), m/s."""
        return _times(self.W, forces, np.empty_like(forces))

    def _is_few(self, problems: Problems) -> Array:
        """Bodies (B,) with so few pairs that Newton's method is faster."""
        return problems.due.sum(axis=0) <= min(FEW, FEW_AT * len(problems.due))

    def _go_on(self, problems: Problems, forces: Array, u: Array, bodies: Array) -> Array:
        """Has the points of these bodies move at u; those that this does not settle. It finds forces and another u."""
        if not len(bodies):
            return bodies
        places = in_one_piece(bodies)
        part, velocity = problems.of(places), taken(u, places)
        spare = _Spare.of(part)
        change = np.subtract(velocity, part.q, out=spare.second)
        own = _times(self._stiffness, change, spare.first)  # ρ f
        own -= velocity
        found = _projected(own, part, spare)
        now = np.subtract(found, own, out=spare.second)
        off = np.subtract(now, velocity, out=spare.product)
        left = bodies[_largest(off, off) > TOLERANCE * part.scale]
        put(u, places, now)
        put(forces, places, np.divide(found, self.ρ, out=found))
        return left

    def _learn_moving(self, u: Array, bodies: Array) -> None:
        """Learns which few points move of bodies that did not settle, the same in most, unless they are known."""
        P, moving = len(u[0]), (taken(u, bodies) != 0).any(axis=0)
        often = np.count_nonzero(moving, axis=1) > max(RARE * u.shape[-1], FEW)
        if self._moving is not None:
            if not often[self._moving.sticks].any():
                return
            if np.count_nonzero(often | ~self._moving.sticks) <= MOVING_AT * P:
                often |= ~self._moving.sticks
        if 0 < np.count_nonzero(often) <= MOVING_AT * P and P >= POINTS_AT:
            self._moving = _Moving.of(often, self._stiffness / np.tile(self.ρ, (3, 1)))

    def _move(self, few: "_Moving", problems: Problems, forces: Array, u: Array, bodies: Array) -> Array:
        """Has the few points of these bodies move as they do while all others stick; bodies that it is found for."""
        points, sticks, sees, law = few
        own = bodies[(u[:, points] != 0).any(axis=(0, 1))[bodies]]
        own = own[~(taken(u, own) != 0).any(axis=0)[sticks].any(axis=0)]
        if not len(own):
            return own
        part = problems.of(own)
        q = (sees @ part.q.reshape(len(sees[0]), -1)).reshape(3, len(points), -1)
        normals = None if part.normals is None else part.normals.take(points, axis=1)
        places = np.ix_(np.arange(3), points, own)
        velocities = u[places]
        law.solve(Problems(q, normals, part.due[points], part.friction, part.scale), forces[places], velocities)
        u[places] = velocities
        return own

    def _iterate(self, iteration: "_Iteration", problems: Problems, forces: Array, u: Array, bodies: Array) -> Array:
        """Iterates forces and velocities (3, P, B) of these bodies; those that did not settle."""
        if not len(bodies):
            return bodies
        places, dtype = in_one_piece(bodies), iteration.N2.dtype
        part = problems.of(places).astype(dtype)
        z = (self.ρ * taken(forces, places) - taken(u, places)).astype(dtype, copy=False)
        left = iteration.run(part, z)
        found = _projected(z, part)
        put(u, places, found - z)
        put(forces, places, found / self.ρ)
        return bodies[left]


class _Moving(NamedTuple):
    """Points that move, and their law while all others stick."""

    points: Array  # (M,)
    sticks: Array  # (P,) whether a point is none of them
    sees: Array  # (3M, 3P) what makes their velocities if only the others push of those of all without contact
    law: "Splitting"

    @staticmethod
    def of(moves: Array, stiffness: Array) -> "_Moving":
        """Of points that are told (P,), and the inverse (3P, 3P) of W."""
        own = np.tile(moves, 3)
        W = np.linalg.inv(stiffness[np.ix_(own, own)])
        return _Moving(moves.nonzero()[0], ~moves, W @ stiffness[own], Splitting((W + W.T) / 2))


class _Iteration(NamedTuple):
    """Of z, in one precision."""

    N2: Array  # 2 N, (3P, 3P)
    stop: float  # at changes that are so small a share of the velocities

    def run(self, problems: Problems, z: Array) -> Array:
        """Iterates z (3, P, B), contiguous; the bodies that did not settle."""
        bodies, part, own, half = np.arange(z.shape[-1]), problems, z, RELAXATION / 2
        spare, still, left = _Spare.of(part), self.stop / half * part.scale, bodies
        for _ in range(0, MOST_ITERATIONS, 2):
            first, second = spare.first, spare.second
            for change in (first, second):
                twice = _projected(own, part, spare, times=2)
                direction = np.subtract(twice, own, out=change)
                direction -= part.q
                np.subtract(_times(self.N2, direction, spare.product), twice, out=change)  # 2/α of it
                own += np.multiply(change, half, out=twice)
            first -= second
            share = np.einsum("apb,apb->b", first, second)
            share /= np.maximum(np.einsum("apb,apb->b", first, first), spare.tiny)
            share *= half
            own += np.multiply(second, share, out=first)
            goes_on = _largest(second, second) > still
            left = goes_on.nonzero()[0]
            if not len(left):
                break
            if len(left) <= LEAVES_AT * len(bodies):
                settled = (~goes_on).nonzero()[0]
                put(z, bodies[settled], taken(own, settled))
                bodies, own, part, still = bodies[left], taken(own, left), part.of(left), still[left]
                spare, left = _Spare.of(part), np.arange(len(left))
        if own is not z:
            put(z, bodies, own)
        return bodies[left]


class _Spare(NamedTuple):
    """Arrays to work in."""

    w: Array  # (3, P, B)
    first: Array  # (3, P, B)
    second: Array  # (3, P, B)
    product: Array  # (3, P, B)
    pairs: Array  # (4, P, B)
    none: Array  # (P, B) zeros: NumPy finds the larger of two arrays in a third of the time of one and a number
    all_due: bool
    tiny: float  # the least number that is not rounded to fewer digits

    @staticmethod
    def of(problems: Problems) -> "_Spare":
        """For some bodies."""
        dtype = problems.q.dtype
        w, first, second, product = np.empty((4, *problems.q.shape), dtype)
        pairs, none = np.empty((4, *problems.due.shape), dtype), np.zeros(problems.due.shape, dtype)
        all_due = bool(problems.due.min(initial=1.0) == 1)
        return _Spare(w, first, second, product, pairs, none, all_due, float(np.finfo(dtype).tiny))


def _times(matrix: Array, vectors: Array, out: Array) -> Array:
    """The product of a matrix (3P, 3P) with each of the vectors (3, P, B), contiguous as is `out`."""
    np.matmul(matrix, vectors.reshape(len(matrix), -1), out=out.reshape(len(matrix), -1))
    return out


def _largest(vectors: Array, spare: Array) -> Array:
    """The largest of the numbers (3, P, B) of each body, (B,); the spare array may be the vectors'."""
    largest: Array = np.abs(vectors, out=spare).max(axis=(0, 1))
    return largest


def _projected(z: Array, problems: Problems, spare: _Spare | None = None, times: int = 1) -> Array:
    """Π(z) (3, P, B), so many times, which the next call overwrites.

    Π(z) = z_n⁺ n + min(1, μ z_n⁺/|z_t|) z_t, and 0 where a pair is not due; z_t is z - z_n n.
    """
    spare = spare or _Spare.of(problems)
    zn, length, pressure, ratio = spare.pairs
    w, normals = spare.w, problems.normals
    if normals is None:
        (first, second), zn, pressure = z[:NORMAL], z[NORMAL], w[NORMAL]
        np.multiply(first, first, out=length)
        length += np.multiply(second, second, out=ratio)
    else:
        np.einsum("apb,apb->pb", z, normals, out=zn)
        np.einsum("apb,apb->pb", z, z, out=length)
        length -= np.multiply(zn, zn, out=ratio)
        np.maximum(length, spare.none, out=length)  # round-off of a z along n: it sticks in any case
    np.maximum(zn, spare.none, out=pressure)
    if not spare.all_due:
        pressure *= problems.due
    length += spare.tiny
    np.sqrt(length, out=length)
    np.multiply(pressure, problems.friction, out=ratio)
    np.maximum(length, ratio, out=length)
    ratio /= length
    if times != 1:
        ratio *= times
        pressure *= times
    if normals is None:
        np.multiply(z[:NORMAL], ratio, out=w[:NORMAL])
        return w
    pressure -= np.multiply(zn, ratio, out=zn)
    np.multiply(z, ratio, out=w)
    w += np.multiply(normals, pressure, out=spare.product)
    return w
