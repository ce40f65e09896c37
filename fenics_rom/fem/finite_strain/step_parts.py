"""How large the parts are that a step is taken in."""

EASY_ITERATIONS = 6  # that lead to an equilibrium, after which a larger part of the load is tried
QUICK_CUTS = 3  # in half, after which a part is tried with patience
FIRST_WAIT, LONGEST_WAIT = 2, 64  # parts that are taken before one of twice the length is tried
PATIENT_PARTS = 16  # that begin with patience, where nothing else solved one


class StepParts:
    """Parts of steps, by what those before took.

    A part is to be solved soon, or is cut in half: what iterates for long, or asks for contact forces that are hard to
    find, takes longer than its halves. Where no small part is solved soon either, the first is tried with patience, and
    then its halves, quarters and so on. Steps after that begin with parts of the length that was solved, and try twice
    of it, the more rarely the more often that failed.

    Args:
        smallest: share of a step below which none is tried.

    Attributes:
        share: of the step, which the next part is.
        is_patient: whether whatever may solve it is to be tried.
    """

    def __init__(self, smallest: float):
        self._smallest = smallest
        self.forget()

    def forget(self) -> None:
        """What steps took so far says nothing of the next."""
        self.share = self._usual = 1.0
        self.is_patient = self._grows = False
        self._taken, self._wait, self._patience = 0, FIRST_WAIT, 0

    def begin(self, done: float) -> None:
        """Another part, where a share of the step is done."""
        self.share, self.is_patient = self._usual, self._patience > 0
        self._grows = self.share < 1.0 and self._taken >= self._wait and done % (2 * self.share) == 0.0
        if self._grows:
            self.share *= 2

    def solved(self, iterations: int) -> None:
        """The part was, by so many."""
        self._taken += 1
        if self._grows:
            self._wait = max(self._wait // 2, FIRST_WAIT)
        if self.is_patient:
            self._patience = self._patience - 1 if self._patience > 0 else PATIENT_PARTS
        if self.share != self._usual:
            self._usual, self._taken = self.share, 0

    def cut(self) -> bool:
        """The part was not solved; whether there is another to try."""
        if self._taken:
            self._wait, self._taken = min(2 * self._wait, LONGEST_WAIT), 0
        self._grows = False
        if not self.is_patient and self.share / 2 < max(self._usual / 2**QUICK_CUTS, self._smallest):
            self.is_patient, self.share = True, 2 * self._usual
        self.share /= 2
        return self.share >= self._smallest


class LoadParts(StepParts):
    """Parts of a load that is put on a body at rest, without contact: beginning with all, halved, and doubled."""

    def forget(self) -> None:
        """As in StepParts."""
        super().forget()
        self.is_patient = True

    def begin(self, done: float) -> None:
        """As in StepParts."""
        self.share = min(self._usual, 1.0 - done)

    def solved(self, iterations: int) -> None:
        """As in StepParts."""
        self._usual = 2 * self.share if iterations <= EASY_ITERATIONS else self.share

    def cut(self) -> bool:
        """As in StepParts."""
        self.share /= 2
        return self.share >= self._smallest


def parted_message(steps: int, finest: float) -> str:
    """What to say of so many steps that were taken in parts, the smallest of which was a share of a step."""
    return (
        f"Newton's method did not soon solve {steps} of the steps whole: they were taken in parts, the smallest "
        f"1/{round(1 / finest)} of a step, at about the cost of a smaller dt"
    )
