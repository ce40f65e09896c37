"""A contact mode of many bodies of one ROM that compiled loops step."""

from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.runtime.compiled.linear_step import State


class Mode(NamedTuple):
    """A contact mode."""

    name: str
    body: Any  # as compiled steps have it
    touch: Any  # where it can be touched (`touching.Touched`); None: nowhere
    states: State  # of all bodies; those of bodies in other modes say nothing
    stretch: Array = np.empty(0)  # of its points, for steps that ask it: see `touching.Clearance`
    keep_rows: Any = None  # called after steps: see `CompiledStep`
