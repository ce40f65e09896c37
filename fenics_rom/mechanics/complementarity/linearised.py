"""Coulomb's law of many pairs linearised: the forces with which pairs that are said to stick do so, and others slip on.

A pair that sticks has three unknown forces and u = 0. One that slips to d = z_t/|z_t| has, with p = n x d, the force
λ (n + μ d) + θ p, and n·u = 0, p·u + c θ = 0 with c = (|z_t|/(μ z_n) - 1)/ρ. Forces f that fulfil the law for some
velocities u have θ = 0, so that E y is added to them, with the columns n, d, p of what sticks and n + μ d, p of what
slips, and Tᵀ (u + W E y) + c θ = 0 with n, d, p and n, p in place of these.
"""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.complementarity.delassus import FramedDelassus

LEAST_SINGULAR = 1e-13  # of the largest singular value, of what counts as determined


def least_solution(matrix: Array, right: Array) -> Array:
    """x of matrix x = right, without what the matrix does not determine."""
    solution: Array = np.linalg.lstsq(matrix, right, rcond=LEAST_SINGULAR)[0]
    return solution


def linearised(
    operator: FramedDelassus,
    friction: float,
    compliance: Array,
    z: Array,
    length: Array,
    cone: Array,
    proximal: float = 0.0,
) -> "Linearisation | LinearisationByVelocities":
    """The law by its forces, or by velocities where these are fewer unknowns; arguments as in Linearisation."""
    few = np.count_nonzero(length > cone) < np.count_nonzero(cone)  # slip or are open, than are closed
    if few and operator.is_regular:
        return LinearisationByVelocities(operator.inverse, friction, compliance, z, length, cone)
    return Linearisation(operator.matrix, friction, compliance, z, length, cone, proximal)


class Linearisation:
    """The law of C pairs at z = f - ρ u, in frames of their normals.

    Args:
        W: Delassus operator (3C, 3C).
        friction: μ.
        compliance: (C,) 1/ρ of each pair, m/s/N.
        z: (3, C), N.
        length: |z_t| (C,), N.
        cone: μ z_n (C,), N; 0 where a pair is open.
        proximal: compliance that is added to what is solved for, in parts of that of each pair.
    """

    def __init__(
        self, W: Array, friction: float, compliance: Array, z: Array, length: Array, cone: Array, proximal: float = 0.0
    ):
        self._size = C = len(length)
        closed = cone > 0
        slips = closed & (length > cone)
        self._unknowns = np.concatenate([closed, closed > slips, closed]).nonzero()[0]
        self._frame: tuple[Array, Array, Array] | None = None  # cos, sin and μ of what slips; 1, 0 and 0 of what sticks
        added = np.zeros((3, C))
        if slips.any():
            self._frame = cos, sin, μ = np.ones(C), np.zeros(C), friction * slips
            np.divide(z[1], length, out=cos, where=slips)
            np.divide(z[2], length, out=sin, where=slips)
            np.divide(length, cone, out=added[2], where=slips)
            added[2] -= slips
            added[2] *= compliance
            along, across = _turned(W[:, C : 2 * C], W[:, 2 * C :], cos, sin)
            W = np.concatenate([W[:, :C] + μ * along, along, across], axis=1)
            W[C : 2 * C], W[2 * C :] = _turned(W[C : 2 * C], W[2 * C :], cos[:, None], sin[:, None])
        if proximal:
            added += proximal * compliance
        self._G = W.take(self._unknowns, axis=0).take(self._unknowns, axis=1)
        self._G.ravel()[:: len(self._G) + 1] += added.ravel()[self._unknowns]

    def change(self, u: Array) -> Array:
        """What to add to forces (3, C), N, that fulfil the law for some velocities, where they cause u (3, C), m/s.

        Raises:
            LinAlgError: there is nothing.
        """
        if self._frame is not None:
            cos, sin, _ = self._frame
            u = np.array([u[0], *_turned(u[1], u[2], cos, sin)])
        y = np.zeros(u.shape)
        y.ravel()[self._unknowns] = np.linalg.solve(self._G, -u.ravel()[self._unknowns])
        return self._forces(y)

    def pull_back(self, φ: Array, is_regular: bool) -> Array:
        """Derivatives (3, C) with velocities, s/m, from those with the forces, φ (3, C), 1/N: `change` transposed.

        Of forces that W, where it is not regular, does not determine φ knows nothing, and nothing is made of them.
        """
        if self._frame is not None:
            cos, sin, μ = self._frame
            φ = np.array([φ[0], *_turned(φ[1], φ[2], cos, sin)])
            φ[0] += μ * φ[1]
        ψ, asked = np.zeros(φ.shape), φ.ravel()[self._unknowns]
        solved = np.linalg.solve(self._G.T, asked) if is_regular else least_solution(self._G.T, asked)
        ψ.ravel()[self._unknowns] = -solved
        if self._frame is not None:
            ψ[1], ψ[2] = _turned(ψ[1], ψ[2], cos, -sin)
        return ψ

    def inverse(self) -> Array:
        """The matrix (3C, 3C), N s/m, by which `change` multiplies velocities.

        Raises:
            LinAlgError: there is none.
        """
        C = self._size
        y = np.zeros((3 * C, 3 * C))
        y[self._unknowns[:, None], self._unknowns] = -np.linalg.inv(self._G)
        if self._frame is not None:
            cos, sin, _ = self._frame
            y[:, C : 2 * C], y[:, 2 * C :] = _turned(y[:, C : 2 * C], y[:, 2 * C :], cos, -sin)
        return self._forces(y.reshape(3, C, 3 * C)).reshape(y.shape)

    def _forces(self, y: Array) -> Array:
        """E y (3, C) or, of as many columns, (3, C, k); y is overwritten."""
        if self._frame is not None:
            cos, sin, μ = self._frame if y.ndim == 2 else (part[:, None] for part in self._frame)
            y[1] += μ * y[0]
            y[1], y[2] = _turned(y[1], y[2], cos, -sin)
        return y


