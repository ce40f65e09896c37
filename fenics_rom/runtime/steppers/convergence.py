"""When Newton's iteration has found a balance of forces."""

CONVERGENCE_TOLERANCE = 1e-12  # of the largest force in a step
STAGNATION_TOLERANCE = 1e-8  # of it: from here on round-off may be what is left
FAST_CONTRACTION = 0.1  # up to which the slope of an earlier iteration will do
MAX_ITERATIONS = 30
MAX_PARTS = 64  # that a step which it does not solve is cut into


def is_solved(error: float, before: float, scale: float, round_off: float = 0.0) -> bool:
    """Whether forces out of balance, here and an iteration before, are nothing or round-off beside the largest one.

    `round_off`: what they may be by that of stresses, however small the strains.
    """
    stagnates = error > before / 2 and error <= max(STAGNATION_TOLERANCE * scale, round_off)
    return error <= CONVERGENCE_TOLERANCE * max(scale, round_off) or stagnates
