"""The colour scale: bands of viridis, and an end that is a round number."""

import math

import numpy as np

from fenics_rom.io.units import prefixed

Array = np.ndarray

BANDS = 20
# Viridis at ten even places (S. van der Walt and N. Smith, 2015; CC0).
_VIRIDIS = (0x440154, 0x482878, 0x3E4989, 0x31688E, 0x26828E, 0x1F9E89, 0x35B779, 0x6ECE58, 0xB5DE2B, 0xFDE725)


def band_colours(bands: int = BANDS) -> list[tuple[int, int, int]]:
    """Red, green and blue of each band, 0 to 255."""
    anchors = np.array([[value >> 16, value >> 8 & 255, value & 255] for value in _VIRIDIS])
    at = np.linspace(0, len(anchors) - 1, bands)
    channels = (np.interp(at, range(len(anchors)), channel) for channel in anchors.T)
    return [(round(r), round(g), round(b)) for r, g, b in zip(*channels, strict=True)]


def bands_of(values: Array, largest: float) -> Array:
    """The band of each value, from 0 to BANDS - 1; `largest` and beyond is the last."""
    if not largest > 0:
        return np.zeros(len(values), dtype=np.intp)
    return np.clip(values * (BANDS / largest), 0, BANDS - 1).astype(np.intp)


def round_up(value: float) -> float:
    """The next of 1, 2, 5, 10, ... times a power of ten; 0 of 0."""
    if not (math.isfinite(value) and value > 0):
        return 0.0
    power = 10.0 ** math.floor(math.log10(value))
    return next(step * power for step in (1, 2, 5, 10, 20) if step * power >= value)


def with_unit(value: float, unit: str) -> str:
    """A number with three digits and its unit, as 12.3 mJ; % and quotients have no prefix."""
    if unit == "%" or "/" in unit:
        return f"{value:.3g} {unit}"
    factor, prefixed_unit = prefixed(unit, abs(value))
    return f"{value * factor:.3g} {prefixed_unit}"
