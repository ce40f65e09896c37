"""How near an obstacle has to be for its contact to matter in a step."""

import math

import numpy as np

from fenics_rom.mechanics.contact import ObstacleMotion, PointMotion


def reach_of(points: PointMotion, obstacles: ObstacleMotion, dt: float) -> float:
    """The largest gap, m, with which a pair of the rigid law can be due in a step of dt, s.

    A pair is due at a normal velocity below -g/h, or below (-g/h + a/2)/2: nothing is that closes less than a bound of
    both, whatever direction things move in.
    """
    w = max(np.abs(obstacles.velocities(dt)).max(), np.abs(obstacles.velocities_before).max())
    return reach_at(dt, float(np.abs(points.free_velocity).max()), float(np.abs(points.velocity).max()), float(w))


def reach_at(dt: float, free: float, start: float, w: float) -> float:
    """The same of points whose speeds are at most these without contact and at the start, and those of obstacles w."""
    return dt * math.sqrt(3) * (2 * free + start + 3 * w)
