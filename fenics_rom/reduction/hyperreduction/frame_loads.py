"""What a frame that moves does to its body, as loads of training.

In the axes of a base with the acceleration a, the angular acceleration α and the spin ω, the body feels

    -M (a - g + α × X + ω × (ω × X))

and forces that are prescribed in world axes turn. Where a path says how the base moves, training has what that comes
to; where none does, weight and such forces come from all sides. Of these a free body feels its spin alone.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.mechanics.initial_state import InitialState
from fenics_rom.mechanics.voigt import VOIGT_PAIRS
from fenics_rom.reduction.problem import ReductionProblem, scale_inputs
from fenics_rom.system.system import System

ACCELERATION, ANGULAR_ACCELERATION, SPINS = "base acceleration", "base angular acceleration", "products of base spins"
KINDS = (ACCELERATION, ANGULAR_ACCELERATION, SPINS)
STOPPED_WITHIN = 0.25  # of the slowest period, what flies at an obstacle
STANDARD = 9.81  # m/s², what unknown motions are to put on the body


@dataclass(frozen=True)
class FrameRange:
    """How far a frame moves, (3,) along and about its axes; None: what strains nothing."""

    accelerations: Array | None  # less that of gravity, m/s²
    angular_accelerations: Array | None  # rad/s²
    spins: Array  # rad/s

    def lowered(self, shares: Mapping[str, float]) -> "FrameRange":
        """With shares of the loads of each kind."""
        a, α = self.accelerations, self.angular_accelerations
        return FrameRange(
            None if a is None else shares[ACCELERATION] * a,
            None if α is None else shares[ANGULAR_ACCELERATION] * α,
            np.sqrt(shares[SPINS]) * self.spins,
        )


def framed(problem: ReductionProblem, *, free_spins: bool = False) -> ReductionProblem:
    """The problem of a body in the axes of its frame, with what that does among its loads; of a fixed frame the same.

    One that a base carries is held. Of a free one `free_spins` says whether they are loads, or what runs begin with.
    """
    system, frame = problem.system, problem.system.moving_frame
    if frame is None or system.scene is None:
        return problem
    m, mX, unit, columns = frame.mass_times[:, :1], frame.mass_times[:, 1:], np.eye(3), dict[str, Array]()
    if frame.carried:
        columns[ACCELERATION] = -np.kron(m, unit)
    if frame.carried and system.scene.effects.inertia is not None:
        turning = -np.stack([np.cross(axis, mX) for axis in unit], axis=2)
        columns |= {ANGULAR_ACCELERATION: turning.reshape(-1, 3), SPINS: frame.centrifugal_loads()}
    if not frame.carried and free_spins:
        columns[SPINS] = system.algebra.balanced(frame.centrifugal_loads())  # type: ignore[attr-defined]
    fields = system.scene.environment.uniform_fields if frame.carried else {}
    columns = {name: frame.restrict(np.ascontiguousarray(B)) for name, B in columns.items()}
    kept = {name: B for name, B in system.loads.items() if name not in fields}
    units = {name: unit for name, unit in system.units.items() if name not in fields}
    held = replace(system, loads=kept | columns, units=units | dict.fromkeys(columns, 1.0))
    return replace(problem, system=scale_inputs(held, problem.factor))


class FrameLoads:
    """The loads of a framed system, of those of its scene; in the order of the system.

    Attributes:
        is_free: whether no base carries the body.
        is_known: whether the scene says how the base moves.
    """

    def __init__(self, system: System, active: ActiveEnvironment):
        assert system.scene is not None
        assert system.moving_frame is not None
        scene, self._active, self.is_free = system.scene, active, not system.moving_frame.carried
        self.is_known = scene.environment.base_path is not None
        self._moves = scene.effects.inertia is not None
        self._initial, self._origin = None if scene.run is None else scene.run.initial, system.moving_frame.origin
        self._mass = float(system.moving_frame.moments[0, 0])
        self._thrown = np.zeros(3) if self._initial is None else np.array(self._initial.velocity)
        self._spin = 0.0 if self._initial is None else float(np.linalg.norm(self._initial.spin))
        self._fields = scene.environment.uniform_fields
        ends = np.cumsum([0, *active.columns.values()]).tolist()
        self._of = dict(zip(active.columns, map(slice, ends, ends[1:]), strict=False))
        self._found = scene.environment.found_loads
        shared = np.cumsum([0, *system.widths.values()]).tolist()
        places = dict(zip(system.widths, map(slice, shared, shared[1:]), strict=False))
        self._frame = {name: places[name] for name in KINDS if name in places}
        self._turning = [places[name] for name in scene.effects.prescribed]
        self._training = None if (large := scene.effects.large_deformation) is None else large.training
        self._size = float(system.algebra.maximum(_farthest(system)))

    def seen(self, loads: Array, time: float, dt: float) -> Array:
        """Loads of a framed system in a step of dt, s, that begins at a time, s, of those of the scene (c,)."""
        if self.is_free:  # gravity strains nothing
            kept = [loads[part] * (name not in self._fields) for name, part in self._of.items()]
            return np.concatenate([*kept, np.zeros(6 * (SPINS in self._frame))])
        middle = self._base(time + (dt / 2 if self._moves else dt))
        R = np.eye(3) if middle is None else rotation_matrix(middle.rotation)
        kept = [
            loads[part] if name in self._found else R.T @ loads[part]
            for name, part in self._of.items()
            if name not in self._fields
        ]
        acceleration = -sum((loads[self._of[name]] * field for name, field in self._fields.items()), np.zeros(3))
        if not self._moves:
            return np.concatenate([*kept, R.T @ acceleration])
        angular, ω = np.zeros(3), np.zeros(3)
        start, end = self._base(time), self._base(time + dt)
        if middle is not None and start is not None and end is not None:
            acceleration = acceleration + (end.velocity - start.velocity) / dt
            angular = R.T @ (end.angular_velocity - start.angular_velocity) / dt
            ω = R.T @ middle.angular_velocity
        return np.concatenate([*kept, R.T @ acceleration, angular, products(ω)])

    def _base(self, time: float) -> BaseState | None:
        return self._active.base_at(time)

    def widened(self, resting: Array, extremes: Array, acting: Array) -> tuple[Array, Array, FrameRange]:
        """What is always there and the rest, least and most (2, c), with all that the frame may do besides.

        And how far it moves; `acting` (steps, c) are the inputs of the scene's history.
        """
        resting, extremes = resting.copy(), extremes.copy()
        largest, further = np.abs(acting).max(axis=0), self._further()
        for part in () if self.is_known else self._turning:
            size = np.linalg.norm(acting[:, part], axis=1).max()
            resting[part], extremes[:, part] = 0.0, np.outer([-1, 1], np.full(3, size))

        def reached(kind: str, least: Array, most: Array) -> Array:
            """The largest of a kind, which is to be from least to most at least; 0 where there is none."""
            if kind not in self._frame:
                return np.zeros(len(most))
            part = self._frame[kind]
            extremes[0, part] = np.minimum(extremes[0, part], least)
            extremes[1, part] = np.maximum(extremes[1, part], most)
            return np.maximum(largest[part], most)

        far, turning, most = further.accelerations, further.angular_accelerations, products(further.spins)
        squares = reached(SPINS, np.where(np.arange(6) < 3, 0.0, -most), most)[:3]
        spins = np.maximum(np.sqrt(squares), further.spins)
        if far is None or turning is None:
            return resting, extremes, FrameRange(None, None, spins)
        if not self.is_known:
            weight = np.linalg.norm(acting[:, self._frame[ACCELERATION]], axis=1).max()
            resting[self._frame[ACCELERATION]], far = 0.0, weight + far
        accelerations = reached(ACCELERATION, -far, far)
        return resting, extremes, FrameRange(accelerations, reached(ANGULAR_ACCELERATION, -turning, turning), spins)

    def _further(self) -> FrameRange:
        """What the scene says of training, or stands for a motion of which it says nothing."""
        given, none = self._training, np.zeros(3)
        spins = none if given is None else np.array(given.spins)
        if self.is_free:
            return FrameRange(None, None, np.maximum(spins, self._spin))
        if given is not None:
            return FrameRange(np.array(given.accelerations), np.array(given.angular_accelerations), spins)
        if self.is_known or not self._moves:
            return FrameRange(none, none, none)
        turning = STANDARD / self._size
        return FrameRange(np.full(3, STANDARD), np.full(3, turning), np.full(3, np.sqrt(turning)))

    def starts(self, count: int) -> list[BaseState]:
        """Where the frame of a free body begins in so many runs, and how it spins then."""
        spins, random = self._further().spins, np.random.default_rng(1)
        shares = [np.ones(3), *random.uniform(-1.0, 1.0, (count - 1, 3))]
        at_rest = InitialState().pose(self._origin)
        return [at_rest._replace(angular_velocity=share * spins) for share in shares]

    def start_of_run(self) -> BaseState | None:
        """The same of the scene's own history."""
        return (self._initial or InitialState()).pose(self._origin) if self.is_free else None

    def stopping(self, push: Array, period: float) -> Array:
        """A push (c,) of obstacles on a free body: it bears its weight, and stops it within a quarter of a period."""
        if len(push) % 3:
            return np.ones(len(push)) * self._stopping(period) / max(len(push), 1)
        along = sum(self._fields.values(), np.zeros(3)) + self._thrown  # which it is pushed against
        size = float(np.linalg.norm(along))
        towards = -along / size if size > 0 else np.zeros(3)
        return np.tile(self._stopping(period) * towards / (len(push) // 3), len(push) // 3)

    def _stopping(self, period: float) -> float:
        """Size of that force, N."""
        weight = float(np.linalg.norm(sum(self._fields.values(), np.zeros(3))))
        return self._mass * (weight + float(np.linalg.norm(self._thrown)) / (STOPPED_WITHIN * period))

    @property
    def message(self) -> str:
        """What to say of motions that nobody named; empty where somebody did."""
        if self.is_free or self.is_known or self._training is not None or not self._moves:
            return ""
        turning = STANDARD / self._size
        return (
            f"training: the scene does not say how the base moves, so it was trained with accelerations of {STANDARD} "
            f"m/s2 along each axis, beside its weight from all sides, and with {turning:.3g} rad/s2 and spins of "
            f"{np.sqrt(turning):.3g} rad/s about each; "
            "effects.base_path.table or effects.large_deformation.training says it"
        )

    def consistent(self, shared: Array, random: np.random.Generator) -> Array:
        """Inputs (c,) whose products of spins are those of one spin, with the squares that they have."""
        if SPINS in self._frame:
            part = self._frame[SPINS]
            shared[part] = products(np.sqrt(np.maximum(shared[part][:3], 0.0)) * random.choice([-1.0, 1.0], 3))
        return shared


def products(ω: Array) -> Array:
    """What the six centrifugal loads are multiplied by at a spin ω (3,): ω_k ω_j, twice of two that differ."""
    k, j = VOIGT_PAIRS.T
    product: Array = ω[k] * ω[j] * np.where(k == j, 1.0, 2.0)
    return product


def _farthest(system: System) -> float:
    """The largest distance of a node here from the frame's origin, m."""
    assert system.moving_frame is not None
    return float(np.linalg.norm(system.moving_frame.arms, axis=1).max(initial=0.0))
