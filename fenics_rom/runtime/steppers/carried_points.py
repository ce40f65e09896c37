"""How points of a body move in a step in which the base that carries it moves as given.

A point at y in the frame when the step begins, which moves in it by h û, is at a = ½ (R + R⁺) y + h/2 R⁺ û from the
origin in the middle of the step, and goes by h times Ω a + R* û beside the origin, Ω = (R* ω̂)~. As R, R⁺ and Ω are
given, both are one product with [y, û], which is the same as long as the base does not turn.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.frame_geometry import Geometry, vector
from fenics_rom.mechanics.frame_motion import Rotation, Vector, cross_matrix

Turn = tuple[Rotation, Rotation, Vector]


class CarriedPoints(NamedTuple):
    """In one step."""

    turn: Turn  # R, R⁺ and h ω̂
    middle: Array  # R* (3, 3)
    outward: Array  # R* + h/2 Ω R⁺ (3, 3), by which points move in world axes per û
    maps: Array  # (6, 6): of the rows [y, û] the columns [a, Ω a + R* û]

    @classmethod
    def of(cls, turn: Geometry, h: float, known: "CarriedPoints | None") -> "CarriedPoints":
        """In a step of h s that turns the frame so; known: of a step before."""
        key = turn.before, turn.after, turn.turn
        if known is not None and known.turn == key:
            return known
        Ω = cross_matrix(turn.middle.dot(turn.turn) / h)
        whole, half = (turn.start + turn.end) / 2, h / 2 * turn.end
        outward, maps = turn.middle + Ω.dot(half), np.empty((6, 6))
        maps[:3, :3], maps[:3, 3:], maps[3:, :3], maps[3:, 3:] = whole.T, Ω.dot(whole).T, half.T, outward.T
        return cls(key, turn.middle, outward, maps)

    def moved(self, start: Array, inside: Array, origin: Array) -> tuple[Array, Array]:
        """Arms, m, and mid-step velocities, m/s, (P, 3) in world axes, of points from `start` on that move `inside`."""
        both = np.concatenate([start, inside], axis=1).dot(self.maps)
        return both[:, :3], both[:, 3:] + origin


def seen(forces: Array, arms: Array, turn: Geometry) -> tuple[Vector, Vector]:
    """Force, N, and torque about the origin, N m, of forces (P, 3) at arms (P, 3), as the frame sees them."""
    (_, xy, xz), (yx, _, yz), (zx, zy, _) = arms.T.dot(forces).tolist()
    return turn.seen(vector(forces.sum(axis=0))), turn.seen((yz - zy, zx - xz, xy - yx))
