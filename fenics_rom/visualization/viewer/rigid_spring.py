"""The spring between the mouse and a point of a rigid body, with a dashpot that makes it come to rest.

In the middle of a step the point is at ŷ = y + h/2 v̂, v̂ = v + h/2 (C f + g), where C is what a force at the point does
to its acceleration. The spring's own part is solved for, which keeps it stable at any step; forces of contact are left
out.
"""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.frame_motion import cross_matrix, rotation_matrix

SAG = 0.2  # of the body's radius that it hangs below the mouse, on the ground's gravity
STANDARD_GRAVITY = 9.80665  # m/s2: also of a world without it
MOST_WEIGHTS = 10.0  # that the mouse pulls with


class RigidMouseSpring:
    """A spring to one point of a rigid body.

    Args:
        mass: of the body, kg.
        inertia: (3, 3) about its centre of mass, in its axes, kg m².
        radius: of the body, m.
        pose: where it is.
        place: of the point now, (3,), m.

    Attributes:
        stiffness: of the spring, N/m.
        largest: force, N.
    """

    def __init__(self, mass: float, inertia: Array, radius: float, pose: BaseState, place: Array):
        self._mass, self._inverse = mass, np.linalg.inv(inertia)
        self._arm = rotation_matrix(pose.rotation).T @ (place - pose.position)
        self.stiffness = mass * STANDARD_GRAVITY / (SAG * radius)
        self._damping = 2 * np.sqrt(mass * self.stiffness)  # critical of the centre of mass
        self.largest = MOST_WEIGHTS * mass * STANDARD_GRAVITY

    def place(self, pose: BaseState) -> Array:
        """Where the point is, (3,), m."""
        return pose.position + rotation_matrix(pose.rotation) @ self._arm

    def force(self, pose: BaseState, gravity: Array, target: Array, h: float) -> tuple[Array, Array]:
        """What it pulls with in a step of h s, (3,), N, and its torque about the centre of mass, N m."""
        R = rotation_matrix(pose.rotation)
        arm = R @ self._arm
        turns = cross_matrix(arm)
        C = np.eye(3) / self._mass - turns @ R @ self._inverse @ R.T @ turns
        velocity = pose.velocity + np.cross(pose.angular_velocity, arm) + h / 2 * gravity
        drag = self._damping + h / 2 * self.stiffness  # of v̂
        drive = self.stiffness * (target - pose.position - arm) - drag * velocity
        f = np.linalg.solve(np.eye(3) + drag * h / 2 * C, drive)
        if (size := float(np.linalg.norm(f))) > self.largest:
            f *= self.largest / size
        return f, np.cross(arm, f)
