"""One step of a full-order body in a moving frame, with what touches it and with forces that are found in it.

The sweeps of contact (`mechanics/frame_contact.py`) have the iteration of `frame_balance.py`. W only guides them:
S A⁻¹ Sᵀ, turned, with the coupling of turning and bending of a body which is free.
"""

import math
from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.fem.frame_balance import NO_PROGRESS, FrameBalance
from fenics_rom.fem.frame_coupling import NO_COUPLING
from fenics_rom.fem.frame_loads import FrameLoads
from fenics_rom.fem.full_order_body import FullOrderInterface
from fenics_rom.fem.nodal_frame import NodalFrame
from fenics_rom.fem.nodal_motion import Motion
from fenics_rom.mechanics.actuator_forces import ActuatorForces
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.contact import ContactSolution
from fenics_rom.mechanics.frame_geometry import Geometry, Push, arms_of, carried_along, turned_operator, turning_maps
from fenics_rom.mechanics.frame_motion import ZERO, Vector
from fenics_rom.mechanics.gas import Targets
from fenics_rom.mechanics.points_operator import Operator, operator_of


class ToFind(NamedTuple):
    """Forces z (n,) of actuators that a step finds; see mechanics.frame_contact."""

    actuators: ActuatorForces
    columns: Array  # (rows here, n) of forces of 1
    inputs: Array  # (p,) without them
    targets: Targets  # of the strokes
    loads_of: Callable[[Array], FrameLoads]  # an input (p,)

    def acting(self, z: Array) -> FrameLoads:
        """All loads, with the forces z (n,)."""
        acting = self.inputs.copy()
        acting[self.actuators.columns] = z
        return self.loads_of(acting)


