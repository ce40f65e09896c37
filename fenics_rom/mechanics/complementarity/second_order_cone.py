"""Jordan algebra of Lorentz's cone y₀ >= |y_t| in three dimensions, for many vectors (C, 3) at once.

Source: Alizadeh & Goldfarb, Second-order cone programming, Math. Program. 95, 2003.
"""

import numpy as np

Array = np.ndarray

_ONES = np.ones(3)


def multiply(A: Array, x: Array) -> Array:
    """The products of matrices (C, 3, 3) and vectors (C, 3)."""
    return np.matmul(A, x[:, :, None])[:, :, 0]


def jordan_matrix(y: Array) -> Array:
    """The arrow matrices (C, 3, 3) with y o z = jordan_matrix(y) z."""
    arrow = y[:, :1, None] * np.eye(3)
    arrow[:, 0] = arrow[:, :, 0] = y
    return arrow


def jordan_product(y: Array, z: Array) -> Array:
    """Jordan's product y o z = (y·z, y₀ z_t + z₀ y_t)."""
    product = y[:, :1] * z + z[:, :1] * y
    product[:, 0] = (y * z).dot(_ONES)
    return product


def determinant(y: Array) -> Array:
    """y₀² - |y_t|² (C,), without cancellation near the border of the cone."""
    length = np.hypot(y[:, 1], y[:, 2])
    return (y[:, 0] - length) * (y[:, 0] + length)


def nesterov_todd_scaling(y: Array, z: Array) -> tuple[Array, Array, Array]:
    """Nesterov and Todd's H (C, 3, 3), symmetric with H y = H⁻¹ z, its inverse and its square."""
    reflection = np.array([1.0, -1.0, -1.0])
    det_y, det_z = determinant(y), determinant(z)
    y, z = y / np.sqrt(det_y)[:, None], z / np.sqrt(det_z)[:, None]
    w = (z + reflection * y) / np.sqrt(2 + 2 * (y * z).dot(_ONES))[:, None]
    η = np.sqrt(np.sqrt(det_z / det_y))[:, None, None]
    H = np.empty((len(y), 3, 3))
    H[:, 0] = H[:, :, 0] = w
    H[:, 1:, 1:] = np.eye(2) + w[:, 1:, None] * w[:, None, 1:] / (1 + w[:, :1, None])
    square = η**2 * (2 * w[:, :, None] * w[:, None, :] - np.diag(reflection))
    return η * H, H * (reflection[:, None] * reflection) / η, square


def step_to_border(y: Array, Δy: Array) -> float:
    """The largest α <= 1 with y + α Δy in the cones."""
    a, c = Δy[:, 0] ** 2 - Δy[:, 1] ** 2 - Δy[:, 2] ** 2, determinant(y)
    b = y[:, 0] * Δy[:, 0] - y[:, 1] * Δy[:, 1] - y[:, 2] * Δy[:, 2]
    discriminant = b**2 - a * c  # of a α² + 2 b α + c = 0
    denominator = np.sqrt(np.maximum(discriminant, 0.0)) - b
    leaves = (discriminant >= 0) & (denominator > 0)
    return min(1.0, float((c[leaves] / denominator[leaves]).min(initial=1.0)))
