"""A beam on a hub as a chain of rigid links with springs between them: exact in rotation, and it does not stretch.

Link i, uniform, at the angle θ_i in the plane, carries all links after it: with s = L/N, masses ρA s and springs EI/s
at joints, 2 EI/s at the hub, half a link from the first middle,

    Σ_j c_ij [cos(θ_i - θ_j) θ_j'' + sin(θ_i - θ_j) θ_j'²] = k_i+1 (θ_i+1 - θ_i) - k_i (θ_i - θ_i-1)

Errors go with 1/N².
"""

from collections.abc import Callable

import numpy as np

Array = np.ndarray
STABLE = 0.45 * 2.8 / 4  # of the step of Runge and Kutta's method, over the fastest oscillation of a chain, s² √(ρA/EI)


def tip_lag(
    links: int, length: float, bending: float, weight: float, hub: Callable[[float], float], end: float
) -> Array:
    """How far the tip lags behind the hub at equal steps until `end`, s, m.

    Args:
        links: N.
        length: L, m.
        bending: EI, N m².
        weight: ρA, kg/m.
        hub: its angle, rad, at a time, s; at rest at first, where the beam is straight.
        end: s.
    """
    size, i = length / links, np.arange(links)
    carried = links - 1 - np.maximum.outer(i, i)
    C = weight * size**3 * (carried + np.where(np.eye(links, dtype=bool), 1 / 3, 1 / 2))
    k = np.full(links + 1, bending / size)
    k[0], k[-1] = 2 * k[0], 0.0

    def acceleration(t: float, θ: Array, ω: Array) -> Array:
        apart = θ[:, None] - θ
        bent = k * np.diff(np.concatenate([[hub(t)], θ, θ[-1:]]))
        return np.linalg.solve(C * np.cos(apart), np.diff(bent) - (C * np.sin(apart)) @ ω**2)

    steps = int(np.ceil(end / (STABLE * size**2 * np.sqrt(weight / bending))))
    h, θ, ω, lag = end / steps, np.zeros(links), np.zeros(links), np.zeros(steps)
    for n in range(steps):
        t = n * h
        a = acceleration(t, θ, ω)
        b = acceleration(t + h / 2, θ + h / 2 * ω, ω + h / 2 * a)
        c = acceleration(t + h / 2, θ + h / 2 * ω + h**2 / 4 * a, ω + h / 2 * b)
        d = acceleration(t + h, θ + h * ω + h**2 / 2 * b, ω + h * c)
        θ, ω = θ + h * ω + h**2 / 6 * (a + b + c), ω + h / 6 * (a + 2 * b + 2 * c + d)
        lag[n] = -size * np.sin(θ - hub(t + h)).sum()
    return lag
