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
from fenics_rom.mechanics.frame_motion import cross_matrix, rotation_matrix
from fenics_rom.world.collision.contacts import Placed, PlacedShape
from fenics_rom.world.shapes import Shape

NO_ROWS = np.empty(0, dtype=int)
NOTHING = np.zeros(3)


class Points(NamedTuple):
    """Where forces act on a body in a step: k places of contact, then j points of the body that joints hold.

    A joint that holds how bodies turn has couples, N m, for forces, and angular velocities, rad/s, for velocities.
    """

    nodes: Array  # (k + j, c) of a soft body, among its contact points
    weights: Array  # (k + j, c) of these
    arms: Array  # (j, 3) of a rigid body, in its axes from its centre of mass, m
    follows: Array  # (k + j,) where a soft body is pushed at the point of another one, which moves with its frame
    couples: Array = NO_ROWS  # (any,) rows of what are couples
    tells: Array = NO_ROWS  # (any,) rows of points of joints where the other body is pushed, too


class Body(Protocol):
    """A body within a step; forces and velocities are in world axes, (k + j, 3).

    Attributes:
        is_driven: whether it moves as it is told, whatever forces act.
        touches: whether others can touch it; joints hold it in any case.
        has_inertia: whether it moves by its inertia, or as it is told; without, it goes to an equilibrium in each step.
        takes_couples: whether it is soft and moves freely: two such bodies are pushed at the same places, so that
            momenta stay.
        is_exact: whether the operator of a rigid one knows how joints turn with it: no force of theirs may do nothing.
        account: of its energy: `obstacles` is what contacts and joints supplied.
        size: radius of what holds it, m; infinite of a half-space.
    """

    is_driven, takes_couples, touches, has_inertia, is_exact = False, False, True, True, False
    account: EnergyLedger
    size: float

    @property
    def energy(self) -> float:
        """Stored, J."""

    @property
    def pose(self) -> BaseState:
        """Where the body, or the frame of a soft body, is, and how it moves."""

    @property
    def yields(self) -> bool:
        """Whether each of its points yields by itself, beyond what the motions of the whole body allow."""
        return False

    @property
    def lead(self) -> Array:
        """How far it is expected to go in half of the step beyond what its velocity says, (3,), m."""
        return NOTHING

    def take(self, inputs: Mapping[str, Any]) -> None:
        """Inputs of the next step by name; what is not named is 0. Raises StepError where there is no such input."""

    def begin(self, h: float) -> None:
        """Opens a step of h s; of 0 to look at where it is."""

    def placed(self) -> Placed:
        """As it is expected in the middle of the step, of what others can touch."""

    def travel(self) -> tuple[Array, float]:
        """How far it goes as a whole in the step, (3,), and how far a point of it may go beside that, m."""

    def swerve(self) -> tuple[Array, float]:
        """How much farther than `travel` says it goes as a whole as it was tried last, (3,), and a point beside, m."""
        return NOTHING, 0.0

    def start_velocities(self, points: Points, places: Array) -> Array:
        """Of the points when the step begins, m/s."""

    def attempt(self, points: Points, places: Array, forces: Array) -> Array:
        """Mid-step velocities under forces, N.

        `places`: (k + j, 3), m, of all points in the middle of the step; a soft body, whose points are its own, writes.
        """

    def known_answer(self, points: Points, places: Array) -> "tuple[Array, Array | None] | None":
        """Velocities of points without forces, and `delassus`, where these are known when a step begins; else None.

        As long as that is the same it is the same array; None of what no force moves.
        """
        return None

    def accept_forces(self, points: Points, places: Array, forces: Array) -> None:
        """Takes the forces that were found of a body whose answer was known."""
        return

    def delassus(self, points: Points, places: Array) -> Array:
        """Mid-step velocities per force, (3 (k + j), 3 (k + j)), m/s/N."""
        return np.zeros((3 * len(places), 3 * len(places)))

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
        return


class Part(NamedTuple):
    """What a body has to do with the pairs of a step."""

    body: Body
    pairs: Array  # (k + j,) among all pairs: those of contact, then joints
    rows: slice | Array  # the same, a slice where they lie in one piece
    signs: Array  # (k + j, 1): 1 where it is the first, -1 where the second
    is_one_sided: bool  # whether it is the same everywhere
    points: Points


class PointsOfRigid(Body, Protocol):
    """Where points of a rigid body are, and how they move."""

    _R: Array  # (3, 3): world axes of its own between two steps
    _middle: Array  # (3,), m: of its centre of mass, as it is expected in the middle of the step
    shape: Shape | None
    off: tuple[Array, Array] = (
        NOTHING,
        np.eye(3),
    )  # where the middle of the shape is from the centre of mass, m, and how that is turned

    @property
    def twist(self) -> tuple[Array, Array]:
        """Between two steps: velocity of the centre of mass, m/s, and angular velocity, rad/s."""

    def start_velocities(self, points: Points, places: Array) -> Array:
        """As in Body."""
        return moving(points, arms_of(points, places, self._middle, self._R), *self.twist)

    def end_velocities(self, points: Points) -> Array:
        """As in Body."""
        return moving(points, points.arms.dot(self._R.T), *self.twist)

    def points_at(self, places: Array, where: str, couples: Array = NO_ROWS) -> Points:
        """As in Body."""
        return rigid_points((places - self.pose.position).dot(self._R), couples)

    def lies(self) -> PlacedShape:
        """As it lies between two steps."""
        pose, (position, turned) = self.pose, self.off
        assert self.shape is not None
        R = rotation_matrix(pose.rotation)
        return PlacedShape(self.shape, pose.position + R.dot(position), R.dot(turned))

    def tried_turn(self, begins: bool = False) -> tuple[Array, Array]:
        """By what it turns in the step that was tried, h ω̂ (3,) in world axes, and (R + R⁺)/2; 0 and R between two."""

    def expected_place(self, arm: Array, h: float) -> Array:
        """Of a point at an arm in its axes, in the middle of a step of h s that has begun, (3,), m."""
        arm = self._R.dot(arm)
        place: Array = self._middle + arm + h / 2 * cross_matrix(self.twist[1]).dot(arm)
        return place


def arms_of(points: Points, places: Array, centre: Array, R: Array) -> Array:
    """From the centre of mass of a rigid body to places of contact, and to points of joints by its axes R."""
    arms = places - centre
    arms[len(arms) - len(points.arms) :] = points.arms.dot(R.T)
    return arms


def moving(points: Points, arms: Array, v: Array, ω: Array) -> Array:
    """Velocities v + ω × a of points of a rigid body; of couples ω."""
    velocities: Array = v + arms.dot(cross_matrix(ω).T)
    if len(points.couples):
        velocities[points.couples] = ω
    return velocities


def rigid_points(arms: Array, couples: Array, tells: Array = NO_ROWS) -> Points:
    """Of joints at arms (j, 3) from the centre of mass of a rigid body, in its axes, m."""
    j = len(arms)
    return Points(np.empty((j, 0), dtype=int), np.empty((j, 0)), arms, np.zeros(j, bool), couples, tells)


def places_alone(k: int) -> Points:
    """Of a rigid body that is pushed at k places in space."""
    return Points(np.empty((k, 0), dtype=int), np.empty((k, 0)), np.empty((0, 3)), np.zeros(k, bool))


NO_POINTS = rigid_points(np.empty((0, 3)), NO_ROWS)
