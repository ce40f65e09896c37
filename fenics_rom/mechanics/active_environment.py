"""What acts on a body by itself in a run: loads with signals of their own, and obstacles; the same at any order."""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import ArrayLike

from fenics_rom.errors import SceneError, StepError, unknown
from fenics_rom.mechanics.signals import Signal
from fenics_rom.scene.scene import Scene

Array = np.ndarray
SignalLike = Signal | ArrayLike | Callable[[float], ArrayLike]  # a value, or a function of time in s


def load_columns(scene: Scene) -> dict[str, int]:
    """Number of columns of each load that acts by a history of its own, in the order of the input."""
    return {name: load.columns for name, load in scene.environment.loads.items()}


class _Value:
    """A quantity of some numbers that is constant or a function of time.

    Args:
        where: its name in messages.
        width: how many numbers.
        history: numbers, or a function of time.
    """

    def __init__(self, where: str, width: int, history: SignalLike):
        self._where, self._width = where, width
        if isinstance(history, Signal) and history.times is None:
            history = history.values
        self._function = history if callable(history) else None
        self._constant = np.empty(0) if callable(history) else self._checked(history)

    @property
    def changes(self) -> bool:
        """Whether it is a function of time."""
        return self._function is not None

    def at(self, time: float) -> Array:
        """The numbers at a time, s."""
        return self._constant if self._function is None else self._checked(self._function(time))

    def _checked(self, value: ArrayLike) -> Array:
        try:
            numbers = np.array(value, dtype=float).reshape(-1)
        except (TypeError, ValueError):
            numbers = np.empty(0)
        if len(numbers) != self._width or not np.isfinite(numbers).all():
            allowed = "a finite number" if self._width == 1 else f"{self._width} finite numbers"
            raise StepError(f"{self._where} = {value!r}: allowed is {allowed}, or a function of time that gives it")
        return numbers


class ActiveEnvironment:
    """The loads and obstacles of a scene.

    Args:
        scene: whose effects act.
        columns: number of columns of each load that the model has; None: those of the scene.
        signals: for loads and obstacles by name, instead of what the scene says: numbers or functions of time (s).
            Of gravity: multiples of its acceleration; of a base motion: m/s²; of a prescribed force: N (3,); of an
            obstacle: its displacement, m (3,).

    Attributes:
        columns: number of columns of each load.
        quasi_static: whether every step is an equilibrium.
        obstacles: by name.
        offsets: where the obstacles are, as displacements from where the scene puts them, (O, 3), m.
        ahead: where they will be at the end of the step that is being taken.
        velocities: theirs in the last step, (O, 3), m/s.
        signals: by name, those that were given.
        law: of contact; None where the scene names none.
        automatic: whether the contact mode follows the obstacles.
        lap: told the name of each part of a step that has just ended, to measure what it cost; None: nobody asks.

    Raises:
        SceneError: a load without a history, or a history of something that is not there.
        StepError: a history of the wrong width, or not finite.
    """

    def __init__(
        self,
        scene: Scene,
        columns: Mapping[str, int] | None = None,
        signals: Mapping[str, SignalLike] | None = None,
    ):
        environment = scene.environment
        self.columns = load_columns(scene) if columns is None else dict(columns)
        self.lap: Callable[[str], None] | None = None
        self.quasi_static = scene.effects.inertia is None
        self.law, self.automatic = environment.contact_law, environment.switches_itself
        self.obstacles = {name: moving.shape for name, moving in environment.obstacles.items()}
        said: dict[str, SignalLike | None] = {name: load.signal for name, load in environment.loads.items()}
        said |= {name: moving.displacement for name, moving in environment.obstacles.items()}
        for name in signals or {}:
            if name not in said:
                raise SceneError(f"{scene.source}: {unknown('load or obstacle', name, said)}")
        histories: dict[str, SignalLike] = {}
        for name, history in (said | dict(signals or {})).items():
            if history is None:
                raise SceneError(
                    f"{scene.source}: {name!r} has neither a value nor a table; give a function of time in Python: "
                    f"signals = {{{name!r}: lambda t: ...}}"
                )
            histories[name] = history
        self.signals: dict[str, SignalLike] = dict(signals or {})
        self._values = {name: _Value(name, self.columns.get(name, 3), history) for name, history in histories.items()}
        self._steady: Array | None = None
        self._still: Array | None = None
        self._keep_constants()
        self.begin()

    def set(self, name: str, history: SignalLike) -> None:
        """Gives a load or an obstacle another value, or another function of time, from the next step on.

        Raises:
            StepError: there is no such load or obstacle, or the value has another width or is not finite.
        """
        width = self.columns.get(name, 3)
        if name not in self.columns and name not in self.obstacles:
            raise StepError(unknown("load or obstacle", name, [*self.columns, *self.obstacles]))
        self._values[name] = _Value(name, width, history)
        self.signals[name] = history
        self._keep_constants()

    def loads(self, time: float) -> Array:
        """The values of all loads at a time (s), in the order of their columns."""
        if self._steady is not None and self.lap is None:
            return self._steady
        values = [np.empty(0)]
        for name, width in self.columns.items():
            values.append(self._values[name].at(time) if name in self._values else np.zeros(width))
            if self.lap is not None:
                self.lap(name)
        return np.concatenate(values)

    def offsets_at(self, time: float) -> Array:
        """Displacements of the obstacles at a time (s), (O, 3), m."""
        if self._still is not None:
            return self._still
        return np.array([self._values[name].at(time) for name in self.obstacles]).reshape(-1, 3)

    def begin(self) -> None:
        """Puts the obstacles where they are at time 0, at rest."""
        self.offsets = self.ahead = self.offsets_at(0.0)
        self.velocities = np.zeros_like(self.offsets)

    def arrive(self, dt: float) -> None:
        """Ends a step of dt, s, that was taken: the obstacles are where they were to be."""
        self.velocities = (self.ahead - self.offsets) / dt
        self.offsets = self.ahead

    def _keep_constants(self) -> None:
        """What does not depend on time is put together once."""
        self._steady = self._still = None
        if not any(self._values[name].changes for name in self.columns if name in self._values):
            self._steady = self.loads(0.0)
        if not any(self._values[name].changes for name in self.obstacles):
            self._still = self.offsets_at(0.0)


REACH = 0.05  # of the size of the contact surfaces: an obstacle that far away begins to matter
CLOSER = 1e-3  # of it: by so much another contact mode must be closer, so that two do not take turns


class ContactPoints:
    """All nodes that obstacles can touch, and which contact mode is the one that is touched.

    Args:
        points_of: nodes (P_i,) of each contact mode.
        places: of all nodes at rest, (N, 3), m.

    Attributes:
        nodes: (P,) ascending, each once.
        places: theirs at rest, (P, 3), m.
    """

    def __init__(self, points_of: Mapping[str, Array], places: Array):
        self.nodes = np.unique(np.concatenate(list(points_of.values())))
        self.places = places[self.nodes]
        self._size = float(np.linalg.norm(np.ptp(self.places, axis=0)))
        self._names = list(points_of)
        self._members = [np.searchsorted(self.nodes, points) for points in points_of.values()]

    def nearest(self, gaps: Array, active: str) -> str:
        """The contact mode to be in, from the smallest gap of each point (P,), m, and the one that is active."""
        closest = [gaps[members].min(initial=np.inf) for members in self._members]
        best = int(np.argmin(closest))
        near = closest[best] < REACH * self._size
        closer = closest[best] < closest[self._names.index(active)] - CLOSER * self._size
        return self._names[best] if near and closer else active
