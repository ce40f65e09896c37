"""The path of a rigid base that carries a body: poses and twists over time, in world axes.

Between rows positions are cubic and rotations normalised cubics of quaternions (Hermite's, of values and rates at both
ends), so that poses and twists are continuous and fit each other. Quaternions are w x y z.
"""

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError, shown
from fenics_rom.mechanics.signals import real_numbers, real_numbers_or_nan

if TYPE_CHECKING:
    from collections.abc import Callable

BASE_PATH = "base_path"  # its name among effects and signals
FLOAT = np.dtype(float)
UNIT_TOLERANCE = 1e-3  # of the length of a quaternion, which tables give with few digits
LARGEST_TURN = 2.0  # from row to row, rad: beyond π nobody knows which way
LARGEST_MISFIT = 0.1  # share that poses and twists differ by: 0.2 of a smooth swing in four rows, 0.02 in eleven
NEGLIGIBLE = 1e-6  # m or rad from row to row, that poses and twists may differ by
CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])  # times a unit quaternion: the rotation back
MOST_SWING = 0.3  # of the way between the farthest rows: 0.2 of a smooth swing in four rows
STILL = 1e-3  # of the largest twist: where the base counts as at rest


class BaseState(NamedTuple):
    """A rigid base at an instant, in world axes.

    Example:
        >>> fr.BaseState(np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3), np.array([0, 0, 2.0])).angular_velocity
        array([0., 0., 2.])
    """

    position: Array  # (3,), or (n, 3) of n instants, as all that follows, of the frame's origin, m
    rotation: Array  # (4,) from the frame's axes, a unit quaternion w x y z
    velocity: Array  # (3,) of the origin, m/s
    angular_velocity: Array  # (3,), rad/s


