"""What a body is to a step of several bodies.

A step tries forces until they fit: it begins all bodies, tries forces on their points, and tries better ones until the
velocities of the points obey the law of contact and the joints. Then it takes the last try. A body answers a try with
the exact mid-step velocities of its points, nonlinear as it may be; its Delassus operator, their derivative, only
guides the search.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.world.collision.contacts import PlacedShape, PlacedSurface

NO_ROWS = np.empty(0, dtype=int)


class Points(NamedTuple):
    """Where forces act on a body in a step: k places of contact, then j points of the body that joints hold.

    A joint that holds how bodies turn has couples, N m, for forces, and angular velocities, rad/s, for velocities.
    """

    nodes: Array  # (k + j, c) of a soft body, among its contact points
    weights: Array  # (k + j, c) of these
    arms: Array  # (j, 3) of a rigid body, in its axes from its centre of mass, m
    follows: Array  # (k + j,) where a soft body is pushed at the point of another one, which moves with its frame
    couples: Array = NO_ROWS  # (any,) rows of what are couples


class Body(Protocol):
    """A body within a step; forces and velocities are in world axes, (k + j, 3)."""

    @property
    def account(self) -> EnergyLedger:
        """Of its energy: `obstacles` is what contacts and joints supplied."""

    @property
    def energy(self) -> float:
        """Stored, J."""

    @property
    def pose(self) -> BaseState:
        """Where the body, or the frame of a soft body, is, and how it moves."""

    @property
    def is_driven(self) -> bool:
        """Whether it moves as it is told, whatever forces act."""

    @property
    def touches(self) -> bool:
        """Whether others can touch it; joints hold it in any case."""

    @property
    def has_inertia(self) -> bool:
        """Whether it moves by its inertia, or as it is told; without, it goes to an equilibrium in each step."""

    @property
    def yields(self) -> bool:
        """Whether each of its points yields by itself, beyond what the motions of the whole body allow."""

    @property
    def takes_couples(self) -> bool:
        """Whether it is soft and moves freely: two such bodies are pushed at the same places, so that momenta stay."""

    def take(self, inputs: Mapping[str, Any]) -> None:
        """Inputs of the next step by name; what is not named is 0. Raises StepError where there is no such input."""

    def begin(self, h: float) -> None:
        """Opens a step of h s; of 0 to look at where it is."""

    @property
    def size(self) -> float:
        """Radius of what holds it, m; infinite of a half-space."""

    def placed(self) -> PlacedShape | PlacedSurface | None:
        """As it is expected in the middle of the step; None: nothing touches it."""

    def travel(self) -> tuple[Array, float]:
        """How far it goes as a whole in the step, (3,), and how far a point of it may go beside that, m."""

    def swerve(self) -> tuple[Array, float]:
        """How much farther than `travel` says it goes as a whole as it was tried last, (3,), and a point beside, m."""

    @property
    def lead(self) -> Array:
        """How far it is expected to go in half of the step beyond what its velocity says, (3,), m."""

    def start_velocities(self, points: Points, places: Array) -> Array:
        """Of the points when the step begins, m/s."""

    def attempt(self, points: Points, places: Array, forces: Array) -> Array:
        """Mid-step velocities under forces, N.

        `places`: (k + j, 3), m, of all points in the middle of the step; a soft body, whose points are its own, writes.
        """

    def known_delassus(self, points: Points) -> Array | None:
        """`delassus` where it is known when a step begins, the same array as long as it is the same; else None."""

    def delassus(self, points: Points, places: Array) -> Array:
        """Mid-step velocities per force, (3 (k + j), 3 (k + j)), m/s/N."""

    def points_at(self, places: Array, where: str, couples: Array = NO_ROWS) -> Points:
        """Of a joint, where the body begins (j, 3), m; a SceneError, which begins with `where`, if it has none."""

    def inverse_mass(self, points: Points) -> Array | None:
        """End velocities of the points of joints per impulse, (3 j, 3 j), s/kg; None where that is not known."""

    def end_velocities(self, points: Points) -> Array:
        """Of the points of joints between two steps, (j, 3), m/s."""

    def kick(self, points: Points, impulses: Array) -> None:
        """Adds impulses (j, 3), N s, at the points of joints, between two steps, and books them."""

    def commit(self) -> None:
        """Takes the last attempt as the step, and books it."""

    def undo(self) -> None:
        """Forgets what was attempted."""


def torque_of(moment: Array) -> Array:
    """Σ a × f from Σ a fᵀ (3, 3)."""
    m = moment
    return np.array((m[1, 2] - m[2, 1], m[2, 0] - m[0, 2], m[0, 1] - m[1, 0]))


def split_couples(points: Points, forces: Array) -> tuple[Array, Array]:
    """Forces (k + j, 3) without the couples among them, and the sum of these, (3,), N m."""
    alone = forces.copy()
    alone[points.couples] = 0.0
    couple: Array = forces[points.couples].sum(axis=0)
    return alone, couple


def rigid_points(arms: Array, couples: Array) -> Points:
    """Of joints at arms (j, 3) from the centre of mass of a rigid body, in its axes, m."""
    j = len(arms)
    return Points(np.empty((j, 0), dtype=int), np.empty((j, 0)), arms, np.zeros(j, bool), couples)
