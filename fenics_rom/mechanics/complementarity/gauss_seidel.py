"""Frictional contact forces by sweeps over the pairs: slow, but it gets nearer where Newton's method cycles."""

import numpy as np

Array = np.ndarray

_ONES = np.ones(3)


def sweep_pairs(
    W: Array, q: Array, normals: Array, friction: float, compliance: Array, forces: Array, sweeps: int
) -> tuple[Array, int]:
    """Block Gauss-Seidel: one pair after the other, normal before tangent (Jean, CMAME 177, 1999).

    Args:
        W, q, normals, friction: as in `complementarity.solve`.
        compliance: (C,) of each pair by itself, m/s/N.
        forces: (C, 3) to begin with, N.
        sweeps: at most.

    Returns:
        Forces (C, 3), and the sweeps it took.
    """
    f, C, taken = forces.copy(), len(forces), 0
    blocks = W.reshape(C, 3, C, 3)[np.arange(C), :, np.arange(C)]
    floor = 1e-12 * compliance
    normal_compliance = np.maximum(((blocks @ normals[:, :, None])[:, :, 0] * normals).dot(_ONES), floor)
    tangential = np.eye(3) - normals[:, :, None] * normals[:, None, :]
    tangential_compliance = np.maximum(np.linalg.eigvalsh(tangential @ blocks @ tangential)[:, -1], floor)
    while taken < sweeps:
        taken += 1
        before = f.copy()
        for i in range(C):
            n, rows = normals[i], W[3 * i : 3 * i + 3]
            λ = n.dot(f[i])
            λ_new = max(0.0, λ - n.dot(rows.dot(f.ravel()) + q[i]) / normal_compliance[i])
            f[i] += (λ_new - λ) * n
            t = f[i] - λ_new * n - tangential[i].dot(rows.dot(f.ravel()) + q[i]) / tangential_compliance[i]
            length = np.sqrt(t.dot(t))
            f[i] = λ_new * n + t * min(1.0, friction * λ_new / max(length, 1e-300))
        if np.abs(f - before).max() <= 1e-15 * np.abs(f).max():
            break
    return f, taken
