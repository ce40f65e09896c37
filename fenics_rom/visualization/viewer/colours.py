"""The colour scale: viridis, and an end that is a round number."""

import math

import numpy as np
from matplotlib import colormaps
from numpy import ndarray as Array

from fenics_rom.io.units import prefixed

COLOUR_MAP = colormaps["viridis"]
STOPS = 32  # of the colour bar, which is even between two


def bar_colours() -> list[tuple[int, int, int]]:
    """Red, green and blue along the colour bar, 0 to 255."""
    colours = COLOUR_MAP(np.linspace(0, 1, STOPS))
    return [(round(255 * r), round(255 * g), round(255 * b)) for r, g, b, _ in colours.tolist()]


def shares_of(values: Array, largest: float) -> Array:
    """Of the scale, 0 to 1, for each value; those of `largest` and beyond are at its end."""
    if not largest > 0:
        return np.zeros(len(values))
    return np.clip(values / largest, 0.0, 1.0)


def linear_light(colours: Array) -> Array:
    """Of colours as a screen is told them (sRGB), both 0 to 1. Source: IEC 61966-2-1."""
    return np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)


LINEAR_COLOURS = linear_light(COLOUR_MAP(np.arange(COLOUR_MAP.N))[:, :3])


def vertex_colours(shares: Array) -> Array:
    """Red, green and blue of linear light, 0 to 1, (V, 3), at shares (V,) of the scale."""
    return LINEAR_COLOURS[np.rint(shares * (COLOUR_MAP.N - 1)).astype(np.intp)]


def round_up(value: float) -> float:
    """The next of 1, 2, 5, 10, ... times a power of ten; 0 of 0."""
    if not (math.isfinite(value) and value > 0):
        return 0.0
    power = 10.0 ** math.floor(math.log10(value))
    return next(step * power for step in (1, 2, 5, 10, 20) if step * power >= value)


def with_unit(value: float, unit: str, digits: int = 3) -> str:
    """A number with some digits and its unit, as 12.3 mJ; % and quotients have no prefix."""
    if unit == "%" or "/" in unit:
        return f"{value:.{digits}g} {unit}"
    factor, prefixed_unit = prefixed(unit, abs(value))
    return f"{value * factor:.{digits}g} {prefixed_unit}"
