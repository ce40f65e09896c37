"""Where a carried body is mounted on the one that carries it, and how it is moved there."""

import numpy as np

from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.frame_geometry import vector
from fenics_rom.mechanics.frame_motion import added, composed, cross, rotated, rotation_of
from fenics_rom.world.driven import Driven


class Mount:
    """A place on a body that moves as it is told.

    Args:
        carrier: that body.
        place: in the carrier's axes, from its centre of mass; velocities do not count.
    """

    def __init__(self, carrier: Driven, place: BaseState):
        self.carrier, self._at = carrier, vector(place.position)
        w, x, y, z = place.rotation.tolist()
        self._turn = w, x, y, z
        self._is_centre = not place.position.any() and abs(w) == 1.0

    @property
    def start(self) -> BaseState:
        """Of the step, in world axes."""
        return self._moved(self.carrier.pose)

    @property
    def end(self) -> BaseState:
        """Where the step that the carrier has begun leads, in world axes."""
        return self._moved(self.carrier.end)

    def _moved(self, carrier: BaseState) -> BaseState:
        if self._is_centre:
            return carrier
        w, x, y, z = carrier.rotation.tolist()
        ω, arm = vector(carrier.angular_velocity), rotated(rotation_of(w, x, y, z), self._at)
        return BaseState(
            np.array(added(vector(carrier.position), 1.0, arm)),
            np.array(composed((w, x, y, z), self._turn)),
            np.array(added(vector(carrier.velocity), 1.0, cross(ω, arm))),
            carrier.angular_velocity,
        )
