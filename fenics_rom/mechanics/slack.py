"""Where membranes and cables of a body push: threads and cloth would go slack there, which the model does not."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

from numpy import ndarray as Array

TOLD_SHARE = 0.01  # of the largest force in a membrane or cable: what pushes with less is not told


class Push(NamedTuple):
    """How hard a membrane or a cable pushes."""

    force: float  # of its points the most, N/m or N
    share: float  # of its area or length that pushes with more than TOLD_SHARE of the largest force
    place: Array  # of that point at rest (3,), m
    time: float  # s


class SlackWatch:
    """Keeps how hard each membrane and cable pushed at most.

    Args:
        pushes: as of `system.protocols.Embedded`.
    """

    def __init__(self, pushes: Callable[[Array, float], Mapping[str, Push]]):
        self._pushes, self._most = pushes, dict[str, Push]()

    def look(self, displacement: Array, time: float = 0.0) -> None:
        """Where nodes are displaced by (N, 3), m, at a time, s."""
        for name, push in self._pushes(displacement, time).items():
            if name not in self._most or push.force > self._most[name].force:
                self._most[name] = push

    def messages(self, *, in_training: bool = False) -> list[str]:
        """What to say of a run, or of a training."""
        told = []
        for name, (force, share, place, time) in self._most.items():
            of, unit = ("length", "N") if ".cables." in name else ("area", "N/m")
            when = "in training" if in_training else f"at t = {time:.4g} s"
            told.append(
                f"{name}: {100 * share:.3g} % of its {of} push by up to {force:.3g} {unit} (near "
                f"{place.round(6).tolist()}, {when}): threads and cloth go slack there, and this model does not"
            )
        return told
