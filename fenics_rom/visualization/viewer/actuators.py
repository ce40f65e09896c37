"""What can be set of a body on a page: every column of its actuators, with its unit and the range of its slider."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.io.units import UNITS
from fenics_rom.rom.rom import Rom
from fenics_rom.visualization.viewer.mouse_spring import largest_input

SHOWN_STROKES = {"m": "mm", "m3": "ml"}  # units of sliders by those of strokes


class Actuator(NamedTuple):
    """One column of an input that all contact modes share, its unit, and the range of its slider.

    The range is what the surface at rest can follow (see `largest_input`), and all that the scene applies; of a given
    stroke what the scene applies alone, if it does.
    """

    name: str
    unit: str
    least: float
    largest: float
    scale: float = 1.0  # of the input, per unit of the slider


def actuators_of(rom: Rom) -> list[Actuator]:
    """Every column of every actuator."""
    first = next(iter(rom.contact_models))
    column = rom.contacts[first]
    found = []
    for name, width in rom.actuators.items():
        is_tendon, unit = name in rom.environment.details("effects.tendon"), rom.environment.input_units.get(name, "N")
        shown = SHOWN_STROKES.get(unit, unit)
        scale = UNITS[unit][shown] if shown != unit else 1.0
        applied, by_stroke = _applied(rom, name, width) / scale, name in rom.environment.controls
        for k in range(width):
            limit = largest_input(rom, first, column)
            if by_stroke:
                mode = rom.contact_models[first]
                limit *= float(np.square(mode.inputs[:, column] / mode.safe_frequencies).sum()) / scale
            limit = 0.0 if by_stroke and applied.any() else float(f"{limit:.2g}")
            least, largest = 0.0 if is_tendon else -limit, limit  # a cable only pulls
            axis = f" {'xyz'[k]}" if width == 3 else f" {k + 1}" if width > 1 else ""
            span = min(least, *applied[:, k]), max(largest, *applied[:, k])
            found.append(Actuator(name + axis, shown, *span, scale))
            column += 1
    return found


def _applied(rom: Rom, actuator: str, width: int) -> Array:
    """What the scene's load history applies to an actuator, (any, width), in the actuator's unit; 0 first."""
    loads = () if rom.environment.run is None else rom.environment.run.loads
    of_it = [np.atleast_2d(load.signal.values) for load in loads if load.actuator == actuator]
    return np.concatenate([np.zeros((1, width)), *of_it])