@dataclass(frozen=True, eq=False)
class BasePath:
    """Poses of a rigid base over time; it stands still before the first and after the last of them.

    Attributes:
        times: (T,) strictly increasing, s.
        positions: (T, 3) of the frame's origin, m.
        rotations: (T, 4) unit quaternions, w x y z.
        velocities, angular_velocities: (T, 3), m/s and rad/s; None: those of cubic splines through the poses (twice
            continuously differentiable), at rest in the first and in the last row.

    Example:
        >>> poses = np.zeros((2, 3)), np.array([[1.0, 0, 0, 0], [0.8, 0, 0, 0.6]])
        >>> path = fr.BasePath(np.array([0.0, 1.0]), *poses)  # from rest to rest
        >>> path(0.5).angular_velocity  # rad/s, about z
        array([0., 0., 2.])
    """

    times: Array
    positions: Array
    rotations: Array
    velocities: Array | None = None
    angular_velocities: Array | None = None

    def __post_init__(self) -> None:
        for name in ("times", "positions", "rotations", "velocities", "angular_velocities"):
            if (given := getattr(self, name)) is not None or name in ("times", "positions", "rotations"):
                object.__setattr__(self, name, real_numbers_or_nan(given))

    def __call__(self, time: float) -> BaseState:
        """The base at a time, s."""
        times, cubics = self._cubics
        inside = min(max(time, times[0]), times[-1])
        k = min(max(bisect_left(times, inside) - 1, 0), len(times) - 2)
        h = times[k + 1] - times[k]
        s = (inside - times[k]) / h
        powers = np.array(((1.0, s, s * s, s**3), (0.0, 1 / h, 2 * s / h, 3 * s * s / h)))
        values, rates = powers.dot(cubics[k]).tolist()
        length = math.hypot(*values[3:])
        if inside != time:
            return BaseState(np.array(values[:3]), np.array(values[3:]) / length, np.zeros(3), np.zeros(3))
        turning = np.array(_turning(values[3:], rates[3:])) * (2 / length**2)
        return BaseState(np.array(values[:3]), np.array(values[3:]) / length, np.array(rates[:3]), turning)

    def along(self, times: Array) -> BaseState:
        """The base at all times (n,), s."""
        (known, cubics), given = self._cubics, np.asarray(times, dtype=float)
        inside = np.clip(given, known[0], known[-1])
        k = np.clip(np.searchsorted(known, inside) - 1, 0, len(known) - 2)
        h = np.diff(known)[k]
        s = (inside - np.array(known)[k]) / h
        powers = np.array(((s**0, s, s * s, s**3), (0 * s, 1 / h, 2 * s / h, 3 * s * s / h)))
        values, rates = np.einsum("rpn,npv->rnv", powers, cubics[k])
        length = np.linalg.norm(values[:, 3:], axis=1)[:, None]
        turning = np.array(_turning(values[:, 3:].T, rates[:, 3:].T)).T * (2 / length**2)
        moves = (inside == given)[:, None]
        return BaseState(values[:, :3], values[:, 3:] / length, rates[:, :3] * moves, turning * moves)

    @cached_property
    def _cubics(self) -> tuple[list[float], Array]:
        """Times, and of each interval the coefficients (4, 7) of powers of the share of it that is over."""
        values, rates = self._rows
        h = np.diff(self.times)[:, None]
        step, first, last = values[1:] - values[:-1], h * rates[:-1], h * rates[1:]
        cubics = np.stack([values[:-1], first, 3 * step - 2 * first - last, first + last - 2 * step], axis=1)
        return self.times.tolist(), cubics

    @cached_property
    def _rows(self) -> tuple[Array, Array]:
        """Positions and quaternions, (T, 7), whose neighbours have the nearer sign; and their rates."""
        unit = self.rotations / np.linalg.norm(self.rotations, axis=1)[:, None]
        values = np.hstack([self.positions, with_nearest_signs(unit)])
        if self.velocities is None or self.angular_velocities is None:
            return values, _spline_rates(self.times, values)
        turning = np.hstack([np.zeros((len(values), 1)), self.angular_velocities])
        return values, np.hstack([self.velocities, quaternion_product(turning, values[:, 3:]) / 2])

    def mistake(self, duration: float | None = None) -> str:
        """What is wrong with it, in words; empty where nothing is.

        Args:
            duration: of a run, s, throughout which twists must not jump.
        """
        rows = self.times.shape if self.times.ndim == 1 and len(self.times) > 1 else (2,)
        widths = {"times": (), "positions": (3,), "rotations": (4,), "velocities": (3,), "angular_velocities": (3,)}
        for name, width in widths.items():
            given = getattr(self, name)
            if given is not None and not (given.shape == (*rows, *width) and np.isfinite(given).all()):
                return f"{name} is of shape {given.shape}: use finite numbers {(*rows, *width)}"
        if (np.diff(self.times) <= 0).any():
            return "times: use times that increase strictly"
        for time, length in zip(self.times, np.linalg.norm(self.rotations, axis=1), strict=True):
            if not abs(length - 1) <= UNIT_TOLERANCE:
                return f"the rotation at {time:g} s has length {length:.6g}: use unit quaternions, w x y z"
        values = self._rows[0]
        turns = rotation_vectors(quaternion_product(values[1:, 3:], values[:-1, 3:] * CONJUGATE))
        angles = np.linalg.norm(turns, axis=1)
        k = int(angles.argmax())
        if angles[k] > LARGEST_TURN:
            return (
                f"the base turns by {angles[k]:.3g} rad from {self.times[k]:g} s to {self.times[k + 1]:g} s: use more "
                f"rows, of at most {LARGEST_TURN:.3g} rad from one to the next"
            )
        if self.velocities is None or self.angular_velocities is None:
            return self._swing()
        moves = np.diff(values[:, :3], axis=0)
        return (
            self._misfit("velocity", "position", "m", moves, self.velocities)
            or self._misfit("angular_velocity", "rotation", "rad", turns, self.angular_velocities)
            or self._jump("velocity", "m/s", self.velocities, duration)
            or self._jump("angular_velocity", "rad/s", self.angular_velocities, duration)
        )

    def _swing(self) -> str:
        """Whether the spline through poses goes far beyond them, as it does where rows jump or are uneven."""
        values, (times, cubics) = self._rows[0], self._cubics
        shares = np.array([0.25, 0.5, 0.75])
        between = np.einsum("sp,kpv->ksv", shares[:, None] ** np.arange(4), cubics)
        for pose, unit, part in (("position", "m", slice(3)), ("rotation", "", slice(3, 7))):
            low, high = values[:, part].min(axis=0), values[:, part].max(axis=0)
            beyond = np.maximum(np.maximum(low - between[..., part], between[..., part] - high), 0.0)
            far = np.linalg.norm(beyond, axis=2)
            k, s = np.unravel_index(int(far.argmax()), far.shape)
            if far[k, s] <= max(MOST_SWING * float(np.linalg.norm(high - low)), NEGLIGIBLE):
                continue
            time = times[k] + shares[s] * (times[k + 1] - times[k])
            return (
                f"the spline through its rows swings far beyond them: its {pose} at {time:g} s is "
                f"{_shown(between[k, s, part])}{unit and ' ' + unit}, and all rows are between {_shown(low)} and "
                f"{_shown(high)}; use rows at even times where the base is fast, or rows with twists"
            )
        return ""

    def _misfit(self, rate: str, pose: str, unit: str, moves: Array, rates: Array) -> str:
        """Whether poses move from row to row by what twists mean."""
        h = np.diff(self.times)[:, None]
        means = h * (rates[1:] + rates[:-1]) / 2
        larger = np.maximum(np.abs(moves), np.abs(means))
        error, scale = (float(np.sqrt((np.square(of) / h).sum())) for of in (moves - means, larger))
        misses = np.linalg.norm(moves - means, axis=1)
        k = int(misses.argmax())
        if error <= LARGEST_MISFIT * scale or misses[k] <= NEGLIGIBLE:
            return ""
        return (
            f"{rate} and {pose} do not fit each other: from {self.times[k]:g} s to {self.times[k + 1]:g} s the {pose} "
            f"changes by {_shown(moves[k])} {unit}, and {rate} means {_shown(means[k])} {unit}; over all rows they are "
            f"{error / scale:.2g} apart: at most {LARGEST_MISFIT:g} (of the origin, in world axes; or poses alone)"
        )

    def _jump(self, rate: str, unit: str, rates: Array, duration: float | None) -> str:
        """Whether the base jumps from or to standing still, where the rows end within a run."""
        speeds = np.linalg.norm(rates, axis=1)
        begins, ends = self.times[0] > 0, duration is not None and self.times[-1] < duration
        for row, within, verb in ((0, begins, "starts"), (-1, ends, "stops")):
            if within and speeds[row] > STILL * speeds.max():
                return (
                    f"the base jumps at {self.times[row]:g} s: it {verb} with {rate} {_shown(rates[row])} {unit}: "
                    "beyond its rows it stands still; use 0 there, or rows that cover the run"
                )
        return ""

    def __repr__(self) -> str:
        twists = "twists of a spline" if self.velocities is None else "twists"
        return f"BasePath of {len(self.times)} poses with {twists}, {self.times[0]:g} s to {self.times[-1]:g} s"


