"""Looks at the skin of a body among obstacles, as its simulator has it."""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.frame_motion import world_displacement
from fenics_rom.mechanics.skin import Skin
from fenics_rom.mechanics.skin_watch import SkinWatch, displaced

if TYPE_CHECKING:
    from fenics_rom.runtime.steppers.contact_interface import ContactInterface

Simulator = Any  # fenics_rom.runtime.simulator's, which imports this file


class SkinPlaces:
    """Where the skin of a body is.

    Args:
        body: the simulator.
        skin: of it.
    """

    def __init__(self, body: Simulator, skin: Skin):
        self._body, self._skin = body, skin
        self._nodes = skin.nodes[skin.few_rows]
        self._rows = body.rom.rows_of(self._nodes).reshape(3 * len(self._nodes), -1)

    def few(self) -> Array:
        """Of those nodes that are looked at first, (f, 3), m, but for what contact points yield by themselves."""
        body = self._body
        rest = body.rom.nodes[self._nodes]
        field = (self._rows @ body.shape_coordinates).reshape(rest.shape)
        if body.pose is not None and body.rom.moving_frame is not None:
            field = world_displacement(body.pose, body.rom.moving_frame.origin, rest, field)
        return np.asarray(rest + field)

    def whole(self) -> Array:
        """Of all of its nodes, (V, 3), m."""
        return self._skin.places(self._body.displacement())


class SkinLooks:
    """Looks at the skin of a simulator.

    Args:
        body: the simulator.
        interface: its contact points and obstacles.
        watch: of its skin.
    """

    def __init__(self, body: Simulator, interface: "ContactInterface", watch: SkinWatch):
        self._body, self.watch, self.places = body, watch, SkinPlaces(body, watch.skin)
        self._springs = interface.solver.law.stiffness is not None

    def look(self) -> None:
        """At where the body and the obstacles are."""
        body, places = self._body, self.places
        there = displaced(body.environment.obstacles, body.environment.state.offsets)
        self.watch.look(body.steps, body.time, places.few(), places.whole, there, self._springs)
