"""A motion that follows poses as they come in: cubic from where the body is to the newest one.

It gets there in the time between the last two poses, by their stamps, at least a cycle, and then moves as they did.
Positions and velocities are continuous. A body whose poses stop arriving comes to rest within as much time again.
"""

from collections.abc import Callable

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.base_path import CONJUGATE, BasePath, BaseState, quaternion_product, rotation_vectors
from fenics_rom.mechanics.frame_motion import quaternion_of_vector
from fenics_rom_ros.messages import SECOND

Pose = tuple[Array, Array]  # position (3,), m, and unit quaternion (4,), w x y z
LONGEST = 0.1  # s between two poses: beyond it they tell no velocity


class Follower:
    """Of one body.

    Args:
        motion: where it is at a time, s, until the first pose.
    """

    def __init__(self, motion: Callable[[float], BaseState]):
        self._motion, self._end = motion, np.inf
        self._pose: Pose | None = None
        self._stamp = 0  # ns
        self._way = (0.0, np.zeros(3), np.zeros(3))  # s, m and rad, from the pose before to this one
        self._is_new = False

    def __call__(self, time: float) -> BaseState:
        """Where it is at a time, s."""
        return self._motion(min(time, self._end))

    def take(self, pose: Pose, stamp: int) -> None:
        """Takes note of a pose, and when it was, ns."""
        if self._pose is not None and 0 < (seconds := (stamp - self._stamp) / SECOND) <= LONGEST:
            self._way = (seconds, *_between(self._pose, pose))
        else:
            self._way = (0.0, np.zeros(3), np.zeros(3))
        self._pose, self._stamp, self._is_new = pose, stamp, True

    def plan(self, time: float, cycle: float, speed: float, turning: float) -> tuple[float, float]:
        """Plans the way from a time on, s; how far from its pose that ends, m and rad.

        Where the pose is farther than the body gets at a speed, m/s, and turning, rad/s, it goes that way by these.
        """
        if self._pose is None or not (self._is_new or time > self._end - cycle / 2):
            return 0.0, 0.0
        here, (seconds, went, turned) = self(time), self._way
        way, turn = _between((here.position, here.rotation), self._pose)
        gap, angle = float(np.linalg.norm(way)), float(np.linalg.norm(turn))
        span = cycle * max(1, round(seconds / cycle))
        share = 1 / max(1.0, gap / (speed * span), angle / (turning * span))
        if share < 1:
            v, ω = share * way / span, share * turn / span
        elif self._is_new and seconds:
            v, ω = _at_most(went / seconds, speed), _at_most(turned / seconds, turning)
        else:
            v, ω = np.zeros(3), np.zeros(3)
        self._is_new = False
        ends = here.rotation, quaternion_product(quaternion_of_vector(share * turn), here.rotation)
        self._motion, self._end = (
            BasePath(
                np.array([time, time + span]),
                np.array([here.position, here.position + share * way]),
                np.array(ends),
                np.array([here.velocity, v]),
                np.array([here.angular_velocity, ω]),
            ),
            time + span,
        )
        return (1 - share) * gap, (1 - share) * angle


def _between(start: Pose, end: Pose) -> tuple[Array, Array]:
    """The way, m, and the turn, rad, in world axes, from a pose to another."""
    turn = quaternion_product(end[1], CONJUGATE * start[1])
    return end[0] - start[0], rotation_vectors(turn[None])[0]


def _at_most(vector: Array, most: float) -> Array:
    return vector / max(1.0, float(np.linalg.norm(vector)) / most)
