"""Units that tables may be in, and SI prefixes, so that numbers on axes have few digits."""

import math

UNITS = {  # of a quantity's SI unit: what tables may be in, each in that unit
    "s": {"s": 1.0, "ms": 1e-3},
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "N": {"N": 1.0, "mN": 1e-3, "kN": 1e3},
    "Pa": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "bar": 1e5},
    "m/s2": {"m/s2": 1.0, "m/s^2": 1.0, "m/s²": 1.0, "mm/s2": 1e-3},
    "m3": {"m3": 1.0, "m³": 1.0, "l": 1e-3, "ml": 1e-6},
    "1": {"1": 1.0},
}
QUANTITIES = {
    **{"force": "N", "tension": "N", "pressure": "Pa", "acceleration": "m/s2"},
    **{"displacement": "m", "length": "m", "volume": "m3"},
}
WITHOUT_PREFIX = {"1": (1.0, ""), "m2": (1e6, "mm²"), "m3": (1e6, "cm³"), "m/s2": (1.0, "m/s²")}
PREFIXES = {-12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}


def prefixed(unit: str, largest: float) -> tuple[float, str]:
    """What to multiply values in an SI unit by, and that unit with a prefix, so that the largest is from 1 to 1000.

    Areas are in mm², volumes in cm³; pure numbers and accelerations stay as they are.
    """
    if unit in WITHOUT_PREFIX:
        return WITHOUT_PREFIX[unit]
    exponent = 3 * math.floor(math.log10(largest) / 3 + 1e-9) if largest > 0 and math.isfinite(largest) else 0
    exponent = min(max(exponent, min(PREFIXES)), max(PREFIXES))
    return 10.0**-exponent, PREFIXES[exponent] + unit


def readable(unit: str) -> str:
    """A unit as files have it, with its exponents as they are printed: s^2/kg^1/2 is s²/√kg."""
    return unit.replace("kg^1/2", "√kg").replace("^2", "²")
