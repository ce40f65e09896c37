"""What friction stops within a step: as much as it can without doing work on a body.

What sticks is asked to have c_t = v_t/2 in the middle of a step, so that it rests at its end. Where friction as a whole
would do work on the body, having turned its motion round within the step, c_t = 0 takes its place for the pairs that do
it. These end the step with -v_t. Where that happens in step after step, they would swing to and fro for ever, and with
them forces. So what has swung for ten steps is asked for c_t = σ v_t/2, with the largest share σ with which friction
as a whole does no work: σ is near 1 as soon as it swings slowly, in that one of two steps in which the forces of rest
hold it back, and nothing swings after it.

The power of friction is Σ f_t·(u_t + c_t), with u_t what pairs slip by: of second degree in σ as long as all of them do
the same, with forces and u_t of first degree.
"""

import math
from collections.abc import Callable

import numpy as np
from numpy import ndarray as Array

WORK_ROUND_OFF = 1e-12  # of force times velocity: work that is no work
NEARLY_NONE = 1e-9  # of the work on what is stopped: by so much friction may do less than it could
AIMED = 2.0  # times what is no work: so far below it a share is looked for, as round-off of forces makes as much
MOST_LOOKS = 8  # at shares between 0 and 1
LEAST_SHARE = 1e-9
SWINGS = 10  # steps in a row in which a pair was not stopped: fewer are those of bodies that are pushed about

# What friction and u_t, (k, C) each, change by with the targets of pairs that take part, (k, C).
Response = Callable[[Array], tuple[Array, Array]]


