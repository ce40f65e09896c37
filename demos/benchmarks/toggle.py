"""Two bars that lean on each other and snap through (Williams, 1964), beside beams of Reissner (1972)."""

import re
from collections.abc import Iterator

import numpy as np
from scipy.integrate import solve_bvp
from scipy.optimize import minimize_scalar
from solids import MIDDLE, Row, bar, mesh_of

import fenics_rom as fr

Array = np.ndarray
SPAN, RISE, WIDE, THICK, YOUNG = 0.3287522, 0.0098044, 0.0191262, 0.0061722, 71.016e9  # of half of it, m, Pa
MOST = 200.0  # N, more than it takes to snap


def load_of_beams(sag: float) -> float:
    """Force, N, that holds the middle where it has sunk by so much, m; both ends are clamped."""
    angle, length = np.arctan2(RISE, SPAN), np.hypot(SPAN, RISE)
    EA, EI = YOUNG * WIDE * THICK, YOUNG * WIDE * THICK**3 / 12
    GA = 5 / 12 * EA  # ν = 0

    def rates(_: Array, y: Array, p: Array) -> Array:
        θ, moment = y[2:]
        across, up = p * EI / length**2
        N, Q = across * np.cos(θ) + up * np.sin(θ), up * np.cos(θ) - across * np.sin(θ)
        stretch, shear = 1 + N / EA, Q / GA
        x, z = stretch * np.cos(θ) - shear * np.sin(θ), stretch * np.sin(θ) + shear * np.cos(θ)
        return np.array([x, z, moment / EI, shear * N - stretch * Q])

    def ends(a: Array, b: Array, _: Array) -> Array:
        return np.array([a[0], a[1], a[2] - angle, b[0] - SPAN, b[1] - RISE + sag, b[2] - angle])

    s = np.linspace(0, length, 41)
    guess = np.array([s * np.cos(angle), s * np.sin(angle) * (1 - sag / RISE), np.full(41, angle), 0 * s])
    solution = solve_bvp(rates, ends, s, guess, np.zeros(2), tol=1e-8)
    assert solution.success
    return float(-2 * solution.p[1] * EI / length**2)


def toggle(quick: bool) -> Iterator[Row]:
    """A quarter of it: half of its span, and of its width; followed by its arc length."""

    def place(p: Array) -> Array:
        tall = THICK * np.hypot(SPAN, RISE) / SPAN
        return np.column_stack([SPAN * p[:, 0], RISE * p[:, 0] + tall * (p[:, 1] - 0.5), WIDE / 2 * p[:, 2]])

    bricks = (12, 1, 1) if quick else (32, 2, 1)
    middle = MIDDLE + MIDDLE.replace("bottom", "right").replace("[0.0, 0.0, 1.0]", "[1.0, 0.0, 0.0]")
    run = f"dt = 0.02\nduration = 1.0\nload = [{{ contact = 'tip', force = [0.0, {-MOST / 4}, 0.0] }}]"
    system = bar(bricks, place, YOUNG, 0.0, 7850.0, supports=middle, run=run)
    found = fr.simulate(system, arc_length=True)
    told = re.findall(r"the load has a (\w+) value, (\S+) of", "\n".join(found.warnings))
    limits = {which: MOST * float(share) for which, share in told}
    most = -minimize_scalar(lambda sag: -load_of_beams(sag), bounds=(4e-3, 8e-3), method="bounded").fun
    least = minimize_scalar(load_of_beams, bounds=(8e-3, 12e-3), method="bounded").fun
    for which, published in (("largest", most), ("smallest", least)):
        yield Row("Williams' toggle", mesh_of(system, bricks), f"{which} load, N", published, limits[which], 0.01)