def _turning(values: Sequence[Any], rates: Sequence[Any]) -> tuple[Any, Any, Any]:
    """Half of the angular velocity, by quaternions and their rates: of q̇ q*, their length being nearly 1."""
    (w, x, y, z), (ẇ, ẋ, ẏ, ż) = values, rates
    return w * ẋ - ẇ * x + y * ż - z * ẏ, w * ẏ - ẇ * y + z * ẋ - x * ż, w * ż - ẇ * z + x * ẏ - y * ẋ


class CheckedMotion:
    """A function of time of which each state is checked; `where` is its name in messages.

    Attributes:
        unchecked: the same function without that, for those who look themselves.
    """

    def __init__(self, motion: "Callable[[float], BaseState]", where: str):
        self.unchecked, self._where = motion, where

    def __call__(self, time: float) -> BaseState:
        """The state at a time, s."""
        return checked_base(self.unchecked(time), f"{self._where} at {time:g} s")


def given_base(given: object, where: str = BASE_PATH) -> "Callable[[float], BaseState]":
    """A function of time of what was given in Python, which checks what it gives; `where` is its name in messages.

    Raises:
        StepError: it is a path with a mistake, or gives something else than a state.
    """
    if isinstance(given, BasePath):
        if mistake := given.mistake():
            raise StepError(f"{where}: {mistake}")
        return given
    if callable(given):
        return CheckedMotion(given, where)
    state = checked_base(given, where)
    return lambda time: state


