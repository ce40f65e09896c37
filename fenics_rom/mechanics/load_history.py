"""What acts when: the contact mode and the input of every step of a run, the same for full and reduced models."""

import math
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Mapping
from itertools import repeat

import numpy as np

from fenics_rom.arguments import is_number
from fenics_rom.errors import SceneError, exactly, shown, unknown
from fenics_rom.mechanics.environment import AppliedLoad, Environment
from fenics_rom.mechanics.signals import Signal

MOST_STEPS = 10**7  # a record holds some 100 bytes of each
WHOLE = 1e-6  # share of its steps that a run may miss a whole number of them by


def check_width(load: AppliedLoad, columns: int, where: str) -> None:
    """A SceneError where a load has not one number for each column of what it acts on."""
    if load.signal.width != columns:
        raise SceneError(f"{where}: use {columns} number{'s' * (columns > 1)} in its force (got {load.signal.width})")


def check_pull(signal: Signal, where: str) -> None:
    """A SceneError where the tension of a cable is negative."""
    if (least := float(signal.values.min(initial=0.0))) < 0:
        raise SceneError(
            f"{where}: a tension of {least:g} N: a cable pulls and cannot push; use at least 0 (a tendon on the "
            "other side pulls the other way)"
        )


def count_steps(duration: float, dt: float, every: int) -> int:
    """How many steps of dt, s, a run takes; SceneError where it takes none, or cannot be kept every so many."""
    if not (is_number(dt) and 0 < dt <= duration):
        raise SceneError(f"dt = {shown(dt)}: use more than 0 and at most the duration, {exactly(duration)} s")
    steps = duration / dt
    if steps > MOST_STEPS:
        raise SceneError(f"dt = {float(dt):g}: a run of {steps:.3g} steps; use at most {MOST_STEPS:,}")
    if not (is_number(every, whole=True) and 1 <= every <= MOST_STEPS):
        raise SceneError(f"every = {shown(every)}: use a whole number of steps, from 1 to {MOST_STEPS:,}")
    return round(steps)


def is_whole(duration: float, dt: float) -> bool:
    """Whether a duration, s, is a whole number of steps of dt, s, but for digits that nobody writes."""
    steps = duration / dt
    return abs(steps - round(steps)) <= WHOLE * steps


def ending_elsewhere(duration: float, dt: float) -> tuple[str, ...]:
    """What to say of a run that ends at another time than its duration, s, as that is no number of steps of dt, s."""
    if is_whole(duration, dt):
        return ()
    steps = round(duration / dt)
    return (
        f"the run ends at {steps * dt:.9g} s, after {steps} steps of {exactly(dt)} s, and not at {exactly(duration)} s "
        f"as its scene says; with dt = {duration / math.ceil(duration / dt):.9g} s it ends there",
    )


def _parts_of(names: Iterable[str], columns: Mapping[str, int]) -> dict[str, slice]:
    """Where the inputs of contact modes are, one after another."""
    ends = np.cumsum([0, *(columns[name] for name in names)]).tolist()
    return {name: slice(*ends[k : k + 2]) for k, name in enumerate(names)}


