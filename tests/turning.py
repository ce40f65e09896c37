"""Motions of obstacles that turn, and their tables."""

import numpy as np

import fenics_rom as fr
from fenics_rom.mechanics.frame_motion import quaternion_of_vector

NOTHING = np.zeros(3)


def spin(origin, axis, rate, ramp=0.3):
    """About an axis through a point that stays, from rest: its rate, rad/s, grows evenly for some time, s."""
    axis = np.array(axis, dtype=float)

    def motion(time):
        angle = rate * time**2 / 2 / ramp if time < ramp else rate * (time - ramp / 2)
        return fr.BaseState(
            np.array(origin), quaternion_of_vector(angle * axis), NOTHING, rate * min(time / ramp, 1) * axis
        )

    return motion


def path_of(motion, duration, rows=41):
    states = [motion(time) for time in np.linspace(0, duration, rows)]
    return fr.BasePath(np.linspace(0, duration, rows), *(np.array(part) for part in zip(*states, strict=True)))


def csv_of(path):
    """Its poses and twists."""
    heading = "time (s),position.x,position.y,position.z,rotation.w,rotation.x,rotation.y,rotation.z"
    heading += ",velocity.x,velocity.y,velocity.z,angular_velocity.x,angular_velocity.y,angular_velocity.z"
    columns = (path.positions, path.rotations, path.velocities, path.angular_velocities)
    rows = np.column_stack([path.times, *columns]).tolist()
    return "\n".join([heading, *(",".join(map(repr, row)) for row in rows)])