class LinearisationByVelocities:
    """The same with the velocities of pairs that slip or are open as unknowns; methods as those of Linearisation.

    Args:
        inverse: W⁻¹ (3C, 3C), N s/m.
        friction, compliance, z, length, cone: as in Linearisation.
    """

    def __init__(self, inverse: Array, friction: float, compliance: Array, z: Array, length: Array, cone: Array):
        C, closed = len(length), cone > 0
        slips, opened = (closed & (length > cone)).nonzero()[0], (~closed).nonzero()[0]
        self._inverse, S = inverse, len(slips)
        self._unknowns = np.concatenate((C + slips, 2 * C + slips, opened, C + opened, 2 * C + opened))
        length, cone, cos, sin = np.array((length, cone, z[1], z[2])).take(slips, axis=1)[:, :, None]
        cos, sin, c = cos / length, sin / length, (length / cone - 1) * compliance.take(slips)[:, None]
        self._rows = rows = inverse.take(self._unknowns, axis=0)  # of conditions on δ
        along, across = _turned(rows[:S], rows[S : 2 * S], cos, sin)
        rows[:S], rows[S : 2 * S] = along - friction * inverse.take(slips, axis=0), c * across
        self._H = H = rows.take(self._unknowns, axis=1)
        H.ravel()[S * len(H) :: len(H) + 1][:S] -= sin[:, 0]
        H.ravel()[S * len(H) + S :: len(H) + 1][:S] += cos[:, 0]

    def change(self, u: Array) -> Array:
        """As in Linearisation."""
        v = u.ravel()
        w = -v
        w[self._unknowns] += np.linalg.solve(self._H, self._rows.dot(v))
        changed: Array = self._inverse.dot(w)
        return changed.reshape(u.shape)

    def inverse(self) -> Array:
        """As in Linearisation."""
        spread: Array = self._inverse.take(self._unknowns, axis=1).dot(np.linalg.solve(self._H, self._rows))
        spread -= self._inverse
        return spread


def _turned(first: Array, second: Array, cos: Array, sin: Array) -> tuple[Array, Array]:
    """Two components in axes that are turned by an angle."""
    return cos * first + sin * second, cos * second - sin * first