class FrameStep(FrameBalance):
    """Arguments as in FrameBalance.

    Args:
        interface: the contact points; None where nothing can touch.
        found: forces that the step finds; None: there are none.
        reactions: of these (n,), in the step before.

    Attributes:
        tells_apart, found, reactions: see mechanics.frame_contact.
    """

    tells_apart = True

    def __init__(
        self,
        body: NodalFrame,
        now: Motion,
        h: float,
        loads: FrameLoads,
        base: BaseState | None,
        interface: FullOrderInterface | None,
        found: ToFind | None,
        reactions: Array,
    ):
        super().__init__(body, now, h, loads, base)
        self._interface, self.found, self.reactions = interface, found, reactions

    def no_progress(self, scale: float) -> float:
        """As in FrameBody of mechanics.frame_contact."""
        return NO_PROGRESS * scale

    @property
    def rubbed(self) -> Array:
        """Forces at guides (rows here,), N."""
        if self.found is None:
            return np.zeros(self._now.q.size)
        return self.found.actuators.parts(self.found.columns, self.reactions)[1]

    def act(self, z: Array) -> None:
        """As in ActuatedBody of mechanics.frame_contact."""
        assert self.found is not None
        self._loads, self.reactions = self.found.acting(z), z

    def found_at(self, x: Array) -> tuple[Array, Array, Array, Array | None]:
        """As in ActuatedBody of mechanics.frame_contact."""
        assert self.found is not None
        columns, inner = self.found.columns, self._body.inner
        coupling, zero = self._coupling(x), np.zeros(self._free)
        spread = np.stack([coupling.solve(zero, each) for each in self._body.inverted(columns, self.h).T], axis=1)
        rates = inner(columns, x[self._free :, None])[:, 0]
        return rates, inner(columns, spread[self._free :]), spread, None

    def moved(self, near: Array, turn: Geometry, arms: Array, change: Array) -> Array:
        """As in ActuatedBody of mechanics.frame_contact."""
        turning, inside = change[: self._free], self._seen_at(near, turn, change[self._free :])
        return turning_maps(turn, arms) @ turning + inside if self._free else inside

    def rates(self, x: Array) -> tuple[Array, Array]:
        """ω̂ (3,) in the frame's axes and r̂ (rows here,)."""
        if self._base is not None:
            return np.array(self._base.turn) / self.h, x
        return x[:3], x[3:]

    def spread(self, change: Push) -> Array:
        """What x changes by, where contact forces change by so much."""
        inside = self._body.inverted(change.modal.reshape(-1, 1), self.h)[:, 0]
        turning = np.array(change.turning)[: self._free]
        assert self._free == 0 or self._body.coupling is not None
        return (self._body.coupling or NO_COUPLING).solve(turning, inside, np.array(change.force))

    def scale(self, x: Array) -> float:
        """As in FrameBody of mechanics.frame_contact."""
        return self._speed(x) + math.sqrt(self._body.mass) * math.hypot(*self.translation(self.geometry(x), ZERO, x))

    def push(self, forces: Array, turn: Geometry, arms: Array) -> Push:
        """What forces (P, 3) on the contact points do, N in world axes."""
        interface = self._touched
        return Push.of(forces, turn, arms, lambda inside: (interface.Sᵀ @ inside.ravel()).reshape(-1, 3))

    def yielding(self, turn: Geometry, contact: ContactSolution | None) -> None:
        """Nothing: points go with their nodes."""

    def arms(self, turn: Geometry, rate: Array, yielding: Array | None = None) -> Array:
        """Of the contact points from the origin in the middle of a step, (P, 3), m."""
        moved = self._touched.at_points(rate.reshape(-1, 1))
        return arms_of(turn, self._places, self._places + self.h * moved)

    def velocities(self, turn: Geometry, arms: Array, x: Array, yielding: Array | None = None) -> Array:
        """Mid-step velocities (P, 3) of the contact points in world axes, less that of the origin, m/s."""
        ω̂, r̂ = self.rates(x)
        return carried_along(turn, arms, ω̂, self._touched.at_points(r̂.reshape(-1, 1)))

    def kept_velocities(self, turn: Geometry, arms: Array) -> Array:
        """Velocities (P, 3) of the contact points in world axes, m/s, by those of the body at the start of the step."""
        now = self._now
        inside = self._touched.at_points(now.r.reshape(-1, 1))
        along = (turn.start if self._base is None else turn.middle) @ now.v
        velocities: Array = carried_along(turn, arms, now.ω, inside) + along
        return velocities

    def translation(self, turn: Geometry, contact: Vector, x: Array) -> Array:
        """As in FrameBody of mechanics.frame_contact."""
        now, body = self._now, self._body
        if self._base is not None:
            along: Array = turn.middle @ (now.v + self._v_end) / 2
            return along
        if (tied := self.tied(x, turn, contact)) is not None:
            return tied.velocity
        force: Array = self._loads.resultant(body, turn) + contact
        return turn.start @ now.v + self.h / 2 / body.mass * force

    def delassus(self, near: Array, turn: Geometry, arms: Array) -> Array:
        """Mid-step velocities (3 s, 3 s) of those points (s,), at arms (s, 3), per force, m/s/N."""
        W = turned_operator(turn.middle, operator_of(self._inside, near), turn.middle)
        if self._base is None:
            coupling, maps = self._body.coupling, turning_maps(turn, arms)
            assert coupling is not None
            bent, bends = (self._seen_at(near, turn, field) for field in coupling.fields(self._body))
            if self._ties is not None:
                maps = np.hstack([np.tile(np.identity(3), (len(near), 1)), maps])
            W += (maps - bent) @ coupling.top @ (maps - bends).T
            for k in range(3 * (self._ties is None)):
                W[k::3, k::3] += self.h / 2 / self._body.mass
        return W

    def point_displacement(self) -> Array:
        """Of the contact points, (P, 3), m."""
        return self._now.position + self._places @ self._now.R.T - self._touched.points.coordinates

    def _seen_at(self, near: Array, turn: Geometry, columns: Array) -> Array:
        """Columns (rows here, 3) at those contact points (s,), in world axes, (3 s, 3)."""
        seen = [self._touched.at_points(column.reshape(-1, 1))[near] @ turn.middle.T for column in columns.T]
        return np.stack([each.ravel() for each in seen], axis=1)

    @cached_property
    def _places(self) -> Array:
        """Of the contact points in the frame, (P, 3), m."""
        rest = self._touched.points.coordinates - self._body.frame.origin
        places: Array = rest + self._touched.at_points(self._now.q.reshape(-1, 1))
        return places

    @property
    def _inside(self) -> Operator:
        """S A⁻¹ Sᵀ."""
        return self._body.compliance(self.h, self._touched)

    @property
    def _touched(self) -> FullOrderInterface:
        assert self._interface is not None
        return self._interface