class LoadHistory:
    """The inputs of a run, sampled at the middle of each step (as the midpoint rule wants them).

    Args:
        environment: with a run.
        contact_columns, actuator_columns: how many each contact mode and actuator has, in the order of the input.
        dt: time step instead of the run's, s.
        every: instants are kept after every so many steps, instead of the run's.

    Attributes:
        dt: time step, s.
        steps: number of steps.
        every: instants are kept after every so many steps.
        automatic: whether the contact mode follows the obstacles; inputs are then the actuators' alone.
        warnings: that it ends at another time than the run's duration.

    Raises:
        SceneError: no run, a force that does not fit the columns, or one that no step would see.
    """

    def __init__(
        self,
        environment: Environment,
        contact_columns: Mapping[str, int],
        actuator_columns: Mapping[str, int],
        dt: float | None = None,
        every: int | None = None,
    ):
        run, source = environment.run, environment.source
        if run is None:
            raise SceneError(
                f"{source}: has no [run], so there is no load history to simulate; add one, with its dt and duration"
            )
        self.dt = run.dt if dt is None else dt
        self.every = run.every if every is None else every
        self.steps = count_steps(run.duration, self.dt, self.every)
        self.dt, self.every = float(self.dt), int(self.every)
        self.warnings = ending_elsewhere(run.duration, self.dt)
        self.automatic = environment.switches_itself
        self._loads, self._contact_columns = run.loads, dict(contact_columns)
        self._parts = {name: _parts_of((name,), contact_columns) for name in contact_columns}
        for name, parts in environment.together.items():
            self._parts[name] = _parts_of(parts, contact_columns) | self._parts[name]
        starts = dict(zip(actuator_columns, np.cumsum([0, *actuator_columns.values()]), strict=False))
        self._actuator_slice = {name: slice(a, a + actuator_columns[name]) for name, a in starts.items()}
        self._actuator_total = sum(actuator_columns.values())
        self._strokes = environment.controls
        for load in self._loads:
            self._check(load, contact_columns if load.contact else actuator_columns, f"{source}: run.load")
            if load.actuator is not None and environment.is_pulled(load.actuator):
                check_pull(load.signal, f"{source}: run.load: actuator {load.actuator!r}")

    def _check(self, load: AppliedLoad, columns: Mapping[str, int], place: str) -> None:
        """Checks that a load fits the columns of what it acts on, and that some step sees it."""
        kind, name = ("contact mode", load.contact) if load.contact else ("actuator", str(load.actuator))
        if name not in columns:  # the run of one scene on the model of another
            raise SceneError(f"{place}: the model has {unknown(kind, name, columns)}")
        check_width(load, columns[name], f"{place}: {kind} {name!r}")
        first = max(0, int(load.start / self.dt) - 1)
        if not any(load.start <= self._middle(k) < load.stop for k in range(first, min(first + 4, self.steps))):
            raise SceneError(
                f"{place}: the force from {load.start:g} to {load.stop:g} s acts in the middle of no step "
                f"of {self.dt:g} s, so the run would not see it; use a smaller dt, or a longer force"
            )

    def _middle(self, step: int) -> float:
        return (step + 0.5) * self.dt

    def first_contact(self) -> str:
        """Contact mode that the run begins in."""
        pushes = [load for load in self._loads if load.contact is not None]
        first = {str(load.contact) for load in pushes if load.start == pushes[0].start}
        return self._holding(first, "") if first else next(iter(self._contact_columns))

    def _holding(self, pushed: set[str], last: str) -> str:
        """The contact mode in which all of some are pushed: the last one if that has them all, else the smallest."""
        if pushed <= self._parts.get(last, {}).keys():
            return last
        holding = (name for name, parts in self._parts.items() if pushed <= parts.keys())
        return min(holding, key=self._contact_columns.__getitem__)

    def __iter__(self) -> Iterator[tuple[str, np.ndarray]]:
        """Contact mode and input (contact columns, then actuator columns; N, or m and m³ of strokes) of each step.

        A contact mode stays until another one's force begins, so a body is released in the mode it was pushed in.
        """
        contact, step = self.first_contact(), 0
        while step < self.steps:
            contact, u = self.at(self._middle(step), contact, self.dt / 2)
            stop = self._lasts_until(step)
            yield from repeat((contact, u), stop - step)
            step = stop

    def _lasts_until(self, step: int) -> int:
        """The first step after this one in which something else may act."""
        time = self._middle(step)
        if any(load.start <= time < load.stop and load.signal.times is not None for load in self._loads):
            return step + 1
        change = min((t for load in self._loads for t in (load.start, load.stop) if t > time), default=math.inf)
        return bisect_left(range(self.steps), change, lo=step + 1, key=self._middle)

    def at(self, time: float, contact: str, to_end: float = 0.0) -> tuple[str, np.ndarray]:
        """Contact mode and input at a time, s, if before it the contact mode was another.

        Forces are those of the middle of a step, strokes those of its end, which is later by `to_end`.
        """
        active = [load for load in self._loads if load.start <= time < load.stop]
        contact = self._holding({load.contact for load in active if load.contact is not None}, contact)
        columns = 0 if self.automatic else self._contact_columns[contact]
        u = np.zeros(columns + self._actuator_total)
        for load in active:
            if load.contact is not None:
                u[:columns][self._parts[contact][load.contact]] += load.signal(time)
            else:
                late = to_end if load.actuator in self._strokes else 0.0
                u[columns:][self._actuator_slice[str(load.actuator)]] += load.signal(time + late)
        return contact, u
