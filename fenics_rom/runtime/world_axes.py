"""What outputs of many bodies in frames that move are in world axes."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.frame_motion import rotation_of
from fenics_rom.rom.moving_frame import MovingFrame


def world_outputs(frame: MovingFrame, base: BaseState, output: str, field: Array) -> Array:
    """Displacements of points of an output that moved by (B, P, 3) in their frames, the same shape, m.

    `base`: the frames, of arrays (B, 3) and (B, 4).
    """
    rest = np.asarray(frame.output_points[output])
    moved: Array = base.position[:, None] + turned(base, rest - frame.origin + field) - rest
    return moved


def world_rates(frame: MovingFrame, base: BaseState, output: str, field: Array, rate: Array) -> Array:
    """Velocities of the same points that move with (B, P, 3) in their frames, m/s."""
    arms = turned(base, np.asarray(frame.output_points[output]) - frame.origin + field)
    spun = np.cross(base.angular_velocity[:, None], arms)
    velocity: Array = base.velocity[:, None] + spun + turned(base, rate)
    return velocity


def turned(base: BaseState, vectors: Array) -> Array:
    """Vectors (B, any, 3) in the axes of frames, in world axes."""
    R = np.moveaxis(np.array(rotation_of(*base.rotation.T)), 2, 0)
    seen: Array = vectors @ R.transpose(0, 2, 1)
    return seen
