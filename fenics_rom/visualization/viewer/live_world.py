"""A world that is stepped while somebody pulls at one of its bodies. No picture."""

from collections.abc import Callable, Mapping
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.visualization.viewer.actuators import Actuator, actuators_of
from fenics_rom.visualization.viewer.live import Account, Live
from fenics_rom.visualization.viewer.mouse_spring import MouseSpringStep, attach_spring, spring_step
from fenics_rom.visualization.viewer.rigid_spring import RigidMouseSpring
from fenics_rom.world.records import RigidBody
from fenics_rom.world.world import World

Inputs = Mapping[str, Mapping[str, Any]]


class _Hold(NamedTuple):
    """What the mouse holds: a body, by a spring."""

    body: str
    spring: MouseSpringStep | RigidMouseSpring


class LiveWorld(Live):
    """Steps a world under a mouse and the actuators of its soft bodies.

    Args:
        world: of which another one is stepped, from the start.
        history: inputs at a time, s, by body, by name, to which those of the actuators are added; None: there are none.

    Attributes:
        world: as it is now.
    """

    def __init__(self, world: World, history: Callable[[float], Inputs] | None = None):
        self.world, self._history = world.anew(), history
        found: list[Actuator] = []
        self._columns: dict[str, dict[str, slice]] = {}  # of the actuators of each soft body
        for name in self.soft_names:
            rom, first = world.simulator(name).rom, len(found)
            found += [one._replace(name=f"{name} {one.name}") for one in actuators_of(rom)]
            ends = first + np.cumsum([0, *rom.actuators.values()])
            self._columns[name] = dict(zip(rom.actuators, map(slice, ends[:-1], ends[1:]), strict=True))
        super().__init__(found)
        self._hold: _Hold | None = None

    @property
    def soft_names(self) -> list[str]:
        """Of the soft bodies."""
        return [name for name, body in self.world.bodies.items() if not isinstance(body, RigidBody)]

    @property
    def dt(self) -> float:
        """As in Live."""
        return self.world.dt

    @dt.setter
    def dt(self, dt: float) -> None:
        self.world.dt = dt
        if self._hold is not None and isinstance(pull := self._hold.spring, MouseSpringStep):
            self._hold_soft(self._hold.body, pull)

    @property
    def time(self) -> float:
        """As in Live."""
        return self.world.time

    @property
    def warnings(self) -> tuple[str, ...]:
        """As in Live."""
        return self.world.warnings

    @property
    def account(self) -> Account:
        """As in Live."""
        return Account(self.world.energy, *(sum(parts) for parts in self.world.ledger.sums[:4]))

    def grab_rigid(self, name: str, place: Array) -> bool:
        """Takes hold of a rigid body at a place (3,), m; False of one that moves as it is told."""
        record = self.world.bodies[name]
        assert isinstance(record, RigidBody)
        if record.motion is not None:
            return False
        self.release()
        spring = RigidMouseSpring(*record.mass_and_inertia(), record.shape.radius_around, self.world.pose(name), place)
        self._hold, self.mouse = _Hold(name, spring), place
        return True

    def grab_soft(self, name: str, contact: str, nodes: Array, weights: Array) -> bool:
        """Takes hold of a point of a contact surface of a soft body, as `LiveBody.grab`, until it is another mode's."""
        body = self.world.simulator(name)
        spring = attach_spring(body.rom, contact, nodes, weights)
        if spring is None:
            return False
        self.release()
        body.keeps_contact_mode = True
        body.switch(contact)
        self._hold_soft(name, spring_step(body, body.rom, spring, nodes, weights))
        assert self.held_at is not None
        self.mouse = self.held_at
        return True
