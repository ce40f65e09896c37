"""Steps of a world in which rigid bodies may pass through one another, as they go farther than they are thick.

Where two bodies touch is looked for where they are expected in the middle of a step. What went by more than both are
thick by then may be on the other side. So such a step is cut. In a part two bodies go, relative to one another, by at
most a share of their thickness, or of the gap between them while that is more. Parts are halves of halves of a step.
Thick is the largest ball that a body holds. Gaps are those of balls around bodies, at least: parts are rather too
short. How fast bodies are is looked at again before one could be fast if all sped up twofold.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.world.driven import Driven
from fenics_rom.world.make_bodies import AnyBody
from fenics_rom.world.meetings import Meeting
from fenics_rom.world.readings import ReadWorld
from fenics_rom.world.rigid import Rigid
from fenics_rom.world.soft import Soft
from fenics_rom.world.step_count import next_time

SHARE = 0.5  # of the thickness, or of the gap, that two bodies go in a part
MOST_PARTS = 4096  # of a step
MOST_TURNED = 1.0  # rad, in a part
LONGEST_WAIT = 256  # steps, until it is looked again how fast bodies are


class FastPair(NamedTuple):
    """Two rigid bodies that may pass through one another."""

    meeting: Meeting
    first: Rigid | Driven
    second: Rigid | Driven
    thick: float  # both together, m


def fast_pairs(bodies: Sequence[AnyBody], meetings: Sequence[Meeting]) -> list[FastPair]:
    """Those of the meetings of bodies; of what is infinitely thick there is none."""
    pairs = []
    for meeting in meetings:
        first, second = bodies[meeting.first], bodies[meeting.second]
        if first is second or not (isinstance(first, Rigid | Driven) and isinstance(second, Rigid | Driven)):
            continue
        assert first.shape is not None
        assert second.shape is not None
        thick = first.shape.core[0] + second.shape.core[0]
        if math.isfinite(thick):
            pairs.append(FastPair(meeting, first, second, thick))
    return pairs


class CutWorld(ReadWorld):
    """A world that cuts steps."""

    _soft: list[Soft]
    _fast: Sequence[FastPair] = ()
    _cut: tuple[int, float] = 0, math.inf  # steps that were cut, and the smallest part, s
    _wait = 0  # steps until it is looked again

    def _take_steps(self, inputs: Mapping[str, Mapping[str, Any]] | None, most: int) -> int:
        """Takes so many steps of now at most: how many."""
        raise NotImplementedError

    def _set_step(self, dt: float) -> None:
        """Goes on in steps of dt, s."""
        self._dt = dt
        for soft in self._soft:
            soft.dt = dt

    def _leave_loops(self) -> None:
        """Has no steps taken by compiled functions from now on."""
        raise NotImplementedError

    def _make_loops(self) -> None:
        """Has whole steps taken by compiled functions from now on, if they know all that there is."""
        raise NotImplementedError

    def _advance(self, inputs: Mapping[str, Mapping[str, Any]] | None, most: int) -> int:
        """Takes so many steps at most, one of them in parts where bodies are fast: how many."""
        if not self._fast:
            return self._take_steps(inputs, most)
        if not self._wait:
            self._tell()
            self._wait = self._steps_to_wait()
        if not self._wait:
            if self._parts(self._dt) > 1:
                self._step_in_parts(inputs)
                return 1
            return self._take_steps(inputs, 1)
        taken = self._take_steps(inputs, min(most, self._wait))
        self._wait -= taken
        return taken

    def _steps_to_wait(self) -> int:
        """Steps in which nothing is fast, even if all speed up twofold by then."""
        h, thinnest, wait = self._dt, min(pair.thick for pair in self._fast), float(LONGEST_WAIT)
        slow = SHARE * thinnest / (4 * h)  # two bodies, each twice as fast
        for body in {id(body): body for pair in self._fast for body in (pair.first, pair.second)}.values():
            speed, gained = _speed(body, h), h * _acceleration(body)
            wait = min(wait, slow / max(speed, 1e-300), (slow - speed) / max(gained, 1e-300))
        return int(max(wait, 0.0))

    def _parts(self, h: float) -> int:
        """Of h s, in which nothing goes too far; a power of 2."""
        parts, turns = 1.0, 0.0
        for meeting, first, second, thick in self._fast:
            if not meeting.is_on:
                continue
            (v, turning), (w, others) = _rates(first, h), _rates(second, h)
            goes = h * math.dist(v, w) + sum(h * ω * body.size for ω, body in ((turning, first), (others, second)) if ω)
            turns = max(turns, h * turning, h * others)
            if goes > SHARE * thick:
                parts = max(parts, goes / (SHARE * max(thick, _gap(first, second))))
        if parts > 1:
            parts = max(parts, turns / MOST_TURNED)
        return int(min(2 ** math.ceil(math.log2(parts)), MOST_PARTS))

    def _step_in_parts(self, inputs: Mapping[str, Mapping[str, Any]] | None) -> None:
        """Takes a step in parts, which are made as they are needed."""
        dt, steps, time = self._dt, self._steps, self._time
        self._leave_loops()
        begun, size = 0, MOST_PARTS  # of MOST_PARTS; parts never get longer, as an impact ends in two of one length
        try:
            while begun < MOST_PARTS:
                size = min(size, MOST_PARTS // self._parts(dt))
                while begun % size:
                    size //= 2
                part = dt * size / MOST_PARTS
                self._set_step(part)
                self._take_steps(inputs, 1)
                begun += size
                self._cut = self._cut[0], min(self._cut[1], part)
        finally:
            self._set_step(dt)
            self._steps = steps
            self._make_loops()
        self._steps, self._time, self._cut = steps + 1, next_time(time, dt, 1), (self._cut[0] + 1, self._cut[1])

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the user should know of the run so far."""
        steps, smallest = self._cut
        if not steps:
            return super().warnings
        why = "as bodies would have gone through others"
        return *super().warnings, f"{steps} steps were cut, {why}: the smallest part took {smallest:.2g} s"


def _rates(body: Rigid | Driven, h: float) -> tuple[Array, float]:
    """Velocity (3,), m/s, and how fast a body turns, rad/s, in a step of h s, at most."""
    v, ω = body.twist
    turning = float(np.linalg.norm(ω))
    if isinstance(body, Driven):
        end = body.motion(body.time + h)
        gone = (np.asarray(end.position) - body.pose.position) / h
        turned = 2 * math.acos(min(1.0, abs(float(np.dot(end.rotation, body.pose.rotation))))) / h
        return (gone if gone.dot(gone) > v.dot(v) else v), max(turning, turned)
    return v + h * body.gravity, turning


def _speed(body: Rigid | Driven, h: float) -> float:
    """Of the fastest point, m/s, at most."""
    v, turning = _rates(body, h)
    return float(np.linalg.norm(v)) + (turning * body.size if turning else 0.0)


def _acceleration(body: Rigid | Driven) -> float:
    """Of what moves freely, m/s²: by its weight, and as in the last step."""
    if isinstance(body, Driven):
        return 0.0
    return float(np.linalg.norm(body.gravity) + np.linalg.norm(body.turning[2]))


def _gap(first: Rigid | Driven, second: Rigid | Driven) -> float:
    """Between two bodies, at least, m: of the ball around either from the other one."""
    gaps = [0.0]
    for body, other in ((first, second), (second, first)):
        assert other.shape is not None
        R = rotation_matrix(other.pose.rotation)
        centre = (body.pose.position - other.pose.position) @ R
        gaps.append(float(other.shape.distance(centre[None])[0][0]) - body.size)
    return max(gaps)
