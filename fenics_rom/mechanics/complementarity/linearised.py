"""Coulomb's law of many pairs linearised: the forces with which pairs that are said to stick do so, and others slip on.

A pair that sticks has three unknown forces and u = 0. One that slips to d = z_t/|z_t| has, with p = n x d, the force
λ (n + μ d) + θ p, and n·u = 0, p·u + c θ = 0 with c = (|z_t|/(μ z_n) - 1)/ρ. So what moves has u = s d - c θ p, and for
its force (d - μ n)·f = 0.

Where the inverse of W is kept, the unknowns are s and -c θ of what slips: what sticks costs but a product.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

_XYZ, _NEXT, _LAST = np.arange(3), np.array([1, 2, 0]), np.array([2, 0, 1])
_OPEN, _STICK, _SLIP = 0, 1, 2


class Linearisation(NamedTuple):
    """The law at forces f, as z = f - ρ u has it."""

    f: Array  # (C, 3), N
    u: Array  # (C, 3) with them, m/s
    closed: Array  # (C,) pairs with z_n > 0
    slides: Array  # (C,) those with |z_t| > μ z_n, and some that are not closed
    tangential: Array  # z_t (C, 3), N
    length: Array  # |z_t| (C,), N
    cone: Array  # μ z_n (C,), N; 0 where it is not closed

    def directions(self, pairs: Array, normals: Array) -> tuple[Array, Array, Array]:
        """n, d and p (b, 3) of pairs that slip."""
        n, d = normals[pairs], self.tangential[pairs] / self.length[pairs, None]
        return n, d, n[:, _NEXT] * d[:, _LAST] - n[:, _LAST] * d[:, _NEXT]

    def sideways_compliance(self, pairs: Array, compliance: Array) -> Array:
        """c (b,) of pairs that slip, m/s/N."""
        c: Array = (self.length[pairs] / self.cone[pairs] - 1) * compliance[pairs]
        return c

    def solved(self, W: Array, q: Array, normals: Array, friction: float, compliance: Array, proximal: float) -> Array:
        """Its forces (C, 3), with a proximal compliance in parts of that of each pair.

        Raises:
            LinAlgError: there are none.
        """
        f, C = self.f, len(self.f)
        layout = _lay_out((self.closed * (_STICK + self.slides.view(np.int8))).tobytes())
        if not layout.unknowns:
            return np.zeros_like(f)
        added_compliance = proximal * compliance[layout.pairs]
        if layout.unknowns == 3 * C:  # everything sticks: E = T = I
            G = W.copy()
            G.ravel()[:: len(G) + 1] += added_compliance
            return f - np.linalg.solve(G, self.u.ravel()).reshape(f.shape)
        E = np.zeros((3 * C, layout.unknowns))
        E.ravel()[layout.stick_entries] = 1.0
        slip = layout.slip
        if len(slip):
            T = E.copy()
            n, d, p = self.directions(slip, normals)
            basis = np.empty((len(slip), 3, 2))
            basis[:, :, 0], basis[:, :, 1] = n, p
            T.ravel()[layout.slip_entries] = basis
            start = T.T.dot(f.ravel())
            basis[:, :, 0] += friction * d
            E.ravel()[layout.slip_entries] = basis
            c = self.sideways_compliance(slip, compliance)
        else:
            T, start = E, E.T.dot(f.ravel())
        WE = W.dot(E)
        residual = T.T.dot(WE.dot(start) + q.ravel())
        if len(slip):
            added_compliance[layout.sideways] += c
            residual[layout.sideways] += c * start[layout.sideways]
        G = T.T.dot(WE)
        G.ravel()[:: layout.unknowns + 1] += added_compliance
        return E.dot(start - np.linalg.solve(G, residual)).reshape(f.shape)

    def solved_with(
        self, inverse: Array, W: Array, q: Array, normals: Array, friction: float, compliance: Array
    ) -> Array:
        """Its forces (C, 3), with the inverse (3A, 3A) of W of the closed pairs, N s/m.

        Raises:
            LinAlgError: there are none.
        """
        f, u, pairs = self.f, self.u, None
        if f.size > len(inverse):  # what opens has no force any more
            pairs = np.flatnonzero(self.closed)
            f = f * self.closed[:, None]
            u = W.dot(f.ravel()).reshape(f.shape) + q
            f, u = f[pairs], u[pairs]
        moved = f.ravel() - inverse.dot(u.ravel())
        slip = np.flatnonzero(self.closed & self.slides)
        b = 2 * len(slip)
        if b:
            n, d, p = self.directions(slip, normals)
            motion, conditions = np.zeros((2, len(inverse), b))
            entries = _slip_entries((slip if pairs is None else np.searchsorted(pairs, slip)).tobytes())
            basis = np.empty((len(slip), 3, 2))
            basis[:, :, 0], basis[:, :, 1] = d, p
            motion.ravel()[entries] = basis
            basis[:, :, 0] -= friction * n
            basis[:, :, 1] *= self.sideways_compliance(slip, compliance)[:, None]
            conditions.ravel()[entries] = basis
            spread = inverse.dot(motion)
            G = conditions.T.dot(spread)
            G.ravel()[b + 1 :: 2 * (b + 1)] += 1.0
            moved -= spread.dot(np.linalg.solve(G, conditions.T.dot(moved)))
        if pairs is None:
            return moved.reshape(self.f.shape)
        forces = np.zeros_like(self.f)
        forces[pairs] = moved.reshape(-1, 3)
        return forces


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


@lru_cache(maxsize=256)
def _slip_entries(pairs: bytes) -> Array:
    """Of the directions of b pairs in a matrix of 2b columns, flattened, (b, 3, 2)."""
    slip = np.frombuffer(pairs, np.intp)
    columns = np.arange(2 * len(slip)).reshape(-1, 1, 2)
    entries: Array = (3 * slip[:, None, None] + _XYZ[:, None]) * (2 * len(slip)) + columns
    return entries
