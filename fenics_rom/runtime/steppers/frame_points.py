"""Points of a reduced body in a moving frame: where they are in it, and forces on them."""

from typing import NamedTuple

from numpy import ndarray as Array

from fenics_rom.mechanics.frame_geometry import Geometry, Push


class FramePoints(NamedTuple):
    """Points at X + V q in the frame."""

    rest: Array  # X (P, 3) from the frame's origin, m
    rows: Array  # Vᵀ of the points, (m, 3 P)

    def moved(self, q: Array) -> Array:
        """V q, (P, 3)."""
        moved: Array = q.dot(self.rows).reshape(-1, 3)
        return moved

    def of(self, some: Array) -> "FramePoints":
        """Some of them, (s,)."""
        rows = self.rows.reshape(len(self.rows), -1, 3)[:, some].reshape(len(self.rows), -1)
        return FramePoints(self.rest[some], rows)

    def modal_maps(self, turn: Geometry) -> Array:
        """Velocities (3 P, m) of unit r̂."""
        rows: Array = self.rows.reshape(len(self.rows), -1, 3).dot(turn.middle.T).reshape(len(self.rows), -1)
        return rows.T

    def push(self, forces: Array, turn: Geometry, arms: Array) -> Push:
        """Of forces (P, 3) in world axes, N, at arms (P, 3) from the origin, m."""
        return Push.of(forces, turn, arms, lambda inside: self.rows.dot(inside.ravel()))
