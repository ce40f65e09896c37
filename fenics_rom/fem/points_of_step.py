"""How the contact points of a full-order body go in a step, in world axes, and what forces there do to its fields."""

from typing import cast

import numpy as np
from numpy import ndarray as Array

from fenics_rom.fem.full_order_body import FullOrderInterface
from fenics_rom.fem.nodal_motion import Motion
from fenics_rom.mechanics.contact import ContactSolution, PointMotion
from fenics_rom.mechanics.frame_geometry import Geometry, Push, arms_of, carried_along, turned_operator
from fenics_rom.mechanics.frame_motion import cross_matrix
from fenics_rom.mechanics.points_operator import Operator, TurnedPoints


class PointsOfStep:
    """Of a body whose fields are in world axes; every rank must call every method.

    Args:
        interface: the contact points.
        x, v: displacement and velocity (rows here, 1) where the step begins, m and m/s.
        h: s, of a step by which points go far; 0: they stay near where it begins.

    Attributes:
        interface: as given.
        displacement: (P, 3) where the step begins, m.
        turn: rad, by which `operator` may be off: forces that change by δ move points otherwise by so much of W δ.
    """

    turn = 0.0

    def __init__(self, interface: FullOrderInterface, x: Array, v: Array, h: float = 0.0):
        self.interface, self._half = interface, h / 2
        self.displacement, self._velocity = interface.at_points(x), interface.at_points(v)

    def velocities(self, v: Array) -> Array:
        """Of a mid-step velocity (rows here, 1), (P, 3), m/s."""
        return self.interface.at_points(v)

    def motion(self, v: Array, free: Array) -> PointMotion:
        """Near that mid-step velocity, with the free velocities (P, 3)."""
        middle = None
        if self._half and self.interface.touches_itself:
            middle = self.interface.points.coordinates + self.displacement + self._half * self.velocities(v)
        return PointMotion(self.displacement, self._velocity, free, middle)

    def seen(self, forces: Array) -> Array:
        """Forces (P, 3) as the fields have them, N."""
        return forces

    def force(self, contact: ContactSolution | None) -> Array:
        """Of contact in the step on the fields, (rows here, 1), N."""
        return self.interface.force(contact)

    def force_before(self, contact: ContactSolution | None) -> Array:
        """The same of contact in an equilibrium that the step begins with."""
        return self.interface.force(contact)

    def operator(self, W: Operator) -> Operator:
        """A Delassus operator (3 P, 3 P) of the fields in world axes."""
        return W

    def spread(self, X: Array) -> Array:
        """Velocities (3 P, any) of the points as the fields have them, in world axes."""
        return X


class CarriedPoints(PointsOfStep):
    """Of a body whose fields are in the frame of a base that carries it.

    Args:
        interface: the contact points.
        origin: of the frame where the body is at rest, (3,), m.
        state: displacement and its rate (rows here, 1) where the step begins, m and m/s.
        start: the body there.
        end: where the base is then, (3,), m.
        turn: how it turns.
        twist: v̂ and ω̂ (3,) of the base in its axes in the middle of the step; None: equilibria know places alone.
        h: s.
    """

    def __init__(
        self,
        interface: FullOrderInterface,
        origin: Array,
        state: tuple[Array, Array],
        start: Motion,
        end: Array,
        turn: Geometry,
        twist: tuple[Array, Array] | None,
        h: float,
    ):
        self.interface, self._turn, self._h = interface, turn, h
        rest = interface.points.coordinates
        self._places = rest - origin + interface.at_points(state[0])
        self.displacement = start.position + self._places @ start.R.T - rest
        self._start, self._moved = start, interface.at_points(state[1])
        self._at_rest, self._turned = twist is None, cast("tuple[Operator, Operator] | None", None)
        if twist is None:
            self._inward = self._outward = turn.end
            self._given = (end - start.position) / h + self._places @ (turn.end - start.R).T / h
            return
        v̂, ω̂ = twist
        self.turn, self._inward = float(h * np.linalg.norm(ω̂)) / 2, turn.middle
        Ω = cross_matrix(turn.middle @ ω̂)
        self._outward = turn.middle + h / 2 * Ω @ turn.end
        self._given = turn.middle @ v̂ + self._places @ (Ω @ (turn.start + turn.end) / 2).T

    def velocities(self, v: Array) -> Array:
        """As in PointsOfStep."""
        velocities: Array = self._given + self.interface.at_points(v) @ self._outward.T
        return velocities

    def motion(self, v: Array, free: Array) -> PointMotion:
        """As in PointsOfStep; of points that stick by how they would go on with the velocities of the start."""
        if self._at_rest:
            return PointMotion(self.displacement, np.zeros_like(free), free)
        now = self._start
        before = carried_along(self._turn, self.arms(v), now.ω, self._moved) + self._turn.middle @ now.v
        return PointMotion(self.displacement, before, free)

    def arms(self, v: Array) -> Array:
        """From the origin in the middle of the step, or at rest at its end, (P, 3), m."""
        ends = self._places + self._h * self.interface.at_points(v)
        return ends @ self._turn.end.T if self._at_rest else arms_of(self._turn, self._places, ends)

    def push(self, contact: ContactSolution, v: Array) -> Push:
        """What contact forces do, but for `modal`."""
        return Push.of(contact.forces, self._turn, self.arms(v), lambda inside: inside)

    def seen(self, forces: Array) -> Array:
        """As in PointsOfStep."""
        return forces @ self._inward

    def force(self, contact: ContactSolution | None) -> Array:
        """As in PointsOfStep."""
        return self._pushed(contact, self._inward)

    def force_before(self, contact: ContactSolution | None) -> Array:
        """As in PointsOfStep."""
        return self._pushed(contact, self._turn.start)

    def operator(self, W: Operator) -> Operator:
        """As in PointsOfStep; its symmetric part, to the first order of the turn."""
        if self._turned is None or self._turned[0] is not W:
            mean = (self._inward + self._outward) / 2
            self._turned = W, turned_operator(mean, W, mean) if isinstance(W, np.ndarray) else TurnedPoints(W, mean)
        return self._turned[1]

    def spread(self, X: Array) -> Array:
        """As in PointsOfStep."""
        mean = (self._inward + self._outward) / 2
        spread: Array = (mean @ X.reshape(-1, 3, X.shape[1])).reshape(X.shape)
        return spread

    def _pushed(self, contact: ContactSolution | None, R: Array) -> Array:
        seen = None if contact is None else contact._replace(forces=contact.forces @ R)
        return self.interface.force(seen)
