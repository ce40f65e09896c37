"""The colour scale: bands of viridis, and an end that is a round number."""

import math

import numpy as np
from matplotlib import colormaps
from numpy import ndarray as Array

from fenics_rom.io.units import prefixed

BANDS = 32  # a mesh each; with more a browser without a GPU draws fewer pictures a second
COLOUR_MAP = "viridis"


def band_colours(bands: int = BANDS) -> list[tuple[int, int, int]]:
    """Red, green and blue of each band, 0 to 255."""
    colours = colormaps[COLOUR_MAP](np.linspace(0, 1, bands))
    return [(round(255 * r), round(255 * g), round(255 * b)) for r, g, b, _ in colours.tolist()]


def levels_of(values: Array, largest: float) -> Array:
    """Of each value, in bands, from 0 to BANDS; those of `largest` and beyond are at the end."""
    if not largest > 0:
        return np.zeros(len(values))
    return np.clip(values * (BANDS / largest), 0.0, BANDS)


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
