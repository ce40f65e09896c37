"""The gradient of a linear field on flat triangles, in the frame of each.

On a triangle with corners x_0, x_1, x_2 a field u that is linear has the constant surface gradient ∇ₛu = Σ u_k ⊗ ∇N_k,
N_k the barycentric coordinates. In the frame t₁ (along the first side), t₂ = n × t₁, with the sides' coordinates in it
as columns of S (2, 2), the gradients of N_1 and N_2 are the rows of S⁻¹, and that of N_0 is minus their sum.
Source: Zienkiewicz, Taylor & Zhu, The Finite Element Method, 2013, § 6.2 (linear triangles).
"""

import numpy as np

Array = np.ndarray


def triangle_frames(a: Array, b: Array) -> tuple[Array, Array]:
    """Frames and gradients of the corners' shape functions.

    Args:
        a, b: sides from the first corner to the second and to the third, (g, 3) each, m; of triangles with area.

    Returns:
        t₁, t₂ and n, (g, 3, 3), as rows; and the gradients along t₁ and t₂ of the three corners, (g, 3, 2), 1/m.
    """
    n, t1 = _unit(np.cross(a, b)), _unit(a)
    frame = np.stack([t1, np.cross(n, t1), n], axis=1)
    sides = frame[:, :2] @ np.stack([a, b], axis=2)
    return frame, np.array([[-1, -1], [1, 0], [0, 1]]) @ np.linalg.inv(sides)


def _unit(vectors: Array) -> Array:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
