"""Loads that act on the moved body: pressures and tendons of a body that deforms largely."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.rom.deformation import ReducedRim
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.acts.followers import Follower, follower_loads


class FollowingLoads:
    """The inputs of a contact mode whose forces turn with what they act on.

    Args:
        followers: with the places of their inputs.
        rims: edges of pressures on open surfaces, with the places of their inputs.

    Attributes:
        followers, rims: as above.
        places: of the inputs of all of these, and of those with a rim.
    """

    def __init__(self, followers: list[tuple[int, Follower]], rims: list[tuple[int, ReducedRim]]):
        self.followers, self.rims = followers, rims
        self.places = [column for column, _ in followers], [column for column, _ in rims]

    @staticmethod
    def of(rom: Rom, width: int, found: "list[tuple[int, Follower]]") -> "FollowingLoads | None":
        """Those of a ROM with so many inputs, and what is found in steps; None where nothing follows.

        Args:
            rom: the reduced models.
            width: number p of inputs of the contact mode.
            found: what is found at guides, with its places counted from the first input that all contact modes share.
        """
        if rom.deformation is None:
            return None
        first = width - sum(rom.actuators.values()) - sum(rom.loads.values())
        followers = [(first + column, follower) for column, follower in [*follower_loads(rom), *found]]
        places, column = dict[str, int](), first
        for name, columns in rom.actuators.items():
            places[name], column = column, column + columns
        rims = [(places[name], rim) for name, rim in rom.deformation.rims.items()]
        return FollowingLoads(followers, rims) if followers else None

    def force(self, u: Array, q: Array) -> Array:
        """Generalized forces (m,) under u (p,) on the body at q."""
        force = np.zeros(len(q))
        for column, follower in self.followers:
            if size := u.item(column):
                force += size * follower.force(q)
        return force

    def slope(self, u: Array, q: Array) -> Array:
        """∂force/∂q (m, m)."""
        slope = np.zeros((len(q), len(q)))
        for column, follower in self.followers:
            if size := u.item(column):
                slope += size * follower.slope(q)
        return slope

    def wrench_slopes(self, u: Array, q: Array, origin: Array) -> Array:
        """What `wrench` changes by with q, (6, m)."""
        slopes = np.zeros((6, len(q)))
        for column, rim in self.rims:
            if size := u.item(column):
                slopes += size * rim.wrench_slopes(q, origin)
        return slopes

    def wrench(self, u: Array, q: Array, origin: Array) -> Array:
        """Force, N, and torque about an origin (3,), m, of pressures on open surfaces, (6,), in the frame's axes."""
        wrench = np.zeros(6)
        for column, rim in self.rims:
            if size := u.item(column):
                wrench += size * rim.wrench(q, origin)
        return wrench
