"""The energy account of a run, J: running sums that together with the stored energy must close to round-off."""

import math
from collections.abc import Callable, Sequence

# Supplied, dissipated, what tells the parts that contact has in both, and numerical.
StepWork = tuple[float, float, tuple[Callable[[], tuple[float, float, float, float]], ...], float]


class EnergyLedger:
    """E - E₀ = supplied - dissipated - lost_in_switching - numerical.

    Every sum carries along what it was rounded by, so that a million small works add up.

    Args:
        flush: called before a sum is read, to book what is still to be booked.

    Attributes:
        flush: as given.
    """

    def __init__(self, flush: Callable[[], None] = lambda: None):
        self.flush = flush
        self._sums = [(0.0, 0.0)] * 7  # supplied, dissipated, lost, numerical; by obstacles, in contact, by friction

    @property
    def supplied(self) -> float:
        """Work of the inputs, Σ h (B u)ᵀ v̂."""
        return self.sums[0][0]

    @property
    def dissipated(self) -> float:
        """Σ h v̂ᵀ D v̂, never negative."""
        return self.sums[1][0]

    @property
    def lost_in_switching(self) -> float:
        """Taken out of the state by projections; negative only for oblique switching."""
        return self._sums[2][0]

    @property
    def numerical(self) -> float:
        """Of steps without inertia: what they miss of the work on the way, of either sign; 0 as dt goes to 0."""
        return self.sums[3][0]

    @property
    def obstacles(self) -> float:
        """Of what was supplied: the work of moving obstacles."""
        return self.sums[4][0]

    @property
    def contact(self) -> float:
        """Of what was dissipated: in impacts, never negative; with the penalty method less what its springs hold."""
        return self.sums[5][0]

    @property
    def friction(self) -> float:
        """Of what was dissipated: by sliding, never negative."""
        return self.sums[6][0]

    def book_steps(self, steps: Sequence[StepWork]) -> None:
        """Adds the works of some steps, J, with those of contact as they are told."""
        supplied, dissipated, contacts, numerical = zip(*steps, strict=True)
        works = [work() for of_step in contacts for work in of_step]
        if works:
            self.book_contact(*map(math.fsum, zip(*works, strict=True)))
        self.book(supplied=math.fsum(supplied), dissipated=math.fsum(dissipated), numerical=math.fsum(numerical))

    def book_contact(self, obstacles: float, contact: float, friction: float, numerical: float) -> None:
        """Adds what obstacles supplied and what contact and friction dissipated, J, to their sums and to the whole."""
        self.book(supplied=obstacles, dissipated=contact + friction, numerical=numerical)
        self.book_parts(obstacles, contact, friction)

    def book_parts(self, obstacles: float, contact: float, friction: float) -> None:
        """Adds to the sums of contact alone, J: to the whole it is added with the rest of the step."""
        self._sums[4:] = map(_add, self._sums[4:], (obstacles, contact, friction))

    def book(
        self, *, supplied: float = 0.0, dissipated: float = 0.0, lost_in_switching: float = 0.0, numerical: float = 0.0
    ) -> None:
        """Adds to the sums, J."""
        self._sums[:4] = map(_add, self._sums[:4], (supplied, dissipated, lost_in_switching, numerical))

    @property
    def sums(self) -> tuple[tuple[float, float], ...]:
        """Each sum, J, and what it was rounded by: all that there is to save."""
        self.flush()
        return tuple(self._sums)

    @sums.setter
    def sums(self, sums: tuple[tuple[float, float], ...]) -> None:
        self.flush()  # what is not yet booked belongs to the old ones
        self._sums = list(sums)

    def __repr__(self) -> str:
        return (
            f"EnergyLedger(supplied={self.supplied:.6g}, dissipated={self.dissipated:.6g}, "
            f"lost_in_switching={self.lost_in_switching:.6g}, numerical={self.numerical:.6g})"
        )


def _add(total: tuple[float, float], amount: float) -> tuple[float, float]:
    """A sum, and what it lacks of the exact one."""
    if not amount:
        return total
    if not math.isfinite(total[0] + amount):  # standard switching can gain energy until there are no numbers for it
        return total[0] + amount, 0.0
    rounded = math.fsum((*total, amount))
    return rounded, math.fsum((*total, amount, -rounded))
