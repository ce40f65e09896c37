"""Forces of pairs under Coulomb's law, by Newton's method and sweeps in turn."""

from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.mechanics.compiled.coulomb import ACCURATE, STAGNATION, look_among
from fenics_rom.mechanics.compiled.linearised import Among, find_by_steps
from fenics_rom.mechanics.compiled.sweeps import MOST_SWEEPS, find_by_sweeps

CLOSE = 0.1  # of the velocities that forces stop: from there steps of Newton's method are tried at once,
FEW_PAIRS = 24  # as they are of so many pairs
FEW_SWEEPS = 8  # before they are tried elsewhere


@jit_part
def find_among(
    among: Among, q: Array, friction: Array, yielding: Array, f: Array, u: Array, speed: float, space: Array
) -> tuple[int, float]:
    """Forces of pairs: how many sweeps and solves they took, and how far they are from the law, m/s.

    Arguments as of `find_by_steps`; speed: the largest of q, m/s.
    """
    V, count, is_found, sweeps = among.V, 0, False, 0
    error = look_among(V, q, friction, yielding, f, u)
    if error <= ACCURATE * speed:
        return 0, error
    if error <= CLOSE * speed or len(f) <= FEW_PAIRS:
        count, is_found = find_by_steps(among, q, friction, yielding, f, u, error, space)
        error, sweeps = look_among(V, q, friction, yielding, f, u), count
    if not (is_found and error <= STAGNATION * speed):
        sweeps += find_by_sweeps(V, q, friction, f, FEW_SWEEPS, space)
        error = look_among(V, q, friction, yielding, f, u)
    if not error <= STAGNATION * speed:
        count, is_found = find_by_steps(among, q, friction, yielding, f, u, error, space)
        error, sweeps = look_among(V, q, friction, yielding, f, u), sweeps + count
        if not is_found:
            sweeps += find_by_sweeps(V, q, friction, f, MOST_SWEEPS - FEW_SWEEPS, space)
            error = look_among(V, q, friction, yielding, f, u)
    return sweeps, error
