"""How near an obstacle has to be for its contact to matter in a step."""

import math

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.contact import ObstacleMotion, PointMotion


def reach_of(points: PointMotion, rest: Array, obstacles: ObstacleMotion, dt: float) -> float:
    """The largest gap, m, with which points at rest (P, 3), m, can be due by the rigid law in a step of dt, s.

    A pair is due at a normal velocity below -g/h, or below (-g/h + a/2)/2: nothing is that closes less than a bound of
    both, whatever direction things move in.
    """
    speeds = obstacles.velocities(dt), obstacles.velocities_before
    if obstacles.turns:
        speeds = obstacles.velocities_at(rest + points.displacement, dt)
    w = max(np.abs(each).max() for each in speeds)
    return reach_at(dt, float(np.abs(points.free_velocity).max()), float(np.abs(points.velocity).max()), float(w))


def reach_at(dt: float, free: float, start: float, w: float) -> float:
    """The same of points whose speeds are at most these without contact and at the start, and those of obstacles w."""
    return dt * math.sqrt(3) * (2 * free + start + 3 * w)
