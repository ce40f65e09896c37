"""An environment in a run: what its loads are at a time, and where its obstacles are; the same at any order."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError, StepError, check_known
from fenics_rom.mechanics.base_fit import misfit_message
from fenics_rom.mechanics.base_path import BASE_PATH, BasePath, BaseState, given_base
from fenics_rom.mechanics.contact import ObstacleMotion, is_zero
from fenics_rom.mechanics.environment import Environment, MovingObstacle
from fenics_rom.mechanics.obstacle_poses import PoseSignal, pose_row, state_of, with_turns
from fenics_rom.mechanics.signals import CheckedSignal, SignalLike
from fenics_rom.mechanics.step import StepInput

if TYPE_CHECKING:
    from fenics_rom.mechanics.obstacles import Obstacle


class ObstacleState(NamedTuple):
    """Where the obstacles are."""

    offsets: Array  # displacements from where the scene puts them, (O, 3), m; or poses, see `obstacle_poses`
    velocities: Array  # in the last step, (O, 3), m/s; of poses with angular velocities, (O, 6)


class ActiveEnvironment:
    """The loads and obstacles of an environment, driven by their signals.

    Args:
        environment: what acts.
        columns: number of columns of each load that the model has; None: those of the environment.
        signals: for loads and obstacles by name, instead of the environment's: numbers or functions of time (s).
            Of gravity: multiples of its acceleration; of a base motion: m/s²; of a prescribed force: N (3,); of an
            obstacle: its displacement, m (3,). Of an obstacle with a motion, and of "base_path": a BaseState, a
            BasePath or a function of time.

    Attributes:
        environment, columns: as given.
        obstacles: their shapes, by name.
        state: where the obstacles are.
        loads: their values in the last step, in the order of their columns.
        signals: by name, those that were given.
        mark: told the name of each part of a step that has just ended, to measure what it cost; None: nobody asks.

    Raises:
        SceneError: a load without a signal, or a signal of something that is not there.
        StepError: a signal of the wrong width, or not finite.
    """

    _unchanged: tuple[Array | None, ObstacleState | None, StepInput]  # a step's input, of what it was made

    def __init__(
        self,
        environment: Environment,
        columns: Mapping[str, int] | None = None,
        signals: Mapping[str, SignalLike] | None = None,
    ):
        self.environment = environment
        self.columns = {name: load.columns for name, load in environment.loads.items()} if columns is None else columns
        self.obstacles = {name: obstacle.shape for name, obstacle in environment.obstacles.items()}
        self.mark: Callable[[str], None] | None = None
        self._still: ObstacleMotion | None = None  # as long as obstacles stay where they are
        self.signals: dict[str, SignalLike] = dict(signals or {})
        defined: dict[str, SignalLike | None] = {name: load.signal for name, load in environment.loads.items()}
        defined |= {name: of.displacement for name, of in environment.obstacles.items() if of.motion is None}
        self._motions = {name: of.motion for name, of in environment.obstacles.items() if of.motion is not None}
        moved = {name: motion.path for name, motion in self._motions.items()}
        self._bases = (BASE_PATH,) if environment.is_moving else ()
        for name in self.signals:
            known = (*self.columns, *self.obstacles, *self._bases)
            check_known("load or obstacle", name, known, SceneError, f"{environment.source}: ")
        base = self.signals.get(BASE_PATH, environment.base_path)
        self._base = None if base is None else given_base(base)
        self._signals: dict[str, CheckedSignal | PoseSignal] = {}
        for name, signal in (defined | moved | self.signals).items():
            if name == BASE_PATH:
                continue
            if signal is None:
                has = "no table" if name in moved else "neither a value nor a table"
                raise SceneError(
                    f"{environment.source}: {name!r} has {has}; give a function of time in "
                    f"Python: signals = {{{name!r}: lambda t: ...}}"
                )
            self._signals[name] = self._checked(name, signal)
        self._keep_constants()
        self.reset()

    def set_signal(self, name: str, signal: SignalLike) -> None:
        """Gives a load or an obstacle another value, or another function of time, from the next step on.

        Raises:
            StepError: there is no such load or obstacle, or the value has another width or is not finite.
        """
        check_known("load or obstacle", name, [*self.columns, *self.obstacles, *self._bases], StepError)
        if name == BASE_PATH:
            self._base = given_base(signal)
        else:
            self._signals[name] = self._checked(name, signal)
        self.signals[name] = signal
        self._keep_constants()

    def _checked(self, name: str, signal: "SignalLike") -> CheckedSignal | PoseSignal:
        """The signal of a load or an obstacle; StepError where it is none."""
        motion = self._motions.get(name)
        if motion is not None:
            return PoseSignal(name, motion.origin, signal)
        if name in self.obstacles and isinstance(signal, BaseState | BasePath):
            raise StepError(
                f"{name}: poses are given, but the scene gives this obstacle no motion: use displacements, m "
                f"(3,); or name effects.contact.obstacles.{name}.motion in the scene"
            )
        return CheckedSignal(name, self.columns.get(name, 3), signal)

    @property
    def is_still(self) -> bool:
        """Whether nothing acts by itself on a body with inertia."""
        acting = self.environment
        found = acting.contact_law is not None or acting.finds_forces
        return acting.has_inertia and not (self.columns or found or self._base)

    @property
    def stands_still(self) -> bool:
        """Whether obstacles stayed where they are in the last step, and will until a signal is set."""
        return self._still is not None and not self.environment.turns_obstacles

    def stroke_names(self, actuators: Collection[str]) -> tuple[str, ...]:
        """Those of the actuators whose strokes are given."""
        return tuple(name for name in actuators if name in self.environment.controls)

    def reset(self) -> None:
        """Puts the obstacles where they are at time 0, at rest."""
        offsets = self.offsets_at(0.0)
        self.state = ObstacleState(offsets, np.zeros((len(offsets), 6 if self.environment.turns_obstacles else 3)))
        self.loads = np.zeros(sum(self.columns.values()))
        self._misfits: dict[str, tuple[float, float]] = {}  # m and rad, at most in a step

    @property
    def has_constant_loads(self) -> bool:
        """Whether loads are the same at all times, until a signal is set."""
        return self._constant_loads is not None

    def loads_at(self, time: float) -> Array:
        """The values of all loads at a time (s), in the order of their columns."""
        if self._constant_loads is not None and self.mark is None:
            return self._constant_loads
        values = list[Array]()
        for name, width in self.columns.items():
            values.append(self._signals[name].at(time) if name in self._signals else np.zeros(width))
            if self.mark is not None:
                self.mark(name)
        return np.concatenate(values) if values else np.empty(0)

    def amplitudes_at(self, time: float) -> dict[str, float]:
        """Of temperatures that the model has at a time, s, by name."""
        names, starts = self.environment.temperatures, np.cumsum([0, *self.columns.values()])
        if not names:
            return {}
        loads, places = self.loads_at(time), dict(zip(self.columns, starts.tolist(), strict=False))
        return {name: float(loads[places[name]]) for name in names if name in places}

    def base_at(self, time: float) -> BaseState | None:
        """The rigid base at a time, s; None where nothing says how it moves."""
        return None if self._base is None else self._base(time)

    def bases_at(self, times: Array) -> Array | None:
        """The same at times (n,), in rows of 13 numbers."""
        if self._base is None:
            return None
        if isinstance(self._base, BasePath):
            return np.hstack(self._base.along(times))
        return np.array([np.concatenate(self._base(time)) for time in times.tolist()]).reshape(-1, 13)

    def offsets_at(self, time: float) -> Array:
        """Displacements of the obstacles at a time (s), (O, 3), m; or poses, (O, 7)."""
        if self._constant_offsets is not None:
            return self._constant_offsets
        rows = [self._signals[name].at(time) for name in self.obstacles]
        return np.array(with_turns(rows)) if rows else np.empty((0, 3))

    def resting_signal(self, name: str, row: Array) -> Any:
        """The signal of an obstacle that stays at a displacement or a pose, which a row of `offsets_at` says."""
        motion = self._motions.get(name)
        return row[:3].copy() if motion is None else state_of(row, np.array(motion.origin))

    def frozen_at(self, time: float) -> tuple[Environment, dict[str, Any]]:
        """What acts at a time, s, for ever, on a body without inertia: an environment, and signals for it."""
        law = self.environment.contact_law
        still = None if law is None else replace(law, restitution=0.0)
        ends = np.cumsum([0, *self.columns.values()])
        loads = zip(self.columns, np.split(self.loads_at(time), ends[1:-1]), strict=False)
        signals: dict[str, Any] = {name: values for name, values in loads if name in self._signals}
        for name, row in zip(self.obstacles, self.offsets_at(time), strict=True):
            signals[name] = self.resting_signal(name, row)
        return replace(self.environment, has_inertia=False, contact_law=still), signals

    def step_input(self, u: Array, time: float, dt: float) -> StepInput:
        """All that acts in the step of dt, s, that begins at a time, s, with u for contact columns and actuators.

        Raises:
            StepError: a signal gave something else than finite numbers.
        """
        u_before, state, known = self._unchanged
        if u is u_before and state is self.state and self.mark is None:
            return known
        loads = self.loads_at(time + dt / 2 if self.environment.has_inertia else time + dt)
        motion = None
        if self.environment.contact_law is not None:
            motion, (start, before) = self._still, self.state
            if motion is None or motion.start is not start or motion.velocities_before is not before:
                self._note_misfits(time, dt)
                motion = ObstacleMotion(start, self.offsets_at(time + dt), before)
                is_still = self._constant_offsets is not None and motion.end is motion.start
                self._still = motion if is_still and is_zero(motion.velocities_before) else None
        inputs = StepInput(np.concatenate([u, loads]) if len(loads) else u, motion, self.base_at(time + dt))
        is_constant = self._constant_loads is not None and motion is self._still and self._base is None
        if is_constant and u.base is None and not u.flags.writeable:  # then u stays what it is
            self._unchanged = u, self.state, inputs
        return inputs

    def _note_misfits(self, time: float, dt: float) -> None:
        """How far what turns goes otherwise than its twists say, in the step of dt, s, that begins at a time, s."""
        for name in self._motions:
            signal, extent = self._signals[name], self.obstacles[name].extent
            if isinstance(signal, PoseSignal) and not signal.is_constant:
                off = signal.misfit(time, time + dt, min(extent, 1.0))
                if any(off):
                    before = self._misfits.get(name, (0.0, 0.0))
                    self._misfits[name] = max(off[0], before[0]), max(off[1], before[1])

    def go_along(self, times: Sequence[float], offsets: Array, velocities: Array, dt: float) -> None:
        """Ends steps of dt, s, that began at all times but the last one, s, with obstacles there, as in the state."""
        for time in times[:-1] if self._motions else ():
            self._note_misfits(time, dt)
        self.state = ObstacleState(offsets, velocities)

    @property
    def messages(self) -> tuple[str, ...]:
        """What the user should know of the run so far: obstacles that jumped, or whose poses and twists do not fit."""
        told = (misfit_message(*off, obstacle=f"obstacle {name!r}") for name, off in self._misfits.items())
        return tuple(message for messages in told for message in messages)

    def commit(self, inputs: StepInput, dt: float) -> None:
        """Ends a step of dt, s, that was taken: the obstacles are where they were to be."""
        self.loads = inputs.u[len(inputs.u) - len(self.loads) :]
        if inputs.obstacles is not None and inputs.obstacles is not self._still:
            self.state = ObstacleState(inputs.obstacles.end, inputs.obstacles.velocities(dt))

    def _keep_constants(self) -> None:
        """What does not depend on time is put together once."""
        self._still = None
        self._unchanged = None, None, StepInput(np.empty(0))
        self._constant_loads: Array | None = None
        self._constant_offsets: Array | None = None
        if all(self._signals[name].is_constant for name in self.columns if name in self._signals):
            self._constant_loads = self.loads_at(0.0)
        if all(self._signals[name].is_constant for name in self.obstacles):
            self._constant_offsets = self.offsets_at(0.0)


def known_at_start(obstacles: Mapping[str, MovingObstacle]) -> "tuple[dict[str, Obstacle], Array]":
    """Obstacles of which is known where they are at time 0, by name, and rows of these."""
    shapes: dict[str, Obstacle] = {}
    rows = list[Array]()
    for name, each in obstacles.items():
        motion = each.motion
        if motion is None:
            rows.append(each.displacement(0.0))
        elif motion.path is not None:
            rows.append(pose_row(motion.path(0.0), np.array(motion.origin)))
        else:
            continue
        shapes[name] = each.shape
    return shapes, np.array(with_turns(rows))