class Braking:
    """What sticks is asked for in one step.

    Args:
        targets: c_t of all pairs (k, n), along k axes, m/s; changed in place.
        swung: (n,) in how many steps in a row, before this one, pairs were not stopped; None: in none.

    Attributes:
        targets: those that are asked for now.
        share: σ.
        helped: (n,) pairs that are not stopped in this one; None: there are none.
        swinging: (n,) those of them that are asked for the share σ; None: there are none.
    """

    __slots__ = ("_above", "_below", "_known", "_left", "_swung", "_whole", "helped", "share", "swinging", "targets")
    helped: Array | None
    swinging: Array | None

    def __init__(self, targets: Array, swung: Array | None):
        self.targets, self._swung, self.share = targets, swung, 1.0
        self.helped = self.swinging = None
        self._whole = targets  # c_t of what swings, at σ = 1
        self.look_anew()

    def renew(self, targets: Array) -> None:
        """Asks for other c_t (k, n), as velocities that others are measured by change in sweeps of the same step.

        What is decided stays; the share is looked for again, from that of now.
        """
        self.targets = self._whole = targets
        if self.helped is not None:
            self._whole = np.where(self.helped if self.swinging is None else self.swinging, targets, 0.0)
            self.targets = np.where(self.helped, self.share * self._whole, targets)
        self.look_anew()

    def anew(self, targets: Array) -> "Braking":
        """Nothing decided, for other c_t (k, n): what pairs are not stopped depends on which take part with them."""
        return Braking(targets, self._swung)

    def look_anew(self) -> None:
        """Looks for the share again, from that of now."""
        self._below, self._above, self._left, self._known = 0.0, 1.0, MOST_LOOKS, b""

    @property
    def swung_before(self) -> Array | None:
        """In how many steps in a row, before this one, pairs were not stopped (n,)."""
        return self._swung

    @property
    def swung(self) -> Array | None:
        """The same with this step (n,)."""
        if self.helped is None or self._swung is None:
            return None if self.helped is None else self.helped.astype(int)
        return swung_with(self.helped, self._swung)

    @property
    def by_share(self) -> Array | None:
        """What the targets change by with σ, (k, n), m/s; None where that is 0 or 1."""
        return None if self.swinging is None or not 0 < self.share < 1 else self._whole

    @property
    def slopes(self) -> Array:
        """What the targets change by with the velocities at the start, (n,)."""
        shares = np.ones(self.targets.shape[1])
        if self.helped is not None:
            shares[self.helped] = 0.0
        if self.swinging is not None:
            shares[self.swinging] = self.share
        return shares / 2

    def know(self, helped: Array, whole: Array) -> None:
        """Takes over what was decided elsewhere: pairs (n,) that are not stopped, and c_t (k, n) of all at σ = 1."""
        self.helped, self.share = helped, 0.0
        if self._swung is None or not (swinging := helped & (self._swung >= SWINGS)).any():
            return
        self.swinging, self._whole = swinging, np.where(swinging, whole, 0.0)
        square = float((self._whole**2).sum())
        self.share = float((self._whole * self.targets).sum()) / square if square > 0 else 0.0

    def stop_asking(self, active: Array) -> bool:
        """Sets c_t = 0 for all active pairs, for good; whether it was not."""
        if not self.targets[:, active].any():
            return False
        self._take_out(active)
        self.share, self.swinging = 0.0, None
        return True

    def asks_less(self, active: Array, friction: Array, slip: Array, negligible: float, response: Response) -> bool:
        """Whether active pairs are asked for something else than before, as friction helps, or may stop more.

        Args:
            active: (C,) which.
            friction: theirs, (k, C), N.
            slip: u_t = v̂_t - w_t - c_t (k, C), m/s.
            negligible: power that is none, W.
            response: of these.
        """
        c = self.targets.take(active, axis=1)
        if self.helped is None and not float(friction.ravel().dot(c.ravel())) > negligible:
            return False  # with what is left of the velocities it never does
        moves = slip + c
        work = (friction * moves).sum(axis=0)
        power = float(work.sum())
        if power > negligible and self.share in (0.0, 1.0):
            helps = active[(work > negligible) & c.any(axis=0)]  # each but once: at c_t = 0 what is left is round-off
            if len(helps):
                self._take_out(helps)
                self.share = 0.0
                return True
        if self.swinging is None:
            return False
        share = self._next(active, friction, moves, power, negligible, response)
        if share == self.share:
            return False
        self.targets = self.targets + (share - self.share) * self._whole
        self.share = share
        return True

    def _take_out(self, pairs: Array) -> None:
        """Asks pairs for nothing."""
        if self.helped is None:
            self.helped, self._whole = np.zeros(self.targets.shape[1], dtype=bool), np.zeros(self.targets.shape)
        self.helped[pairs] = True
        if self._swung is not None:
            swinging = pairs[self._swung[pairs] >= SWINGS]
            if len(swinging):
                self._whole[:, swinging] = self.targets[:, swinging]
                self.swinging = self.helped & (self._swung >= SWINGS)
        self.targets[:, pairs] = 0.0

    def _next(
        self, active: Array, friction: Array, moves: Array, power: float, negligible: float, response: Response
    ) -> float:
        """The share that is to be looked at next; the same: it stays. `moves` is v̂_t - w_t (k, C)."""
        share, whole, pairs = self.share, self._whole.take(active, axis=1), active.tobytes()
        if pairs != self._known:  # what was known of shares is not right for others
            begins, self._known, self._below, self._above = not self._known, pairs, 0.0, 1.0
            if share > 0 and not begins:
                return 0.0
        enough = max(negligible, NEARLY_NONE * float(np.abs(friction * whole).sum()))
        if power > negligible:
            self._above = share
        else:
            self._below = share
            if self._left == 0 or (share > 0 and power >= -enough):
                return share
        if self._left == 0:
            return self._below if self._below < share else 0.0
        self._left -= 1
        try:
            by_friction, by_slip = response(whole)
        except np.linalg.LinAlgError:
            return (self._below + self._above) / 2
        by_slip = by_slip + whole
        slope = float((by_friction * moves).sum() + (friction * by_slip).sum())
        root = share + root_of(float((by_friction * by_slip).sum()), slope, power + min(enough / 2, AIMED * negligible))
        if self._below + LEAST_SHARE < root < self._above:
            return root
        if share == 0 and power >= -negligible and slope >= 0:
            return 0.0  # a little would be too much
        return (self._below + self._above) / 2


def swung_with(helped: Array, swung: Array) -> Array:
    """In how many steps in a row pairs were not stopped, from those that were not in the last one, and before it."""
    return np.where(helped, np.minimum(swung, SWINGS) + 1, 0)


def root_of(a: float, b: float, c: float) -> float:
    """Where a x² + b x + c, of c <= 0, becomes positive; infinite where it does not."""
    square = b * b - 4 * a * c
    if square < 0 or (a == 0 and b <= 0):
        return math.inf
    root = math.sqrt(square)
    return -2 * c / (b + root) if b > 0 else (root - b) / (2 * a)
