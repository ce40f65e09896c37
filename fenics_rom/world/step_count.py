"""Steps of a world in a row: how many are asked for, and when they end."""

from fenics_rom.arguments import is_number
from fenics_rom.errors import StepError, shown


def checked_count(count: int) -> int:
    """A number of steps; StepError where it is none."""
    if not (type(count) is int or is_number(count, whole=True)) or count < 1:  # the type first: it takes less time
        raise StepError(f"count = {shown(count)}: use a whole number of steps > 0")
    return count


def next_time(time: float, h: float, steps: int) -> float:
    """After so many steps of h s, one by one, s."""
    for _ in range(steps):
        time += h
    return time
