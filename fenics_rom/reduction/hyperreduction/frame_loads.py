"""What a frame that carries a body does to it, as loads of training on the body held at its base.

In the axes of a base with the acceleration a, the angular acceleration α and the spin ω, the body feels

    -M (a - g + α × X + ω × (ω × X))

and forces that are prescribed in world axes turn. Where a path says how the base moves, training has what that comes
to; where none does, weight and such forces come from all sides.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.mechanics.hyperelastic import VOIGT_PAIRS
from fenics_rom.reduction.problem import ReductionProblem, scale_inputs
from fenics_rom.system.system import System

ACCELERATION, ANGULAR_ACCELERATION, SPINS = "base acceleration", "base angular acceleration", "products of base spins"
KINDS = (ACCELERATION, ANGULAR_ACCELERATION, SPINS)
STANDARD = 9.81  # m/s², what unknown motions are to put on the body


@dataclass(frozen=True)
class FrameRange:
    """How far a frame moves, (3,) along and about its axes."""

    accelerations: Array  # less that of gravity, m/s²
    angular_accelerations: Array  # rad/s²
    spins: Array  # rad/s

    def lowered(self, shares: Mapping[str, float]) -> "FrameRange":
        """With shares of the loads of each kind."""
        return FrameRange(
            shares[ACCELERATION] * self.accelerations,
            shares[ANGULAR_ACCELERATION] * self.angular_accelerations,
            np.sqrt(shares[SPINS]) * self.spins,
        )


def is_framed(system: System) -> bool:
    """Whether its loads are those of a base that moves."""
    return ACCELERATION in system.loads


def framed(problem: ReductionProblem) -> ReductionProblem:
    """The problem of a body that a base carries as that of one that is held, under what the base does; or the same."""
    system, frame = problem.system, problem.system.moving_frame
    if frame is None or not frame.carried or system.scene is None:
        return problem
    m, mX, unit = frame.mass_times[:, :1], frame.mass_times[:, 1:], np.eye(3)
    columns = {ACCELERATION: -np.kron(m, unit)}
    if system.scene.effects.inertia is not None:
        turning = -np.stack([np.cross(axis, mX) for axis in unit], axis=2)
        columns |= {ANGULAR_ACCELERATION: turning.reshape(-1, 3), SPINS: frame.centrifugal_loads()}
    fields = system.scene.environment.uniform_fields
    kept = {name: B for name, B in system.loads.items() if name not in fields}
    units = {name: unit for name, unit in system.units.items() if name not in fields}
    held = replace(system, loads=kept | columns, units=units | dict.fromkeys(columns, 1.0))
    return replace(problem, system=scale_inputs(held, problem.factor))


class FrameLoads:
    """The loads of a framed system, of those of its scene; in the order of the system.

    Attributes:
        is_known: whether the scene says how the base moves.
    """

    def __init__(self, system: System, active: ActiveEnvironment):
        assert system.scene is not None
        scene, self._active = system.scene, active
        self.is_known = scene.environment.base_path is not None
        self._moves = ANGULAR_ACCELERATION in system.loads
        self._fields = scene.environment.uniform_fields
        ends = np.cumsum([0, *active.columns.values()]).tolist()
        self._of = dict(zip(active.columns, map(slice, ends, ends[1:]), strict=False))
        self._guides = scene.environment.guides
        shared = np.cumsum([0, *system.widths.values()]).tolist()
        places = dict(zip(system.widths, map(slice, shared, shared[1:]), strict=False))
        self._frame = {name: places[name] for name in KINDS if name in places}
        self._turning = [places[name] for name in scene.effects.prescribed]
        self._training = None if (large := scene.effects.large_deformation) is None else large.training
        self._size = float(system.algebra.maximum(_farthest(system)))

    def seen(self, loads: Array, time: float, dt: float) -> Array:
        """Loads of a framed system in a step of dt, s, that begins at a time, s, of those of the scene (c,)."""
        middle = self._base(time + (dt / 2 if self._moves else dt))
        R = np.eye(3) if middle is None else rotation_matrix(middle.rotation)
        kept = [
            loads[part] if name in self._guides else R.T @ loads[part]
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
        largest = np.abs(acting).max(axis=0)
        further = self._further()
        if not self.is_known:
            for part in self._turning:
                size = np.linalg.norm(acting[:, part], axis=1).max()
                resting[part], extremes[:, part] = 0.0, np.outer([-1, 1], np.full(3, size))
            part = self._frame[ACCELERATION]
            weight = np.linalg.norm(acting[:, part], axis=1).max()
            resting[part], largest[part] = 0.0, weight + further.accelerations
            extremes[:, part] = np.outer([-1, 1], largest[part])
        part = self._frame[ACCELERATION]
        largest[part] = np.maximum(largest[part], further.accelerations)
        extremes[0, part] = np.minimum(extremes[0, part], -further.accelerations)
        extremes[1, part] = np.maximum(extremes[1, part], further.accelerations)
        if not self._moves:
            return resting, extremes, FrameRange(largest[part], np.zeros(3), np.zeros(3))
        part, spins = self._frame[ANGULAR_ACCELERATION], self._frame[SPINS]
        largest[part] = np.maximum(largest[part], further.angular_accelerations)
        extremes[0, part] = np.minimum(extremes[0, part], -further.angular_accelerations)
        extremes[1, part] = np.maximum(extremes[1, part], further.angular_accelerations)
        most = products(further.spins)
        extremes[0, spins] = np.minimum(extremes[0, spins], np.where(np.arange(6) < 3, 0.0, -most))
        extremes[1, spins] = np.maximum(extremes[1, spins], most)
        ω = np.maximum(np.sqrt(largest[spins][:3]), further.spins)
        return resting, extremes, FrameRange(largest[self._frame[ACCELERATION]], largest[part], ω)

    def _further(self) -> FrameRange:
        """What the scene says of training, or stands for a motion of which it says nothing."""
        if self._training is not None:
            of = self._training
            return FrameRange(*map(np.array, (of.accelerations, of.angular_accelerations, of.spins)))
        if self.is_known or not self._moves:
            return FrameRange(np.zeros(3), np.zeros(3), np.zeros(3))
        turning = STANDARD / self._size
        return FrameRange(np.full(3, STANDARD), np.full(3, turning), np.full(3, np.sqrt(turning)))

    @property
    def message(self) -> str:
        """What to say of motions that nobody named; empty where somebody did."""
        if self.is_known or self._training is not None or not self._moves:
            return ""
        of = self._further()
        return (
            "training: the scene does not say how the base moves, so it was trained with accelerations of "
            f"{of.accelerations[0]:.3g} m/s2 along each axis, beside its weight from all sides, and with "
            f"{of.angular_accelerations[0]:.3g} rad/s2 and spins of {of.spins[0]:.3g} rad/s about each; "
            "effects.base_path.table or effects.large_deformation.training says it"
        )

    def consistent(self, shared: Array, random: np.random.Generator) -> Array:
        """Inputs (c,) whose products of spins are those of one spin, with the squares that they have."""
        if self._moves:
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
