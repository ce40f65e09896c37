"""Frictional contact forces by an interior-point method for second-order cones.

With y = (λ, f_t/μ) and z = (u_n + μ|u_t|, μ u_t), both in Lorentz's cone, and y·z = 0, the problem is a second-order
cone program but for the term |z_t|, which the linearisation includes (Acary, Armand, Nguyen & Shpakovych, Optim.
Methods Softw. 37, 2022). The directions are those of Nesterov & Todd with Mehrotra's corrector. What W does not
determine ends far from the borders of the cones, where the next step finds it good.
"""

from collections.abc import Callable

import numpy as np

from fenics_rom.mechanics.complementarity.second_order_cone import (
    determinant,
    jordan_matrix,
    jordan_product,
    multiply,
    nesterov_todd_scaling,
    step_to_border,
)
from fenics_rom.mechanics.complementarity.solution import (
    FINISH_REDUCTION,
    FIRST_FINISH_RESIDUAL,
    INTERIOR_POINT_ACCURACY,
    INTERIOR_POINT_ITERATIONS,
    STEP_FRACTION,
    Array,
    centering,
)


def find_interior_point(
    W: Array, q: Array, normals: Array, friction: float, compliance: Array, finish: Callable[[Array], bool]
) -> tuple[Array, float, int, bool]:
    """Follows the central path.

    Args:
        W, q, normals, friction: as in `complementarity.solve`.
        compliance: (C, 1) of each pair by itself, m/s/N.
        finish: tries to get from forces (C, 3) to a solution; asked again as they come nearer.

    Returns:
        Forces (C, 3) within their cones, N; what they leave to solve, as a share of the velocities that they have to
        stop; the iterations; and whether `finish` came to a solution.
    """
    C, iterations = len(q), 0
    Q = _frames(normals) / np.sqrt(compliance)[:, :, None]  # f = Q y: every pair alike, whatever its mass
    Q[:, :, 1:] *= friction
    Qᵀ = Q.transpose(0, 2, 1)
    QᵀW = np.matmul(Qᵀ, W.reshape(C, 3, 3 * C)).reshape(3 * C, C, 3).transpose(1, 0, 2)
    M = np.matmul(QᵀW, Q).transpose(1, 0, 2).reshape(C, 3, 3 * C)
    p = multiply(Qᵀ, q)
    scale = float(np.abs(p).max())
    p /= scale
    y, z, diagonal = np.zeros((C, 3)), np.zeros((C, 3)), np.arange(C)
    y[:, 0] = z[:, 0] = 1.0
    finish_residual, error = FIRST_FINISH_RESIDUAL, np.inf
    for iterations in range(1, INTERIOR_POINT_ITERATIONS + 1):
        τ = float(y.ravel().dot(z.ravel())) / C
        v = np.matmul(M, y.ravel()) + p
        speed = np.sqrt(v[:, 1] ** 2 + v[:, 2] ** 2 + min(0.1 * τ, 1.0) ** 2)
        residual = v - z
        residual[:, 0] += speed
        error = max(float(np.abs(residual).max()), τ)
        within_bounds = INTERIOR_POINT_ACCURACY < error < 1 / INTERIOR_POINT_ACCURACY
        if not (within_bounds and min(determinant(y).min(), determinant(z).min()) > 0):
            break
        if error < finish_residual:
            finish_residual = error / FINISH_REDUCTION
            forces = scale * multiply(Q, y)
            if finish(forces):
                return forces, error, iterations, True
        B = M.copy()  # Δz = B Δy + residual
        B[:, 0] += (v[:, 1] / speed)[:, None] * M[:, 1] + (v[:, 2] / speed)[:, None] * M[:, 2]
        H, inverse, square = nesterov_todd_scaling(y, z)
        G = B.reshape(C, 3, C, 3).copy()
        G[diagonal, :, diagonal] += square
        scaled = multiply(H, y)
        arrow = jordan_matrix(scaled)
        target = -jordan_product(scaled, scaled)
        try:
            for is_corrector in (False, True):
                step = multiply(H, np.linalg.solve(arrow, target[:, :, None])[:, :, 0])
                Δy = np.linalg.solve(G.reshape(3 * C, 3 * C), (step - residual).ravel()).reshape(C, 3)
                Δz = np.matmul(B, Δy.ravel()) + residual
                α = min(step_to_border(y, Δy), step_to_border(z, Δz))
                if not is_corrector:
                    target -= jordan_product(multiply(H, Δy), multiply(inverse, Δz))
                    target[:, 0] += centering(α, τ)
        except np.linalg.LinAlgError:
            break
        y, z = y + STEP_FRACTION * α * Δy, z + STEP_FRACTION * α * Δz
    return scale * multiply(Q, y), error, iterations, False


def _frames(n: Array) -> Array:
    """Orthonormal (C, 3, 3), whose first columns are the unit vectors n."""
    t = np.cross(n, np.eye(3)[np.abs(n).argmin(axis=1)])
    t /= np.sqrt((t * t).dot(np.ones(3)))[:, None]
    return np.stack([n, t, np.cross(n, t)], axis=2)
