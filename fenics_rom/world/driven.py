"""A body that moves as it is told: the ground, a palm on rails, a hand."""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.base_fit import misfit_message, told_misfit
from fenics_rom.mechanics.base_path import BaseState, checked_base
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.mechanics.frame_geometry import vector
from fenics_rom.mechanics.frame_motion import (
    LEAST_COSINE,
    MOST_TURNED,
    added,
    cayley,
    composed,
    cross,
    rotated,
    rotation_matrix,
    rotation_of,
)
from fenics_rom.world.bodies import NOTHING, Points, PointsOfRigid, arms_of, moving
from fenics_rom.world.collision.contacts import PlacedShape
from fenics_rom.world.shapes import Shape

NO_GAPS = 0.0, 0.0


class Driven(PointsOfRigid):
    """A rigid body whose pose is given.

    Args:
        shape: m; None: nothing touches it.
        motion: its pose and twist at a time, s.

    Attributes:
        motion: as given; by another one it moves from the next step on.
        end: where the step that has begun leads.
    """

    is_driven, energy = True, 0.0

    def __init__(self, shape: Shape | None, motion: Callable[[float], BaseState]):
        self.account, self.shape, self.motion, self.touches = EnergyLedger(), shape, motion, shape is not None
        self.size = 0.0 if shape is None else shape.radius_around
        self.time = 0.0
        self._start = self.end = motion(0.0)
        self._R = self._R_end = rotation_matrix(self._start.rotation)
        self._given, self._is_still = self._start, False
        self._gaps = self._misfit = NO_GAPS  # of a step, and at most, m and rad, between where it went and its twists

    @property
    def pose(self) -> BaseState:
        """As in Body."""
        return self._start

    @property
    def twist(self) -> tuple[Array, Array]:
        """As in PointsOfRigid."""
        return self._start.velocity, self._start.angular_velocity

    @property
    def misfit(self) -> tuple[float, float]:
        """How far it went at most in a step, m, and turned, rad, otherwise than its twists say."""
        return self._misfit

    def go_on(self, pose: BaseState, misfit: tuple[float, float]) -> None:
        """Goes on from where compiled steps led, with the misfit of these."""
        self._start = self.end = pose
        self._R = self._R_end = rotation_matrix(pose.rotation)
        self._given, self._is_still, self._misfit = pose, False, misfit

    def warnings(self, name: str) -> tuple[str, ...]:
        """Whether it, of some name, jumped, or went otherwise than its velocities say."""
        return misfit_message(*self._misfit, driven=name)

    def take(self, inputs: Mapping[str, Any]) -> None:
        """As in Body: it has none."""
        if inputs:
            raise StepError("it moves as it is told: use inputs of bodies that do not")

    def begin(self, h: float) -> None:
        """As in Body."""
        self._h, self._power = h, 0.0
        if h == 0:
            self._middle, self._middle_rotation = self._start.position, self._R
            return
        given = self.motion(self.time + h)
        if given is self._given and self._is_still:
            return
        start, end = self._start, checked_base(given, f"its motion at {self.time + h:g} s")
        self._given, self.end = given, end
        w, x, y, z = start.rotation.tolist()
        cosine, *sines = composed((w, -x, -y, -z), end.rotation.tolist())
        if not abs(cosine) >= LEAST_COSINE:
            raise StepError(f"it is told to turn by more than {MOST_TURNED:g} rad in a step of {h:g} s")
        R = self._mean = self._middle_rotation = self._R_end = self._R
        self._v̂, self._ω̂ = (end.position - start.position) / h, NOTHING
        self._middle = (start.position + end.position) / 2
        if any(sines):
            turn = np.array(sines) * (2 / cosine)  # Cayley's, of the step
            self._R_end, self._middle_rotation = rotation_matrix(end.rotation), R.dot(cayley(turn / 2))
            self._mean, self._ω̂ = (R + self._R_end) / 2, R.dot(turn / h)
        self._gaps = told_misfit(start, end, h, min(self.size, 1.0))
        self._is_still = not (self._v̂.any() or self._ω̂.any())

    def placed(self) -> PlacedShape:
        """As in Body."""
        assert self.shape is not None
        return PlacedShape(self.shape, self._middle, self._middle_rotation)

    def travel(self) -> tuple[Array, float]:
        """As in Body: what touches a half-space that turns is near to where it begins."""
        size = 1.0 if self.size == np.inf else self.size
        return self._h * self._v̂, self._h * math.hypot(*self._ω̂) * size

    def attempt(self, points: Points, places: Array, forces: Array) -> Array:
        """As in Body."""
        velocities, _ = self.known_answer(points, places)
        if len(points.tells):
            places[points.tells] = self._middle + arms_of(points, places, self._middle, self._mean)[points.tells]
        self._power = float(forces.ravel().dot(velocities.ravel()))
        return velocities

    def tried_turn(self, begins: bool = False) -> tuple[Array, Array]:
        """As in PointsOfRigid."""
        return (NOTHING, self._R) if begins else (self._h * self._ω̂, self._mean)

    def known_answer(self, points: Points, places: Array) -> tuple[Array, None]:
        """As in Body."""
        return moving(points, arms_of(points, places, self._middle, self._mean), self._v̂, self._ω̂), None

    def accept_forces(self, points: Points, places: Array, forces: Array) -> None:
        """As in Body."""
        self.attempt(points, places, forces)

    def inverse_mass(self, points: Points) -> Array:
        """As in Body: nothing moves it."""
        return np.zeros((3 * len(points.arms), 3 * len(points.arms)))

    def kick(self, points: Points, impulses: Array) -> None:
        """As in Body: whoever drives it takes out what it gets."""
        work = float(impulses.ravel().dot(self.end_velocities(points).ravel()))
        self.account.book_contact(work, 0.0, 0.0, 0.0)
        self.account.book(supplied=-work)

    def commit(self) -> None:
        """As in Body: what others do on it, whoever drives it takes out."""
        self.account.book_contact(self._h * self._power, 0.0, 0.0, 0.0)
        self.account.book(supplied=-self._h * self._power)
        self._start, self._R, self.time = self.end, self._R_end, self.time + self._h
        if self._gaps > NO_GAPS:
            self._misfit = max(self._misfit[0], self._gaps[0]), max(self._misfit[1], self._gaps[1])


def mounted(carrier: BaseState, place: BaseState) -> BaseState:
    """A place on a body, in its axes from its centre of mass, as the body moves: in world axes."""
    w, x, y, z = carrier.rotation.tolist()
    ω, arm = vector(carrier.angular_velocity), rotated(rotation_of(w, x, y, z), vector(place.position))
    return BaseState(
        np.array(added(vector(carrier.position), 1.0, arm)),
        np.array(composed((w, x, y, z), place.rotation.tolist())),
        np.array(added(vector(carrier.velocity), 1.0, cross(ω, arm))),
        carrier.angular_velocity,
    )
