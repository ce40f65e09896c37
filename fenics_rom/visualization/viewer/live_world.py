"""A world that is stepped while somebody pulls at one of its bodies. No picture."""

import math
from collections.abc import Callable, Mapping
from time import perf_counter
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.rom.given_rom import given_rom
from fenics_rom.visualization.viewer.actuators import Actuator, actuators_of
from fenics_rom.visualization.viewer.live import Account, Live
from fenics_rom.visualization.viewer.mouse_spring import MouseSpring, MouseSpringStep, attach_spring, spring_step
from fenics_rom.visualization.viewer.rigid_spring import RigidMouseSpring
from fenics_rom.world.records import RigidBody, SoftBody
from fenics_rom.world.world import World

Inputs = Mapping[str, Mapping[str, Any]]


class LiveWorld(Live):
    """Steps a world under a mouse and the actuators of its soft bodies.

    Args:
        world: of which another one is stepped, from the start.
        history: inputs of a world in a step with its middle at a time, s, by body, by name, to which those of the
            actuators are added; None: there are none.

    Attributes:
        world: as it is now.
        roms: of the soft bodies, by name.
        held: the body that the mouse holds; None: it holds none.
    """

    def __init__(self, world: World, history: Callable[[float, World], Inputs] | None = None):
        self.world, self._history = world.anew(), history
        soft = {name: body for name, body in world.bodies.items() if isinstance(body, SoftBody)}
        self.roms = {name: given_rom("SoftBody", body.rom) for name, body in soft.items()}
        found: list[Actuator] = []
        self._columns: dict[str, dict[str, slice]] = {}  # of the actuators of each soft body
        for name, rom in self.roms.items():
            ends = len(found) + np.cumsum([0, *rom.actuators.values()])
            self._columns[name] = dict(zip(rom.actuators, map(slice, ends[:-1], ends[1:]), strict=True))
            found += [one._replace(name=f"{name} {one.name}") for one in actuators_of(rom)]
        super().__init__(found)
        self.held: str | None = None
        self._spring: MouseSpringStep | RigidMouseSpring | None = None

    @property
    def dt(self) -> float:
        """As in Live."""
        return self.world.dt

    @dt.setter
    def dt(self, dt: float) -> None:
        self.world.dt = dt
        if isinstance(pull := self._spring, MouseSpringStep):
            self._hold_soft(pull.spring, pull.nodes, pull.weights)

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
        ledger = self.world.ledger
        return Account(
            self.world.energy, ledger.supplied, ledger.dissipated, ledger.lost_in_switching, ledger.numerical
        )

    def grab_rigid(self, name: str, place: Array) -> bool:
        """Takes hold of a rigid body at a place (3,), m; False of one that moves as it is told."""
        record = self.world.bodies[name]
        assert isinstance(record, RigidBody)
        if record.is_driven:
            return False
        self.release()
        mass, inertia = record.mass_and_inertia()
        assert record.shape is not None
        self._spring = RigidMouseSpring(mass, inertia, record.shape.radius_around, self.world.pose(name), place)
        self.held, self.mouse = name, place
        return True

    def grab_soft(self, name: str, contact: str, nodes: Array, weights: Array) -> bool:
        """Takes hold of a point of a contact surface of a soft body; see `LiveBody.grab`."""
        spring = attach_spring(self.roms[name], contact, nodes, weights)
        if spring is None:
            return False
        self.release()
        body, self.held = self.world.simulator(name), name
        body.keeps_contact_mode = True
        body.switch(contact)
        self._hold_soft(spring, nodes, weights)
        assert self.held_at is not None
        self.mouse = self.held_at
        return True

    def _hold_soft(self, spring: MouseSpring, nodes: Array, weights: Array) -> None:
        assert self.held is not None
        body, rom = self.world.simulator(self.held), self.roms[self.held]
        self._spring = spring_step(body, rom, spring, nodes, weights)

    def release(self) -> None:
        """As in Live."""
        if self.held in self.roms:
            self.world.simulator(self.held).keeps_contact_mode = False
        self.held, self._spring, self.force = None, None, np.zeros(3)

    @property
    def contact(self) -> str | None:
        """The contact mode of a soft body that the mouse holds; None: it holds none."""
        return self._spring.spring.contact if isinstance(self._spring, MouseSpringStep) else None

    @property
    def held_at(self) -> Array | None:
        """As in Live."""
        if self.held is None:
            return None
        if isinstance(self._spring, RigidMouseSpring):
            return self._spring.place(self.world.pose(self.held))
        assert self._spring is not None
        R, p = self._axes(self.held)
        return p + R @ self._spring.place(self.world.simulator(self.held))

    @property
    def largest_force(self) -> float:
        """As in Live."""
        spring = self._spring.spring if isinstance(self._spring, MouseSpringStep) else self._spring
        return math.inf if spring is None else spring.largest

    def _axes(self, name: str) -> tuple[Array, Array]:
        """Of a soft body in the world, which its steps are in: rotation (3, 3) and origin (3,), m."""
        if self.roms[name].environment.is_moving:
            return np.eye(3), np.zeros(3)
        pose = self.world.pose(name)
        return rotation_matrix(pose.rotation), pose.position

    def _take_step(self) -> float:
        inputs = self._inputs()
        if isinstance(self._spring, RigidMouseSpring) and self.held is not None:
            pose, gravity = self.world.pose(self.held), np.array(self.world.gravity)
            self.force, torque = self._spring.force(pose, gravity, self.mouse, self.dt)
            inputs[self.held] = {"force": self.force, "torque": torque}
        elif isinstance(self._spring, MouseSpringStep) and self.held is not None:
            self._pull_soft(self.held, self._spring, inputs[self.held])
        begin = perf_counter()
        self.world.step(inputs)
        return perf_counter() - begin

    def _inputs(self) -> dict[str, dict[str, Any]]:
        """Of all actuators in the next step."""
        given = self._history(self.time + self.dt / 2, self.world) if self._history else {}
        return {
            name: {
                actuator: self.values[columns] + given.get(name, {}).get(actuator, 0.0)
                for actuator, columns in of_body.items()
            }
            for name, of_body in self._columns.items()
        }

    def _pull_soft(self, name: str, pull: MouseSpringStep, inputs: dict[str, Any]) -> None:
        """Adds the mouse to the inputs of a soft body."""
        body, (R, p) = self.world.simulator(name), self._axes(name)
        if body.contact != pull.spring.contact:  # among the obstacles of its scene, where it is alone
            self.release()
            return
        others = [np.atleast_1d(body.reactions.get(actuator, value)) for actuator, value in inputs.items()]
        force, pushes = pull.force(body, np.concatenate([np.empty(0), *others]), R.T @ (self.mouse - p))
        self.force = R @ force
        inputs[pull.spring.contact] = pushes

    def reset(self) -> None:
        """As in Live."""
        self.release()
        self.values[:] = 0
        self.world = self.world.anew()
