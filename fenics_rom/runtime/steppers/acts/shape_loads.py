"""What acts on the shape of a held body: loads whose direction stays, those that follow it, and forces to be found."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.acts.following import FollowingLoads
from fenics_rom.runtime.steppers.acts.found_forces import FoundForces


class ShapeLoads:
    """Of one contact mode.

    Args:
        rom: the reduced models.
        model: of the contact mode.
        found: forces of actuators that are found in steps; None: there are none.

    Attributes:
        dead: forces of inputs of 1 whose direction stays, (m, p); 0 of others.
        following: what turns with the body; None: nothing does.
    """

    def __init__(self, rom: Rom, model: ContactModel, found: FoundForces | None):
        self._found, self.following = found, FollowingLoads.of(rom, model.inputs.shape[1])
        self.dead = model.inputs.copy()
        self._followers = [] if self.following is None else self.following.followers
        self.dead[:, [column for column, _ in self._followers]] = 0.0

    def force(self, u: Array, q: Array) -> Array:
        """Generalized forces (m,) of the inputs u (p,) on the body at q."""
        return self.with_followers(self.dead.dot(u), u, q)

    def with_followers(self, dead: Array, u: Array, q: Array) -> Array:
        """The same, where those of loads whose direction stays (m,) are known."""
        force = dead
        for column, follower in self._followers:  # not by FollowingLoads: this is asked for twice in a short step
            if size := u.item(column):
                force = force + size * follower.force(q)
        return force

    def all_columns(self, q: Array) -> Array:
        """Those of inputs of 1, and of 1 of what is found, (m, p)."""
        columns = self.dead.copy()
        for column, follower in self._followers:
            columns[:, column] = follower.force(q)
        if self._found is not None:
            columns[:, self._found.actuators.columns] = self._found.columns(q)
        return columns

    def slope(self, u: Array, reactions: Array, q: Array) -> Array:
        """∂/∂q (m, m) of the forces of the inputs, and of what is found, (n,)."""
        slope = np.zeros((len(q), len(q))) if self.following is None else self.following.slope(u, q)
        return slope if self._found is None else slope + self._found.slope(reactions, q)

    def without_found(self, u: Array) -> Array:
        """An input (p,) with 0 for what is found."""
        return u if self._found is None else self._found.actuators.split(u)[0]

    def with_found(self, u: Array, reactions: Array) -> Array:
        """An input (p,) with the forces (n,) that were found in place of strokes."""
        if self._found is None:
            return u
        forces = self.without_found(u)
        forces[self._found.actuators.columns] = reactions
        return forces
