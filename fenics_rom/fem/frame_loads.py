"""What acts on a full-order body in a moving frame, but for contact."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.fem.nodal_frame import NodalFrame
from fenics_rom.fem.nodal_motion import Motion
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.frame_geometry import Geometry
from fenics_rom.system.system import System

KINDS = ("turning", "internal", "world")  # of forces: with the frame, from one part of the body to another, prescribed


class FrameLoads(NamedTuple):
    """Of one step, on the nodes here, (n, 3), N."""

    turning: Array  # with the frame
    internal: Array  # the part of them whose torque is that of the shape at rest
    world: Array  # in world axes
    on_held: Array  # (H, 3) with the frame, on nodes that the base holds
    world_on_held: Array  # (H, 3) in world axes, on these
    acceleration: Array  # (3,) of all mass alike: of gravity, and against that of a base that is shaken, m/s²

    @classmethod
    def of(cls, system: System, contact: str, B: Array, u: Array, environment: ActiveEnvironment) -> "FrameLoads":
        """Of inputs u (p,) of a contact mode, in the order of its columns B (rows here, p)."""
        frame, kinds, acting = system.moving_frame, list[str](), environment.environment
        fields, acceleration = acting.uniform_fields, np.zeros(3)
        assert frame is not None
        if u.shape != (B.shape[1],):
            raise ValueError
        kinds += ["turning"] * system.contacts[contact].shape[1]
        for name, columns in system.actuators.items():
            kinds += ["internal" if name in system.units else "turning"] * columns.shape[1]
        for name, columns in system.loads.items():
            if name in fields:
                acceleration = acceleration + u[len(kinds)] * fields[name]
                kinds.append("uniform")
            else:
                kinds += ["internal" if name in acting.inner_loads else "world"] * columns.shape[1]
        of = {kind: (B * u * (np.array(kinds) == kind)).sum(axis=1).reshape(-1, 3) for kind in KINDS}
        held = frame.forces_on_held(contact, len(u)) * u
        of |= {f"{kind} on held": held[:, :, np.array(kinds) == kind].sum(axis=2) for kind in KINDS}
        return cls(
            turning=of["turning"] + of["internal"],
            internal=of["internal"],
            world=of["world"],
            on_held=of["turning on held"] + of["internal on held"],
            world_on_held=of["world on held"],
            acceleration=acceleration,
        )

    def resultant(self, body: NodalFrame, turn: Geometry) -> Array:
        """Force (3,) in world axes."""
        turning, world = body.sum(np.hstack([self.turning, self.world])).reshape(2, 3)
        mean = (turn.start + turn.end) / 2
        force: Array = mean @ (turning + self.on_held.sum(axis=0)) + world + self.world_on_held.sum(axis=0)
        return force + body.mass * self.acceleration

    def on_nodes(self, body: NodalFrame, turn: Geometry) -> Array:
        """As the frame sees them, (n, 3)."""
        seen: Array = self.turning + self.world @ turn.middle
        return seen + body.mass_of_nodes * (self.acceleration @ turn.middle)

    def torque(self, body: NodalFrame, turn: Geometry, now: Motion, after: Motion) -> Array:
        """About the origin in world axes, (3,), in a step from one motion to another."""
        X, mean = body.frame.arms, (turn.start + turn.end) / 2
        q = (now.q + after.q) / 2
        arms = ((X + now.q) @ turn.start.T + (X + after.q) @ turn.end.T) / 2
        moment = (turn.start @ body.moment(now) + turn.end @ body.moment(after)) / 2
        turning = np.cross(X + q, self.turning) - np.cross(q, self.internal)
        torque, world = body.sum(np.hstack([turning, np.cross(arms, self.world)])).reshape(2, 3)
        held = body.frame.held_arms
        torque = torque + np.cross(held, self.on_held).sum(axis=0)
        world = world + np.cross(held @ mean.T, self.world_on_held).sum(axis=0)
        whole: Array = mean @ torque + world + np.cross(moment, self.acceleration)
        return whole
