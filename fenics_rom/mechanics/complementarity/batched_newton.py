"""Contact forces of many bodies with few touching points each, of those whose Delassus operator they share: Newton's.

The pairs of a body that may push are put side by side in slots, so that all bodies have systems of one size. What is
solved is the law of `linearised`: with z = ρ f - u, p = Π(z)/ρ and d = z_t/|z_t|, t = n × d,

    a pair that sticks has u = 0; one that is open δ = 0; one that slips n·u = 0, t·u + c t·δ = 0, d·δ = μ n·δ,

with u = q + W (p + δ) and c = ρ (|z_t|/(μ z_n) - 1), and p + δ is the next f. Arrays have bodies first, then slots.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.complementarity.normals import written_out
from fenics_rom.mechanics.complementarity.problems import Problems

MOST_ITERATIONS = 15
SHARE = 0.4  # of each point's stiffness: 1/ρ
TOGETHER = 1 << 19  # numbers in the systems of bodies that go through an iteration together
STIFFEST = 1e12  # of ρ: c where there is no friction, or hardly any
_TINY = 1e-200


class _Slots(NamedTuple):
    """What is known of B bodies with K slots each."""

    q: Array  # (B, K, 3) m/s
    normals: Array  # (B, K, 3)
    due: Array  # (B, K) whether there is a pair in the slot
    friction: Array  # μ (B, 1)
    ρ: Array  # (B, K) m/s/N
    W: Array  # (B, K, 3, K, 3) m/s/N

    def of(self, bodies: Array) -> "_Slots":
        """Those of some of the bodies."""
        return _Slots(*(part[bodies] for part in self))


class BatchedNewton:
    """Newton's method for bodies that share a Delassus operator of P points.

    Args:
        W: (3P, 3P), symmetric and positive definite, m/s/N; rows are all x, then all y, then all z.
        tolerance: residual, as a share of the velocities that the forces have to stop.
    """

    def __init__(self, W: Array, tolerance: float):
        P, self._tolerance = len(W) // 3, tolerance
        self._blocks = np.ascontiguousarray(W.reshape(3, P, 3, P).transpose(1, 3, 0, 2))  # (P, P, 3, 3)
        self._ρ = np.einsum("ppaa->p", self._blocks) / 3 / SHARE

    def solve(self, problems: Problems, forces: Array, slots: int) -> tuple[Array, Array]:
        """Forces (3, P, B) in their cones, N, and which of the bodies did not settle.

        Args:
            problems: of B bodies, with at most so many pairs that may push.
            forces: (3, P, B) to begin with, N.
            slots: K.
        """
        B, normals = len(problems.friction), written_out(problems.normals, forces.shape)
        found, unsettled = np.zeros(forces.shape), np.zeros(B, bool)
        together = max(1, TOGETHER // (3 * slots) ** 2)
        for first in range(0, B, together):
            own = np.arange(first, min(first + together, B))
            due = problems.due[:, own] > 0
            points = np.argsort(~due, axis=0, kind="stable")[:slots].T  # (B, K)
            W = self._blocks[points[:, :, None], points[:, None]].transpose(0, 1, 3, 2, 4)
            at = points, own[:, None]
            q, n, f = (each[:, *at].transpose(1, 2, 0) for each in (problems.q, normals, forces))
            given = _Slots(q, n, problems.due[at] > 0, problems.friction[own, None], self._ρ[points], W)
            f, unsettled[own] = self._iterate(given, f)
            found[:, *at] = f.transpose(2, 0, 1)
        return found, unsettled

    def _iterate(self, given: _Slots, f: Array) -> tuple[Array, Array]:
        """Forces (B, K, 3), the best found, and which bodies did not settle."""
        best, goes_on, least = np.zeros(f.shape), np.arange(len(f)), np.full(len(f), np.inf)
        allowed = self._tolerance * np.abs(given.q).max(axis=(1, 2), initial=0.0, where=given.due[:, :, None])
        part = given
        for iteration in range(MOST_ITERATIONS + 1):
            ρ, n = part.ρ[:, :, None], part.normals
            z = ρ * f - part.q - _moved(part.W, f)
            zn = np.einsum("bka,bka->bk", z, n)
            zt = z - zn[:, :, None] * n
            length, cone = np.sqrt(np.einsum("bka,bka->bk", zt, zt)), part.friction * np.maximum(zn, 0.0)
            closed = part.due & (zn > 0)
            slips = closed & (length > cone)
            d = zt / np.maximum(length, _TINY)[:, :, None]
            tangential = np.where(slips, cone, length)[:, :, None] * d
            p = np.where(closed[:, :, None], zn[:, :, None] * n + tangential, 0.0) / ρ
            error = np.abs(ρ * (f - p)).max(axis=(1, 2))
            better = error < least[goes_on]
            best[goes_on[better]], least[goes_on[better]] = p[better], error[better]
            left = ~(error <= allowed[goes_on])
            if iteration == MOST_ITERATIONS or not left.any():
                goes_on = goes_on[left]
                break
            goes_on, part = goes_on[left], part.of(left)
            c = part.ρ * np.minimum(length[left] / np.maximum(cone[left], _TINY) - 1, STIFFEST)
            try:
                f = p[left] + _change(part, p[left], d[left], closed[left], slips[left], np.where(slips[left], c, 0.0))
            except np.linalg.LinAlgError:
                break
        unsettled = np.zeros(len(best), bool)
        unsettled[goes_on] = True
        return best, unsettled


def _moved(W: Array, f: Array) -> Array:
    """W f of (B, K, 3)."""
    B, K, _ = f.shape
    moved: Array = np.matmul(W.reshape(B, 3 * K, 3 * K), f.reshape(B, 3 * K, 1)).reshape(f.shape)
    return moved


def _change(given: _Slots, p: Array, d: Array, closed: Array, slips: Array, c: Array) -> Array:
    """δ (B, K, 3) of what sticks and slips."""
    n, ρ, μ, (B, K, _) = given.normals, given.ρ, given.friction, p.shape
    t = np.cross(n, d)
    sticks = (closed & ~slips)[:, :, None, None]
    square = (slips[:, :, None, None] * (_outer(n, n) + _outer(t, t))) + sticks * np.eye(3)
    open_ = (~closed * ρ)[:, :, None, None] * np.eye(3)
    along = ρ[:, :, None, None] * _outer(d, d - μ[:, :, None] * n) + c[:, :, None, None] * _outer(t, t)
    own = open_ + slips[:, :, None, None] * along
    M = np.matmul(square, given.W.reshape(B, K, 3, 3 * K)).reshape(B, K, 3, K, 3)
    M[:, np.arange(K), :, np.arange(K)] += own.transpose(1, 0, 2, 3)
    right = -np.matmul(square, (given.q + _moved(given.W, p))[..., None])
    δ: Array = np.linalg.solve(M.reshape(B, 3 * K, 3 * K), right.reshape(B, 3 * K, 1)).reshape(p.shape)
    return δ


def _outer(a: Array, b: Array) -> Array:
    """Of (B, K, 3) each."""
    return a[..., :, None] * b[..., None, :]
