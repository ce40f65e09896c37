"""What friction turns round in step after step, and the share of its velocity that it can stop: `braking`, compiled."""

from numpy import ndarray as Array

from fenics_rom.compilation import jit_part, jit_shared
from fenics_rom.compiled_arrays import flat
from fenics_rom.mechanics import braking
from fenics_rom.mechanics.braking import AIMED, LEAST_SHARE
from fenics_rom.mechanics.compiled.copying import fill
from fenics_rom.mechanics.compiled.coulomb import add_motion_among
from fenics_rom.mechanics.compiled.linearised import Among, find_change
from fenics_rom.mechanics.compiled.work_space import take_rows

root_of = jit_shared(braking.root_of)


@jit_part
def share_of(helped: Array, relative: Array, target: Array) -> float:
    """The share of its velocity that what swings is asked for, 1 where nothing does."""
    share = 1.0
    for c in range(len(helped)):
        if helped[c]:
            (_, x, y), (_, a, b) = relative[c], target[c]
            if a != 0 or b != 0:
                return 2 * (a * x + b * y) / (x * x + y * y)
            share = 0.0
    return share


@jit_part
def next_share(
    among: Among,
    whole: Array,
    friction: Array,
    yielding: Array,
    f: Array,
    u: Array,
    moves: Array,
    share: float,
    below: float,
    above: float,
    negligible: float,
    enough: float,
    space: Array,
) -> float:
    """The share that is to be looked at next, between two that are known to be too little and too much.

    Arguments as of `find_change`, but for whole (C, 3), c_t of what swings at σ = 1, and moves (C, 3), u + c_t, m/s.
    """
    C = len(f)
    less, by_f, by_moves = take_rows(space, C, 3), take_rows(space, C, 3), take_rows(space, C, 3)
    for c in range(C):
        for k in range(3):
            less[c, k] = -whole[c, k]
    fill(by_moves, 0.0)
    if not find_change(among, friction, yielding, f, u, less, by_f, space):
        return (below + above) / 2
    add_motion_among(among.V, by_f, flat(by_moves))
    square = slope = power = 0.0
    for c in range(C):
        for k in range(1, 3):
            square += by_f[c, k] * by_moves[c, k]
            slope += by_f[c, k] * moves[c, k] + f[c, k] * by_moves[c, k]
            power += f[c, k] * moves[c, k]
    root = share + root_of(square, slope, power + min(enough / 2, AIMED * negligible))
    if below + LEAST_SHARE < root < above:
        return root
    if share == 0.0 and power >= -negligible and slope >= 0:
        return 0.0  # a little would be too much
    return (below + above) / 2
