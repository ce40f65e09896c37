"""What a long piece of work spent its time and memory on, stage by stage."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from fenics_rom.io.progress import Report, silent


@dataclass(frozen=True)
class Stage:
    """One stage of the offline work.

    Attributes:
        name: what was done.
        seconds: wall-clock time, stages within it not counted.
        peak_memory: largest memory that a rank had ever held when the stage ended, bytes.
    """

    name: str
    seconds: float
    peak_memory: float


class Stages:
    """A stopwatch for stages that may interrupt one another; each second is counted once.

    Args:
        largest: the largest of a number over all ranks.
        earlier: stages already done.
        report: called with the stage, how much of it is done, and of how much.
    """

    def __init__(
        self,
        largest: Callable[[float], float] = lambda value: value,
        earlier: tuple[Stage, ...] = (),
        report: Report = silent,
    ):
        self.report = report
        self._largest = largest
        self._done = {stage.name: stage for stage in earlier}
        self._running: list[tuple[str, float]] = []

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Times what is done in the `with` block; the stage around it waits."""
        self._lap()
        self._running.append((name, time.perf_counter()))
        try:
            yield
        except BaseException:  # perhaps of this rank alone, so that nothing may be asked of the others
            self._running.pop()
            raise
        self._lap()
        self._running.pop()

    @property
    def done(self) -> tuple[Stage, ...]:
        """All stages in the order they began."""
        return tuple(self._done.values())

    def _lap(self) -> None:
        """Books the time since the last change of stage to the stage that runs."""
        now = time.perf_counter()
        if self._running:
            name, start = self._running[-1]
            before = self._done[name].seconds if name in self._done else 0.0
            self._done[name] = Stage(name, before + now - start, self._largest(peak_memory()))
            self._running = [(running, now) for running, _ in self._running]


def peak_memory() -> float:
    """Largest memory this process has held so far, bytes; 0 on Windows, which the runtime works on, too."""
    try:
        import resource
    except ModuleNotFoundError:
        return 0.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1.0 if sys.platform == "darwin" else 1024.0)
