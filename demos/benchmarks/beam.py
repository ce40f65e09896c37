"""A beam that bends and twists as far as it likes: what solids are compared with."""

import numpy as np
from scipy.integrate import solve_bvp

Array = np.ndarray


def torsion_constant(wide: float, thick: float) -> float:
    """J of a rectangle, m⁴ (Roark's Formulas for Stress and Strain)."""
    share = thick / wide
    return wide * thick**3 * (1 / 3 - 0.21 * share * (1 - share**4 / 12))


def _rotated(q: Array, v: Array, sign: float = 1.0) -> Array:
    """Vectors (3, n) turned by quaternions (4, n), or back."""
    scalar, vector = q[0], sign * q[1:]
    across = 2 * np.cross(vector, v, axis=0)
    return v + scalar * across + np.cross(vector, across, axis=0)


def tip_of_cantilever(length: float, stiffness: Array, bending: Array, force: Array) -> Array:
    """Displacement (3,) of the tip of a geometrically exact beam along x (Simo, 1985) under a dead force (3,).

    Args:
        length: m.
        stiffness: (3,) EA and two times κGA, N.
        bending: (3,) GJ and EI about y and about z, N m².
        force: on the tip, N.
    """

    def rates(_: Array, state: Array, push: Array) -> Array:
        q, moment = state[3:7], state[7:]
        n = np.broadcast_to(push[:, None], moment.shape)
        strain = _rotated(q, n, -1.0) / stiffness[:, None] + np.array([[1.0], [0.0], [0.0]])
        tangent = _rotated(q, strain)
        κ = _rotated(q, moment, -1.0) / bending[:, None]
        dq = np.concatenate([-(q[1:] * κ).sum(axis=0)[None], q[0] * κ + np.cross(q[1:], κ, axis=0)]) / 2
        return np.concatenate([tangent, dq, -np.cross(tangent, n, axis=0)])

    s, rest = np.linspace(0, length, 41), np.zeros((10, 41))
    rest[0], rest[3] = s, 1.0
    fixed = rest[:7, 0]
    for share in (0.25, 0.5, 0.75, 1.0):
        solution = solve_bvp(
            lambda x, y, push=share * force: rates(x, y, push),
            lambda a, b: np.concatenate([a[:7] - fixed, b[7:]]),
            s,
            rest,
            tol=1e-7,
        )
        assert solution.success
        s, rest = solution.x, solution.y
    return solution.y[:3, -1] - np.array([length, 0.0, 0.0])
