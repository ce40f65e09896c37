"""Frictional contact forces by an interior-point method for second-order cones.

With y = (λ, f_t/μ) and z = (u_n + μ|u_t|, μ u_t), both in Lorentz's cone, and y·z = 0, the problem is a second-order
cone program but for the term |z_t|, which the linearisation includes (Acary, Armand, Nguyen & Shpakovych, Optim.
Methods Softw. 37, 2022). The directions are those of Nesterov & Todd with Mehrotra's corrector. What W does not
determine ends far from the borders of the cones, where the next step finds it good. The algebra of the cones
y₀ >= |y_t| is Jordan's (Alizadeh & Goldfarb, Math. Program. 95, 2003), for many vectors (C, 3) at once.
"""

from collections.abc import Callable

import numpy as np
from numpy import ndarray as Array

ITERATIONS = 40  # where they suffice they are rarely more than fifteen
ACCURACY = 1e-14  # no interior-point method gets further
FIRST_FINISH_RESIDUAL = 1e-3  # from here on Newton's method may finish, and
FINISH_REDUCTION = 100  # tries again each time the residual has fallen by this factor
STEP_FRACTION = 0.9  # of the way to the border of the cones
# y₀ and z₀ to begin with, one after the other: of 6,000 random problems with much friction 19 need others than the
# first, and all of them are solved.
STARTS = (1.0, 1.0), (0.1, 0.1), (10.0, 10.0), (0.01, 1.0)
_ONES = np.ones(3)


def find_interior_point(
    W: Array,
    q: Array,
    friction: float,
    compliance: Array,
    finish: Callable[[Array], bool],
    start: tuple[float, float] = STARTS[0],
) -> tuple[Array, float, int, bool]:
    """Follows the central path.

    Args:
        W, q, friction, compliance: as in `FrictionalProblem`.
        finish: tries to get from forces (3, C) to a solution; asked again as they come nearer.
        start: y₀ and z₀ of all pairs, one of `STARTS`.

    Returns:
        Forces (3, C) within their cones, N; what they leave to solve, as a share of the velocities that they have to
        stop; the iterations; and whether `finish` came to a solution.
    """
    C, iterations = len(compliance), 0
    Q = np.array([1.0, friction, friction]) / np.sqrt(compliance)[:, None]  # f = Q y: pairs alike, whatever their mass
    M = (Q[:, :, None, None] * W.reshape(3, C, 3, C).transpose(1, 0, 3, 2) * Q).reshape(C, 3, 3 * C)
    p = Q * q.T
    scale = float(np.abs(p).max())
    p /= scale
    y, z, diagonal = np.zeros((C, 3)), np.zeros((C, 3)), np.arange(C)
    y[:, 0], z[:, 0] = start
    finish_residual, error = FIRST_FINISH_RESIDUAL, np.inf
    for iterations in range(1, ITERATIONS + 1):
        τ = float(y.ravel().dot(z.ravel())) / C
        v = np.matmul(M, y.ravel()) + p
        speed = np.sqrt(v[:, 1] ** 2 + v[:, 2] ** 2 + min(0.1 * τ, 1.0) ** 2)
        residual = v - z
        residual[:, 0] += speed
        error = max(float(np.abs(residual).max()), τ)
        within_bounds = ACCURACY < error < 1 / ACCURACY
        if not (within_bounds and min(_determinant(y).min(), _determinant(z).min()) > 0):
            break
        if error < finish_residual:
            finish_residual = error / FINISH_REDUCTION
            forces = (scale * Q * y).T
            if finish(forces):
                return forces, error, iterations, True
        B = M.copy()  # Δz = B Δy + residual
        B[:, 0] += (v[:, 1] / speed)[:, None] * M[:, 1] + (v[:, 2] / speed)[:, None] * M[:, 2]
        H, inverse, square = _nesterov_todd_scaling(y, z)
        G = B.reshape(C, 3, C, 3).copy()
        G[diagonal, :, diagonal] += square
        scaled = _multiply(H, y)
        arrow = _jordan_matrix(scaled)
        target = -_jordan_product(scaled, scaled)
        try:
            for is_corrector in (False, True):
                step = _multiply(H, np.linalg.solve(arrow, target[:, :, None])[:, :, 0])
                Δy = np.linalg.solve(G.reshape(3 * C, 3 * C), (step - residual).ravel()).reshape(C, 3)
                Δz = np.matmul(B, Δy.ravel()) + residual
                α = min(_step_to_border(y, Δy), _step_to_border(z, Δz))
                if not is_corrector:
                    target -= _jordan_product(_multiply(H, Δy), _multiply(inverse, Δz))
                    target[:, 0] += max((1 - α) ** 3, 0.1) * τ  # the complementarity to aim at
        except np.linalg.LinAlgError:
            break
        y, z = y + STEP_FRACTION * α * Δy, z + STEP_FRACTION * α * Δz
    return (scale * Q * y).T, error, iterations, False


