"""Which stepper of large deformation a run gets by the error that its steps may have: measured in the run itself.

At the same number of steps in a period one body has a hundred times the error of another, so none is foretold. The run
is taken with whole steps and with halves, in the order of what steppers cost: both are of second order, so that halves
lack a third of what they are apart (Richardson), and whole steps four thirds. No clock is asked, so that the choice is
the same on any machine.
"""

import math
from collections.abc import Callable

import numpy as np
from numpy import ndarray as Array

from fenics_rom.arguments import is_number
from fenics_rom.errors import SceneError, shown

COSTS = {"linearly-implicit": 1.0, "newton": 3.5}  # of a step, as demos/rates/stepper_choice.py has it: 3.5 to 10
MARGIN = 0.9  # of the step that is said to do

Path = Callable[[str, int], Array]


def check_step_error(error: float) -> float:
    """An error that steps may have, which is positive and finite.

    Raises:
        SceneError: it is not.
    """
    if not (is_number(error) and 0 < error < math.inf):
        raise SceneError(
            f"step_error = {shown(error)}: use a positive number, the error that steps may have as a share of "
            "the largest displacement"
        )
    return float(error)


def stepper_by_error(error: float, dt: float, path: Path) -> tuple[str, str]:
    """The stepper that costs least of those whose steps have at most an error in a run, and what was measured.

    Args:
        error: as a share of the largest displacement in the run, of the whole body, in the mass norm.
        dt: time step of the run, s.
        path: of a stepper and a number of parts for each step, displacements (n, m) after each of the n steps.

    Raises:
        SceneError: none has; it says which dt would do.
    """
    errors = dict[str, float]()
    for stepper in COSTS:
        errors[stepper] = found = measured_error(path(stepper, 1), path(stepper, 2))
        if found <= error:
            return stepper, f"its steps have an error of {found:.2g} in this run, of {error:g} that was asked"
    least = min(errors, key=lambda each: COSTS[each] * math.sqrt(errors[each]))
    told = ", ".join(f"{found:.2g} with {stepper}" for stepper, found in errors.items())
    raise SceneError(
        f"step_error = {error:g}: steps of {dt:g} s have errors of {told} in this run; with {least} dt = "
        f"{MARGIN * dt * math.sqrt(error / errors[least]):.2g} s should do"
    )


def measured_error(whole: Array, halves: Array) -> float:
    """Of whole steps (n, m), beside steps of half their length, as a share of the largest displacement."""
    apart, largest = (float(np.sqrt(np.square(each).sum(axis=1).max())) for each in (whole - halves, halves))
    return 4 / 3 * apart / largest if largest else 0.0
