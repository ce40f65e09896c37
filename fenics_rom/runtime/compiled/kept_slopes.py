"""Newton's method with slopes that are kept while they pay, of a free body: `steppers.kept_newton`, compiled."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.mechanics.compiled.copying import copy_rows
from fenics_rom.runtime.compiled.frames import REST, State
from fenics_rom.runtime.steppers.inertia import ROUND_OFF, SLOW, TOLERANCE
from fenics_rom.runtime.steppers.kept_newton import GROWING, JACOBIAN, STAGNATION

# In `State.kept`: iterations and steps with the slopes that are kept (no iterations: there are none), and iterations of
# the step before.
ITERATIONS, STEPS, LAST = 2, 3, REST
# Of a search: what corrections are small beside, the one before, how many there were, and if slopes are of this step.
SCALE, BEFORE, COUNT, IS_NEW = range(4)


@jit_part
def begin_search(state: State) -> Array:
    """What a search knows, see `SCALE` and others."""
    kept, search = state.kept, np.zeros(4)
    if kept[LAST] * kept[STEPS] > kept[ITERATIONS]:
        kept[ITERATIONS] = 0.0
    search[BEFORE] = np.inf
    return search


@jit_part
def lacks_slopes(state: State, search: Array) -> bool:
    """Whether slopes are to be found; begins an iteration."""
    search[COUNT] += 1
    if state.kept[ITERATIONS] != 0.0:
        return False
    search[IS_NEW] = 1.0
    return True


@jit_part
def keep_inverse(slopes: Array, state: State) -> None:
    """Keeps the inverse of slopes (3 + m, 3 + m)."""
    copy_rows(np.linalg.inv(slopes), state.slopes)
    state.kept[ITERATIONS], state.kept[STEPS] = JACOBIAN, 0.0


@jit_part
def has_ended(size: float, state: State, search: Array) -> bool:
    """Whether a correction of this size was the last one."""
    kept, scale, ratio = state.kept, search[SCALE], size / search[BEFORE]
    ends = (0 < ratio < 1 and size * ratio <= TOLERANCE * scale) or size <= ROUND_OFF * scale
    ends = ends or (ratio > 0.5 and size <= STAGNATION * scale)
    if ends or (search[IS_NEW] != 0.0 and ratio > 1 and size <= GROWING * scale):
        kept[LAST], kept[ITERATIONS], kept[STEPS] = search[COUNT], kept[ITERATIONS] + search[COUNT], kept[STEPS] + 1
        return True
    search[BEFORE] = size
    if ratio > SLOW and search[COUNT] > 1:
        kept[ITERATIONS], search[BEFORE] = 0.0, np.inf
    return False
