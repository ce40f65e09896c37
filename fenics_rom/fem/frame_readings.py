"""A full-order body in a moving frame, whose fields are in the frame, as it is in world axes."""

from numpy import ndarray as Array

from fenics_rom.fem.full_order_body import FullOrderBody
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.frame_motion import world_displacement, world_velocity
from fenics_rom.system.moving_frame import FullOrderFrame


class ReadInWorldAxes(FullOrderBody):
    """Arguments and attributes as in FullOrderBody; x and v are displacement and its rate in the frame."""

    _frame: FullOrderFrame

    @property
    def pose(self) -> BaseState:
        """Where the frame is and how it moves, in world axes."""
        raise NotImplementedError

    def displacement(self, output: str | None = None) -> Array:
        """As in FullOrderBody, in world axes."""
        rest = self._rest(output)
        return world_displacement(self.pose, self._frame.origin, rest, super().displacement(output))

    def velocity(self, output: str | None = None) -> Array:
        """As in FullOrderBody, in world axes."""
        fields = super().displacement(output), super().velocity(output)
        return world_velocity(self.pose, self._frame.origin, self._rest(output), *fields)

    def point_displacement(self) -> Array:
        """As in FullOrderBody, in world axes."""
        assert self.interface is not None
        rest = self.interface.points.coordinates
        return world_displacement(self.pose, self._frame.origin, rest, super().point_displacement())

    def _rest(self, output: str | None) -> Array:
        return self.system.body.nodes if output is None else self._frame.output_points[output]