def checked_base(given: object, where: str) -> BaseState:
    """The state, as arrays; StepError where it is none."""
    try:
        parts = [
            part.copy() if type(part) is Array and part.dtype is FLOAT else real_numbers(part)  # the same, but slower
            for part in given  # type: ignore[attr-defined]
        ]
    except (TypeError, ValueError):
        parts = []
    if [part.shape for part in parts] != [(3,), (4,), (3,), (3,)] or not math.isfinite(
        sum([sum(part.tolist()) for part in parts])
    ):
        raise StepError(
            f"{where} = {shown(given)}: use a BaseState: position (3,) m, rotation (4,), velocity (3,) m/s, "
            "angular velocity (3,) rad/s, all finite"
        )
    length = math.hypot(*parts[1].tolist())
    if not abs(length - 1) <= UNIT_TOLERANCE:
        raise StepError(f"{where}: the rotation has length {length:.6g}: use a unit quaternion, w x y z")
    return BaseState(parts[0], parts[1] / length, parts[2], parts[3])


def checked_bases(given: "Sequence[BaseState] | BaseState", first: int) -> Array:
    """Numbers (steps, 13) of a base at the end of each step, of a list of states, or of one of so many instants.

    Raises:
        StepError: it is neither. `first` is the number of the first step.
    """
    if not isinstance(given, BaseState) or np.ndim(given.position) != 2:
        each = [np.concatenate(checked_base(state, f"step {first + k}: base")) for k, state in enumerate(given)]
        return np.array(each).reshape(-1, 13)
    parts = [real_numbers_or_nan(part) for part in given]
    if [part.shape for part in parts] != [(len(parts[0]), width) for width in (3, 4, 3, 3)]:
        given_shapes = [part.shape for part in parts]
        raise StepError(f"base: use (steps, 3), (steps, 4), (steps, 3) and (steps, 3) (got {given_shapes})")
    rows: Array = np.hstack(parts)
    length = np.linalg.norm(rows[:, 3:7], axis=1)
    wrong = np.flatnonzero(~(np.isfinite(rows).all(axis=1) & (np.abs(length - 1) <= UNIT_TOLERANCE)))
    if len(wrong):
        checked_base(base_in(rows[wrong[0]]), f"step {first + wrong[0]}: base")
    rows[:, 3:7] /= length[:, None]
    return rows


def base_in(row: Array) -> BaseState:
    """The state of 13 numbers."""
    return BaseState(row[:3], row[3:7], row[7:10], row[10:])


def quaternion_product(a: Array, b: Array) -> Array:
    """Of quaternions (..., 4): the rotation b, then a."""
    s, t, u, v = (a[..., k] for k in range(4))  # to move axes takes three times as long
    w, x, y, z = (b[..., k] for k in range(4))
    scalar = s * w - t * x - u * y - v * z
    product: Array = np.empty((*scalar.shape, 4))
    product[..., 0], product[..., 1] = scalar, s * x + t * w + u * z - v * y
    product[..., 2], product[..., 3] = s * y + u * w + v * x - t * z, s * z + v * w + t * y - u * x
    return product


def with_nearest_signs(quaternions: Array) -> Array:
    """Of quaternions over time (T, 4) the same rotations, each with the sign that is nearer to the one before."""
    flips = np.where((quaternions[1:] * quaternions[:-1]).sum(axis=1) < 0, -1.0, 1.0)
    return quaternions * np.cumprod([1.0, *flips])[:, None]


def rotation_vectors(quaternions: Array) -> Array:
    """Axis times angle (..., 3) of unit quaternions (..., 4), at most π."""
    vector = np.where(quaternions[..., :1] < 0, -1.0, 1.0) * quaternions[..., 1:]
    sine = np.linalg.norm(vector, axis=-1, keepdims=True)
    half = np.arctan2(sine, np.abs(quaternions[..., :1]))
    return 2 * vector * np.divide(half, sine, out=np.ones_like(sine), where=sine > 0)


def _spline_rates(times: Array, values: Array) -> Array:
    """Rates (T, w) in the rows of cubic splines through values (T, w), 0 at both ends: tridiagonal, by elimination."""
    h = np.diff(times)[:, None]
    slopes = np.diff(values, axis=0) / h
    rates, shares = np.zeros_like(values), np.zeros(len(times))
    for k in range(1, len(times) - 1):
        below, above = 1 / h[k - 1, 0], 1 / h[k, 0]
        pivot = 2 * (below + above) - below * shares[k - 1]
        shares[k] = above / pivot
        rates[k] = (3 * (below * slopes[k - 1] + above * slopes[k]) - below * rates[k - 1]) / pivot
    for k in range(len(times) - 2, 0, -1):
        rates[k] -= shares[k] * rates[k + 1]
    return rates


def _shown(vector: Array) -> str:
    return f"({', '.join(f'{part:.3g}' for part in vector)})"
