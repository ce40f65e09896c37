"""The law of a drive in a step, in numbers: what NumPy's steps and compiled ones share (equations in `drives.py`)."""

import math
from collections.abc import MutableSequence, Sequence

from numpy import ndarray as Array

LOWER, UPPER, FRICTION, DAMPING, ARMATURE, STIFFNESS, REST, KIND, GAIN, MOTOR_DAMPING, MOST = range(11)  # of a drive
NO_MOTOR, BY_POSITION, BY_VELOCITY, BY_TORQUE = range(4)  # kinds
POSITION, SPEED, ROTOR, TARGET, BY_MOTOR, FORCE = range(6)  # of a state
IS_STEEP, SLOPE, AT_ZERO, BEGIN, END, TOP, BOTTOM = range(7)  # of a piece: as of `drives.Piece`
MOST_PIECES = 12  # five between six corners, and what is steep at each


def set_law(
    drive: Sequence[float], state: Sequence[float], a: float, h: float, pieces: Array | Sequence[MutableSequence[float]]
) -> int:
    """Sets the law of a step of h s, in pieces (12, 7) from the smallest speed on: how many.

    Args:
        drive: numbers (11,).
        state: (6,).
        a: speed when the step begins.
        h: s.
        pieces: that are set.
    """
    x, most, F, stops, bends = state[POSITION], drive[MOST], drive[FRICTION], a / 2, False
    rotor = 2 * drive[ARMATURE] / h
    slope = rotor + drive[DAMPING] + h / 2 * drive[STIFFNESS]
    force = rotor * state[ROTOR] - drive[STIFFNESS] * (x - drive[REST])
    by_motor, pushed = motor_line(drive, state, h)
    if drive[KIND] != NO_MOTOR and most < math.inf:
        bends = by_motor > 0
    else:
        slope, force, by_motor, pushed, most = slope + by_motor, force + pushed, 0.0, 0.0, 0.0
    first, last, count = (drive[LOWER] - x) / h, (drive[UPPER] - x) / h, 0
    lower, upper = ((pushed - most) / by_motor, (pushed + most) / by_motor) if bends else (0.0, 0.0)
    begin, top, has_top = first, math.inf, first > -math.inf
    while begin < last:
        end = last
        if F > 0:
            end = _next(begin, stops, _next(begin, 0.0, end))
        if bends:
            end = _next(begin, upper, _next(begin, lower, end))
        middle = _between(begin, end)
        k, b, t = slope, force, pushed - by_motor * middle
        if abs(t) < most:
            k, b = k + by_motor, b + pushed
        elif most > 0:
            b += math.copysign(most, t)
        if F > 0 and not min(0.0, stops) < middle < max(0.0, stops):
            b -= math.copysign(F, middle)
        at_begin, at_end = _at(k, b, begin), _at(k, b, end)
        if has_top and top > at_begin:
            _put(pieces[count], 1.0, 0.0, 0.0, begin, begin, top, at_begin)
            count += 1
        _put(pieces[count], 0.0, k, b, begin, end, at_begin, at_end)
        count, begin, top, has_top = count + 1, end, at_end, True
    if last < math.inf:
        _put(pieces[count], 1.0, 0.0, 0.0, last, last, top, -math.inf)
        count += 1
    return count


def motor_line(drive: Sequence[float], state: Sequence[float], h: float) -> tuple[float, float]:
    """Slope and force at s = 0 of its motor without its limit; 0 where there is none."""
    kind, gain = drive[KIND], drive[GAIN]
    if kind == BY_POSITION:
        return drive[MOTOR_DAMPING] + h / 2 * gain, gain * (state[TARGET] - state[POSITION])
    if kind == BY_VELOCITY:
        return gain, gain * state[TARGET]
    return 0.0, state[TARGET] if kind == BY_TORQUE else 0.0


def motor_force(drive: Sequence[float], state: Sequence[float], h: float, s: float) -> float:
    """What its motor pushes with at a speed, N m or N."""
    slope, force = motor_line(drive, state, h)
    return min(max(force - slope * s, -drive[MOST]), drive[MOST])


def stored(drive: Sequence[float], position: float, rotor: float) -> float:
    """By rotor and spring, J."""
    return (drive[ARMATURE] * rotor**2 + drive[STIFFNESS] * (position - drive[REST]) ** 2) / 2


def _next(begin: float, corner: float, end: float) -> float:
    """The end of what begins there, if a corner may be in between."""
    return corner if begin < corner < end else end


def _at(slope: float, force: float, s: float) -> float:
    return force if slope == 0.0 else force - slope * s


def _between(begin: float, end: float) -> float:
    """A speed between two, of which one or both may be infinite."""
    if math.isinf(begin):
        return 0.0 if math.isinf(end) else end - 1.0 - abs(end)
    return begin + 1.0 + abs(begin) if math.isinf(end) else (begin + end) / 2


def _put(
    piece: MutableSequence[float],
    is_steep: float,
    slope: float,
    force: float,
    begin: float,
    end: float,
    top: float,
    bottom: float,
) -> None:
    piece[IS_STEEP], piece[SLOPE], piece[AT_ZERO] = is_steep, slope, force
    piece[BEGIN], piece[END], piece[TOP], piece[BOTTOM] = begin, end, top, bottom
