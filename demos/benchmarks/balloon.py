"""A balloon of rubber that is blown up beyond its largest pressure."""

from collections.abc import Iterator

import numpy as np
from solids import Row, bar, mesh_of

from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.mechanics.gas import ATMOSPHERE

Array = np.ndarray


def balloon(_quick: bool) -> Iterator[Row]:
    """A sector between planes through the centre: p = ∫ W'(λ)/(λ³ - 1) dλ over the wall of an incompressible sphere.

    A given amount of gas is in it. Its pressure is largest at an inner stretch of 1.53.
    """
    inner, outer, angle, poisson, C10, C01 = 0.010, 0.011, 0.05, 0.4999, 45e3, 4.5e3

    def place(p: Array) -> Array:
        along = np.column_stack([np.ones(len(p)), np.tan(angle) * p[:, 1], np.tan(angle) * p[:, 2]])
        return (inner + (outer - inner) * p[:, :1]) * along / np.linalg.norm(along, axis=1)[:, None]

    corners = place(np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]]))
    volume = float(abs(np.linalg.det(corners[[0, 1, 2]])) + abs(np.linalg.det(corners[[0, 2, 3]]))) / 6
    s, c = float(np.sin(angle)), float(np.cos(angle))
    planes = {"front": [0.0, 1.0, 0.0], "bottom": [0.0, 0.0, 1.0], "back": [-s, c, 0.0], "top": [-s, 0.0, c]}
    held = "".join(f'\n[[supports.held]]\nsurface = "{name}"\nnormal = {normal}' for name, normal in planes.items())
    effects = f'large_deformation = {{ material = "mooney_rivlin", constants = [{C10}, {C01}] }}\n'
    effects += f'[effects.pressure.air]\nsurface = "left"\ncontrol = "gas"\ngas = {{ volume = {volume!r} }}\n'
    bricks, young = (3, 1, 1), 4 * (C10 + C01) * (1 + poisson)
    system = bar(bricks, place, young, poisson, 1000.0, effects, held, "")
    assert system.scene is not None
    body = FullOrderSimulator(system, 1.0, system.scene.environment)
    for stretch in np.arange(1.1, 3.05, 0.1):
        expected = pressure(stretch, inner / outer, C10, C01)
        gas = volume * (stretch**3 * (1 + expected / ATMOSPHERE) - 1)
        body.step(np.array([0.0, 0.0, 0.0, gas]))
        for shown in (1.5, 2.0, 3.0):
            if abs(stretch - shown) < 1e-9:
                what = f"pressure at a stretch of {shown}, Pa"
                yield Row("balloon with gas", mesh_of(system, bricks), what, expected, body.reactions["air"], 0.002)
    body.close()


def pressure(stretch: float, share: float, C10: float, C01: float) -> float:
    """Of a sphere whose inner radius is a share of the outer one, at a stretch of the inner one, Pa."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    least = np.cbrt(1 + (stretch**3 - 1) * share**3)
    λ, half = (stretch + least) / 2 + (stretch - least) / 2 * nodes, (stretch - least) / 2
    slope = C10 * (4 * λ - 4 * λ**-5) + C01 * (4 * λ**3 - 4 * λ**-3)
    return float(half * weights @ (slope / (λ**3 - 1)))
