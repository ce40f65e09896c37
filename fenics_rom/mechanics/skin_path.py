"""What happens to a skin between two looks: where the body and what may get into it were on the way.

A look is due where something may have moved far enough since the last one to go in, or in and out again, unseen: by
what was between them, or by a share of the radius of the balls that it holds. What moves farther than that in one step
is looked at in places between, on the straight line.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.skin import Intruder, Skin

STRIDE = 0.5  # of its inner radius: so far something goes between two looks, if it is near
CHECK_INTERVAL = 4  # steps: how often it is asked who moved far
QUICK = 4  # times as many compiled steps pass between two looks: bodies are looked at on their way between these
MOST_PLACES = 256  # between two looks: what needs more goes hundreds of its diameters in a step
_ONES = np.ones(3)


class Placement:
    """Where a skin is at an instant.

    Args:
        few: those of its nodes that are looked at first, (f, 3), m.
        whole: asked where all of its nodes are, (V, 3), m, if it has to be known.

    Attributes:
        few: as given.
    """

    def __init__(self, few: Array, whole: Callable[[], Array]):
        self.few, self._whole = few, whole
        self._known: Array | None = None

    def whole(self) -> Array:
        """Of all nodes, (V, 3), m."""
        if self._known is None:
            self._known = self._whole()
        return self._known

    def after(self, before: "Placement", share: float) -> "Placement":
        """Where it was after a share of the way from before to here."""
        few = before.few + share * (self.few - before.few)
        return Placement(few, lambda: before.whole() + share * (self.whole() - before.whole()))


class Instant(NamedTuple):
    """Where a skin and those are that may get into it."""

    body: Placement
    intruders: Mapping[str, Intruder]


def stride_of(skin: Skin, intruder: Intruder) -> float:
    """How far something may go between two looks, if it is near, m."""
    return STRIDE * min(intruder.core[0], skin.extent)


def on_the_way(skin: Skin, who: str, before: Instant | None, now: Instant) -> Iterator[tuple[Placement, Intruder]]:
    """Where the skin and someone were between two instants, in strides, and where they are now."""
    intruder = now.intruders[who]
    if before is not None and who in before.intruders:
        start = before.intruders[who]
        places = _strides(stride_of(skin, intruder), before.body, now.body, start, intruder)
        for number in range(1, places):
            share = number / places
            yield now.body.after(before.body, share), intruder.after(start, share)
    yield now.body, intruder


def moved_between(before: Instant, now: Instant) -> float:
    """How far nodes that are looked at first and others went between two instants, together, at most, m."""
    others = [now.intruders[who].moved(start) for who, start in before.intruders.items() if who in now.intruders]
    return _farthest(now.body.few - before.body.few) + max(others, default=0.0)


def _farthest(ways: Array) -> float:
    return math.sqrt(float(np.square(ways).dot(_ONES).max(initial=0.0)))


def _strides(stride: float, before: Placement, now: Placement, start: Intruder, end: Intruder) -> int:
    """In how many the balls of an intruder went past the nodes that are looked at first, at least one."""
    moved = now.few - before.few
    own = end.core[1] - start.core[1]
    if len(own):
        moved = (moved[:, None] - own).reshape(-1, 3)
    strides = _farthest(moved) / stride
    return max(1, math.ceil(strides)) if strides < MOST_PLACES else MOST_PLACES  # also of what is not a number
