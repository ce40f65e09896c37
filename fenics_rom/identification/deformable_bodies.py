"""Steps and equilibria of bodies that deform largely, on one basis.

Their materials and dampings differ little. Steps are those of the midpoint rule with a potential
(`runtime.steppers.held`), for all bodies at once: their differences are derivatives.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SolverError
from fenics_rom.identification.affine import AffineDecomposition, lame_parameters
from fenics_rom.identification.parameters import BETA
from fenics_rom.mechanics.hyperelastic import strain
from fenics_rom.mechanics.point_material import PointMaterial
from fenics_rom.mechanics.voigt import VOIGT_INDEX
from fenics_rom.rom.deformation import ReducedDeformation
from fenics_rom.runtime.steppers.held import FAST_CONTRACTION, MAX_ITERATIONS, is_solved


class DeformablePoints(NamedTuple):
    """What the moduli at the P points of a basis are made of."""

    material: Array  # (P,) number of the material at each point
    dilation: Array  # (P,) share of λ that each point has: with selective integration 1 in the middle of cells alone
    shear: Array  # (P,) and of μ


class DeformableBodies:
    """B bodies of one basis and its points, at values θ that differ little; arrays have the bodies last.

    The first one's tangent serves all.

    Args:
        parts: of the matrices on the basis.
        body: of the values where the basis was made.
        points: its points.
        values: θ of each body.
    """

    def __init__(
        self, parts: AffineDecomposition, body: ReducedDeformation, points: DeformablePoints, values: Sequence[Array]
    ):
        P, ω = points.material, body.weights[:, None]
        λ, μ = (np.stack(each, axis=1)[P] for each in zip(*(lame_parameters(θ) for θ in values), strict=True))
        β = np.stack([θ[:-1, BETA] for θ in values], axis=1)[P]
        λ, μ = points.dilation[:, None] * λ, points.shear[:, None] * μ
        self._material, self._β = PointMaterial(body.law, (ω * λ).ravel(), (ω * μ).ravel()), β.ravel()
        first = {"first_lame": λ[:, 0], "shear": μ[:, 0], "viscosity": β[:, 0]}
        self._body = replace(body, external_damping=parts.external_damping(values[0]), **first)
        self._mass = np.stack([parts.mass_at(θ) for θ in values])
        self._damping = np.stack([parts.external_damping(θ) for θ in values])
        self._springs = parts.springs
        self._rows = body.gradients.reshape(-1, body.order)

    def run(self, forces: Array, q: Array, r: Array, h: float) -> Array:
        """q at all step ends, (steps + 1, m, B), from q and velocities r (m, B) on, under forces (steps, m, B).

        Raises:
            SolverError: a step was not solved.
        """
        states, E = np.empty((len(forces) + 1, *q.shape)), strain(self._gradients(q))
        states[0], rate = q, r
        inverse: Array | None = None
        for n, force in enumerate(forces):
            v, E, inverse = self._step(q, r, E, force, h, 2 * r - rate, inverse)
            q, r, rate = q + h * v, 2 * v - r, v
            states[n + 1] = q
        return states

    def _step(
        self, q: Array, r: Array, E: Array, force: Array, h: float, v: Array, inverse: Array | None
    ) -> tuple[Array, Array, Array | None]:
        """Mid-step velocities v̂ (m, B), from a guess; the strains at the end, and the inverse tangent for the next."""
        before, fresh = np.inf, False
        for _ in range(MAX_ITERATIONS):
            middle = q + h / 2 * v
            H, after = self._gradients(middle), strain(self._gradients(q + h * v))
            material, rates = self._material, (after - E) / h
            S = material.discrete_gradient_stress(E, after)
            S += self._β * material.viscous_stress((E + after) / 2, rates, material.linear_stress(rates))
            parts = (
                2 / h * _times(self._mass, v - r),
                _times(self._damping, v),
                self._resultant(H, S) + self._springs @ middle,
                -force,
            )
            residual = sum(parts)
            scale = max(np.abs(part).max() for part in (2 / h * _times(self._mass, r), *parts))
            if not np.isfinite(scale):
                break
            error = np.abs(residual).max()
            if is_solved(error, before, scale):
                return v, after, inverse
            if inverse is None or (error > FAST_CONTRACTION * before and not fresh):
                inverse, fresh = self._inverse(H, (E + after) / 2, S, h), True
            else:
                fresh = False
            before = error
            v = v - inverse @ residual
        raise SolverError(
            f"the reduced model has no step of {h:g} s where the fit came by; use start values that are "
            "closer, or a smaller run.dt"
        )

    def _inverse(self, H: Array, E: Array, S: Array, h: float) -> Array:
        """Of the first body's 2/h M + D + h/2 ∂f/∂q, (m, m)."""
        body, first = self._body, slice(None, None, self._mass.shape[0])
        H, E, S = H[..., first], E[:, first], S[:, first]
        A, material = body.strain_rates(H), body.material
        C = h / 2 * material.moduli(E) + body.viscosity * material.viscous_slopes(E, 0 * E)[0]
        CA = np.einsum("cdp,dpk->cpk", body.weights * C, A).reshape(-1, body.order)
        K = A.reshape(-1, body.order).T @ CA + h / 2 * (body.geometric(S) + self._springs)
        return np.linalg.inv(2 / h * self._mass[0] + self._damping[0] + K)

    def equilibrium(self, forces: Array, guess: Array) -> Array:
        """q (m, B) under forces (m, B), from a guess (m,) on.

        Raises:
            SolverError: none was found.
        """
        q, before = np.repeat(guess[:, None], forces.shape[1], axis=1), np.inf
        for _ in range(MAX_ITERATIONS):
            H = self._gradients(q)
            elastic = self._resultant(H, self._material.stress(strain(H))) + self._springs @ q
            residual, scale = elastic - forces, max(np.abs(elastic).max(), np.abs(forces).max())
            if not np.isfinite(scale):
                break
            error = np.abs(residual).max()
            if error == 0 or is_solved(error, before, scale):
                return q
            before, q = error, q - np.linalg.solve(self._body.tangent(q[:, 0]), residual)
        raise SolverError(
            "the reduced model has no equilibrium where the fit came by; use start values that are closer"
        )

    def _gradients(self, q: Array) -> Array:
        """H (3, 3, P B) at q (m, B)."""
        return (self._rows @ q).reshape(3, 3, -1)

    def _resultant(self, H: Array, S: Array) -> Array:
        """Forces (m, B) of stresses S (6, P B), which hold the weights, on bodies deformed by H: Σ (F S) : ∇W_k."""
        FS = np.einsum("ikp,kjp->ijp", H + np.eye(3)[:, :, None], S[VOIGT_INDEX])
        return self._rows.T @ FS.reshape(len(self._rows), -1)


def _times(matrices: Array, columns: Array) -> Array:
    """Products (m, B) of matrices (B, m, m) with columns (m, B), each with its own."""
    return np.einsum("bij,jb->ib", matrices, columns)