def _multiply(A: Array, x: Array) -> Array:
    """The products of matrices (C, 3, 3) and vectors (C, 3)."""
    return np.matmul(A, x[:, :, None])[:, :, 0]


def _jordan_matrix(y: Array) -> Array:
    """The arrow matrices (C, 3, 3) with y o z = _jordan_matrix(y) z."""
    arrow = y[:, :1, None] * np.eye(3)
    arrow[:, 0] = arrow[:, :, 0] = y
    return arrow


def _jordan_product(y: Array, z: Array) -> Array:
    """Jordan's product y o z = (y·z, y₀ z_t + z₀ y_t)."""
    product = y[:, :1] * z + z[:, :1] * y
    product[:, 0] = (y * z).dot(_ONES)
    return product


def _determinant(y: Array) -> Array:
    """y₀² - |y_t|² (C,), without cancellation near the border of the cone."""
    length = np.hypot(y[:, 1], y[:, 2])
    return (y[:, 0] - length) * (y[:, 0] + length)


def _nesterov_todd_scaling(y: Array, z: Array) -> tuple[Array, Array, Array]:
    """Nesterov and Todd's H (C, 3, 3), symmetric with H y = H⁻¹ z, its inverse and its square."""
    reflection = np.array([1.0, -1.0, -1.0])
    det_y, det_z = _determinant(y), _determinant(z)
    y, z = y / np.sqrt(det_y)[:, None], z / np.sqrt(det_z)[:, None]
    w = (z + reflection * y) / np.sqrt(2 + 2 * (y * z).dot(_ONES))[:, None]
    η = np.sqrt(np.sqrt(det_z / det_y))[:, None, None]
    H = np.empty((len(y), 3, 3))
    H[:, 0] = H[:, :, 0] = w
    H[:, 1:, 1:] = np.eye(2) + w[:, 1:, None] * w[:, None, 1:] / (1 + w[:, :1, None])
    square = η**2 * (2 * w[:, :, None] * w[:, None, :] - np.diag(reflection))
    return η * H, H * (reflection[:, None] * reflection) / η, square


def _step_to_border(y: Array, Δy: Array) -> float:
    """The largest α <= 1 with y + α Δy in the cones."""
    a, c = Δy[:, 0] ** 2 - Δy[:, 1] ** 2 - Δy[:, 2] ** 2, _determinant(y)
    b = y[:, 0] * Δy[:, 0] - y[:, 1] * Δy[:, 1] - y[:, 2] * Δy[:, 2]
    discriminant = b**2 - a * c  # of a α² + 2 b α + c = 0
    denominator = np.sqrt(np.maximum(discriminant, 0.0)) - b
    leaves = (discriminant >= 0) & (denominator > 0)
    return min(1.0, float((c[leaves] / denominator[leaves]).min(initial=1.0)))
