"""A Simulator in step with the wall clock."""

import math
import time
from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy import ndarray as Array

from fenics_rom.arguments import check_function, is_number
from fenics_rom.errors import StepError, shown
from fenics_rom.runtime.simulator import Simulator

SPIN_TIME = 2e-4  # s before a due time, from which on a sleep could end too late


@dataclass(frozen=True)
class RealTime:
    """How a run in real time went. A step's time is that of its control and of the step itself, not of the waiting.

    Attributes:
        steps: how many were taken.
        missed: how many ended after their deadline.
        median: time of a step, s; this and the next two are NaN where no step was taken.
        p999: 99.9 % of the steps take no longer, s.
        worst: the longest step, s.
        lateness: the most by which a step ended after its deadline, s.
        simulated: time simulated, s.
        seconds: time by the wall clock, s.
    """

    steps: int
    missed: int
    median: float
    p999: float
    worst: float
    lateness: float
    simulated: float
    seconds: float

    def __str__(self) -> str:
        if not self.steps:
            return "0 steps"
        return (
            f"{self.steps} steps of {_format_time(self.simulated / self.steps)}: {self.missed} missed; a step takes "
            f"{_format_time(self.median)} (median), {_format_time(self.p999)} (99.9 %), "
            f"{_format_time(self.worst)} (worst)"
        )


def run_realtime(
    simulator: Simulator, control: Callable[[Simulator], Sequence[float] | Array | None], duration: float
) -> RealTime:
    """Takes each step when the wall clock gets to the time it starts from; its deadline is the time it leads to.

    After a missed deadline steps follow without waiting, and may miss theirs, until the wall clock is caught up with.
    What control or a step raises ends the run; the simulator is left as it was then.

    Args:
        simulator: stepped from where it is.
        control: called when a step is due; gives its input, (p,) N, or None to end the run. It may switch the contact
            and set dt, of this step and those that follow.
        duration: time to simulate, s, to the nearest step.

    Raises:
        StepError: no simulator, no function, or a duration that is no finite number > 0; or see Simulator.step.

    Example:
        >>> body = fr.Simulator(rom, dt=1e-3)
        >>> print(fr.run_realtime(body, lambda body: [0.0, 0.0, 0.5], duration=0.01))
        10 steps of 1 ms: ...
    """
    if not isinstance(simulator, Simulator):
        raise StepError(f"run_realtime: {shown(simulator)} was given; use a Simulator")
    check_function("control", control, StepError, "of the simulator, which gives its inputs")
    if not (is_number(duration) and duration > 0):
        raise StepError(f"duration = {shown(duration)}: use a finite number > 0, in s")
    times = array("d")
    missed, lateness, simulated = 0, 0.0, 0.0
    start = time.perf_counter()
    while True:
        _wait_until(start + simulated)
        if simulated > duration - simulator.dt / 2:
            break
        begin = time.perf_counter()
        u = control(simulator)
        if u is None:
            break
        simulator.step(u)
        end = time.perf_counter()
        times.append(end - begin)
        simulated += simulator.dt
        late = end - (start + simulated)
        missed += late > 0
        lateness = max(lateness, late)
    seconds = time.perf_counter() - start
    median, p999, worst = np.quantile(times or [math.nan], (0.5, 0.999, 1.0)).tolist()
    return RealTime(len(times), missed, median, p999, worst, lateness, simulated, seconds)


def _wait_until(due: float) -> None:
    sleep = due - time.perf_counter() - SPIN_TIME
    if sleep > 0:
        time.sleep(sleep)
    while time.perf_counter() < due:
        pass


def _format_time(seconds: float) -> str:
    rounded = float(f"{seconds:.3g}")  # first: 999.9 µs are 1 ms
    unit, size = ("s", 1.0) if rounded >= 1.0 else ("ms", 1e-3) if rounded >= 1e-3 else ("µs", 1e-6)
    return f"{rounded / size:.3g} {unit}"
