"""Steps of a world in which bodies may pass through one another, as they go farther than they are thick.

Where two bodies touch is looked for where they are expected in the middle of a step. What went by more than both are
thick by then may be on the other side. So such a step is cut. In a part two bodies go, relative to one another, by at
most a share of their thickness, or of the gap between them while that is more. Parts are halves of halves of a step.
How fast bodies are is looked at again before one could be fast if all sped up twofold.

As thick as the largest ball that it holds is a rigid body. The points of a soft one have no thickness, so beside these
that of a rigid one alone counts, and of two soft ones half of the thinner wall. In a body that touches itself it is
what `OwnSurface` says. Gaps of rigid bodies are those of balls around them, at least: parts are rather too short. Soft
ones are apart by what is between their points along the axes, and along the way that they go relative to one another.
"""

import math
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.surface_pairs import DEEPEST, Boxes
from fenics_rom.mechanics.walls import thinnest_wall
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
LONGEST_SOFT_WAIT = 64  # the same where one is soft: what it stores may make it faster


class FastPair(NamedTuple):
    """Two bodies that may pass through one another, or one that may pass through itself."""

    meeting: Meeting
    first: AnyBody
    second: AnyBody
    thick: float  # both together, m


class _Going(NamedTuple):
    """How a body goes."""

    velocity: Array  # of its middle (3,), m/s
    beside: float  # how much faster a point of it is, m/s, at most
    turning: float  # rad/s, of a rigid one

    @property
    def speed(self) -> float:
        """Of its fastest point, m/s, at most."""
        return float(np.linalg.norm(self.velocity)) + self.beside

    def relative_to(self, other: "_Going") -> float:
        """How fast points of both go relative to one another, m/s, at most."""
        return math.dist(self.velocity, other.velocity) + self.beside + other.beside


def fast_pairs(bodies: Sequence[AnyBody], meetings: Sequence[Meeting]) -> list[FastPair]:
    """Those of the meetings of bodies; of what is infinitely thick there is none."""
    pairs, wall = [], cache(_wall)
    for meeting in meetings:
        first, second = bodies[meeting.first], bodies[meeting.second]
        cores = [body.shape.core[0] for body in (first, second) if not isinstance(body, Soft) and body.shape]
        if meeting.own is not None:
            thick = meeting.own.deepest / 2
        else:
            thick = sum(cores) if cores else min(wall(body) for body in (first, second) if isinstance(body, Soft)) / 2
        if math.isfinite(thick):
            pairs.append(FastPair(meeting, first, second, thick))
    return pairs


def _wall(body: Soft) -> float:
    """The thinnest wall of a soft body at rest behind its contact surface, m: some rays into it say so.

    Not more than what points may be inside, to be found there.
    """
    points = body.surface.points[body.contact_triangles]
    if not len(points):
        return math.inf
    most = DEEPEST * Boxes.about(points.transpose(1, 0, 2)).size
    return thinnest_wall(points, body.rom.nodes[body.rom.triangles], most)


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
        """Steps in which no two bodies are fast, even if both speed up twofold by then, in any direction."""
        h, goings = self._dt, self._goings(self._dt)
        wait = float(LONGEST_SOFT_WAIT if self._soft else LONGEST_WAIT)
        speeds = {body: going.speed for body, going in goings.items()}
        accelerations = {body: _acceleration(body) for body in goings}
        for _, first, second, thick in self._fast:
            fast = SHARE * thick / h
            sped = goings[first].relative_to(goings[second]) + speeds[first] + speeds[second]
            gained = 2 * h * (accelerations[first] + accelerations[second])
            wait = min(wait, fast / max(sped, 1e-300), (fast - sped) / max(gained, 1e-300))
        return int(max(wait, 0.0))

    def _goings(self, h: float) -> dict[AnyBody, _Going]:
        """How the bodies go in a step of h s that may pass through others."""
        bodies = dict.fromkeys(body for pair in self._fast for body in (pair.first, pair.second))
        return {body: _going(body, h) for body in bodies}

    def _parts(self, h: float) -> int:
        """Of h s, in which nothing goes too far; a power of 2."""
        parts, turns, goings = 1.0, 0.0, self._goings(h)
        for meeting, first, second, thick in self._fast:
            if not meeting.is_on:
                continue
            one, other = goings[first], goings[second]
            goes = h * one.relative_to(other)
            turns = max(turns, h * one.turning, h * other.turning)
            if goes > SHARE * thick:
                parts = max(parts, goes / (SHARE * max(thick, _gap(first, second, one, other))))
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
        why = "as bodies would have gone through others, or themselves"
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


def _going(body: AnyBody, h: float) -> _Going:
    """How a body goes in a step of h s."""
    if not isinstance(body, Soft):
        v, turning = _rates(body, h)
        return _Going(v, turning * body.size if turning else 0.0, turning)
    velocities = body.point_velocities()
    mean = velocities.mean(axis=0)
    return _Going(mean, float(np.sqrt(np.square(velocities - mean).sum(axis=1).max())), 0.0)


def _acceleration(body: AnyBody) -> float:
    """Of what moves freely, m/s²: by its weight, and as in the last step; of soft ones nobody knows."""
    if not isinstance(body, Rigid):
        return 0.0
    return float(np.linalg.norm(body.gravity) + np.linalg.norm(body.turning[2]))


def _gap(first: AnyBody, second: AnyBody, one: _Going, other: _Going) -> float:
    """Between two bodies, at least, m: of the ball around either, or the points of a soft one, from the other one."""
    if first is second:
        return 0.0
    if isinstance(first, Soft) and isinstance(second, Soft):
        way = other.velocity - one.velocity
        axes = np.concatenate([np.eye(3), [way / max(float(np.linalg.norm(way)), 1e-300)]])
        here, there = first.places().dot(axes.T), second.places().dot(axes.T)
        return float(max((there.min(axis=0) - here.max(axis=0)).max(), (here.min(axis=0) - there.max(axis=0)).max()))
    gaps = [0.0]
    for body, other_body in ((first, second), (second, first)):
        if not isinstance(other_body, Soft):
            there = other_body.lies()
            seen, radius = (body.places(), 0.0) if isinstance(body, Soft) else (body.pose.position[None], body.size)
            gaps.append(float(there.distance(seen)[0].min()) - radius)
    return max(gaps)
