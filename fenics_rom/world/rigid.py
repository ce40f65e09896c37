"""A rigid body in a step: Newton's and Euler's equations, exact in energy and momentum at any step.

State: position and velocity of the centre of mass, attitude R, angular momentum ℓ in world axes. With ω̂ in the middle
of the step in the body's axes, R⁺ = R cay(h ω̂), R* = R (1 + h/2 ω̂~), ω⁺ = 2 ω̂ - ω:

    mass Δv/h = F,    2/h I (ω̂ - ω) + ω̂ × I ω̂ = R*ᵀ τ,    i.e.  ℓ⁺ = ℓ + h τ

so that energy grows by h (F·v̂ + τ·R ω̂), momenta by h F and h τ, and nothing else. Contact acts at a place x that both
bodies share, at x - p̂ from the middle of the way of the centre; a joint at the mean of where its point is at both ends,
as the point then goes by h ŝ exactly.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError, check_known, shown
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.mechanics.frame_geometry import crossed, vector
from fenics_rom.mechanics.frame_motion import Rotation, cayley, rotation_matrix, turned
from fenics_rom.mechanics.largest_turn import check_turn
from fenics_rom.mechanics.signals import real_numbers
from fenics_rom.world.bodies import NOTHING, Points, PointsOfRigid, arms_of, moving
from fenics_rom.world.collision.contacts import PlacedShape
from fenics_rom.world.rigid_answers import answers_where_held, operator_where_held
from fenics_rom.world.shapes import Shape
from fenics_rom.world.turning import MOST_ITERATIONS, NONE, answers_to, find_turning, mean_rotation

_EYE = np.eye(3)


class _Try(NamedTuple):
    """A step under some forces."""

    force: Array  # of contacts and joints, N
    torque: Array  # of all that acts, about the centre of mass, N m
    velocity: Array  # v̂ (3,), m/s
    turning: Array  # ω̂ (3,) in the body's axes, rad/s
    held: Array | None = None  # (4, 3) where joints hold it: Σ y fᵀ of theirs at y in its axes, N m, and Σ f


class Rigid(PointsOfRigid):
    """A rigid body that moves freely.

    Args:
        shape: m; None: nothing touches it.
        mass: kg.
        inertia: (3, 3) about the centre of mass, in the body's axes, kg m².
        pose: where it begins, and how it moves.
        gravity: (3,), m/s².
        off: where the middle of the shape is from the centre of mass, (3,), m, and how it is turned, (3, 3).
    """

    def __init__(
        self,
        shape: Shape | None,
        mass: float,
        inertia: Array,
        pose: BaseState,
        gravity: Array,
        off: tuple[Array, Array] = (NOTHING, _EYE),
    ):
        self.account, self.shape, self.touches, self.off = EnergyLedger(), shape, shape is not None, off
        self.size = 0.0 if shape is None else shape.radius_around + float(np.linalg.norm(off[0]))
        self.mass, self.inertia, self._inverse = mass, inertia, np.linalg.inv(inertia)
        self._columns = rows_of(inertia)  # of a symmetric matrix
        self._gravity, self._force, self._torque = gravity, NOTHING, NOTHING
        self.place(pose)

    def place(self, pose: BaseState) -> None:
        """Puts it somewhere; the account begins anew."""
        self._p, self._v = np.array(pose.position, dtype=float), np.array(pose.velocity, dtype=float)
        w, x, y, z = (pose.rotation / np.linalg.norm(pose.rotation)).tolist()
        self._q, self._R = (w, x, y, z), rotation_matrix((w, x, y, z))
        self._ω = self._R.T.dot(pose.angular_velocity)
        self._ℓ = self._R.dot(self.inertia.dot(self._ω))
        self._acceleration = np.zeros(3)
        self.account.sums = EnergyLedger().sums

    @property
    def gravity(self) -> Array:
        """(3,), m/s²."""
        return self._gravity

    @property
    def given(self) -> tuple[Array, Array]:
        """Force, N, and torque, N m, of inputs, (3,) each."""
        return self._force, self._torque

    @property
    def turning(self) -> tuple[tuple[float, float, float, float], Array, Array]:
        """Its unit quaternion, angular momentum, and acceleration in the last step."""
        return self._q, self._ℓ, self._acceleration

    def go_on(self, motion: Array, rotation: Array, quaternion: Array, momentum: Array, acceleration: Array) -> None:
        """Goes on from where compiled steps led: p, v and ω (3, 3), R (3, 3), and as in `turning`."""
        (self._p, self._v, self._ω), self._R = motion.copy(), rotation.copy()
        w, x, y, z = quaternion.tolist()
        self._q, self._ℓ, self._acceleration = (w, x, y, z), momentum.copy(), acceleration.copy()

    @property
    def energy(self) -> float:
        """Kinetic, J; what gravity does is supplied."""
        return (self.mass * float(self._v.dot(self._v)) + float(self._ω.dot(self.inertia.dot(self._ω)))) / 2

    @property
    def pose(self) -> BaseState:
        """As in Body."""
        return BaseState(self._p.copy(), np.array(self._q), self._v.copy(), self._R.dot(self._ω))

    @property
    def twist(self) -> tuple[Array, Array]:
        """As in PointsOfRigid."""
        return self._v, self._R.dot(self._ω)

    @property
    def momenta(self) -> tuple[Array, Array]:
        """Linear and, about the centre of mass, angular, in world axes."""
        return self.mass * self._v, self._ℓ.copy()

    def placed(self) -> PlacedShape:
        """As in Body."""
        assert self.shape is not None
        R, (position, turned) = self._R.dot(cayley(self._h / 2 * self._ω)), self.off
        return PlacedShape(self.shape, self._middle + R.dot(position), R.dot(turned))

    def travel(self) -> tuple[Array, float]:
        """As in Body."""
        h = self._h
        ω, g, speeds_up = (math.sqrt(of.dot(of)) for of in (self._ω, self._gravity, self._acceleration))
        return h * self._v, h * (ω * self.size + h * (g + speeds_up / 4))

    def swerve(self) -> tuple[Array, float]:
        """As in Body."""
        turned = self._try.turning - self._ω
        return self._h * (self._try.velocity - self._v), self._h * math.sqrt(turned.dot(turned)) * self.size

    @property
    def lead(self) -> Array:
        """As in Body."""
        return self._h**2 / 4 * self._acceleration

    def begin(self, h: float) -> None:
        """As in Body."""
        check_turn(h, vector(self._ω), "it")
        self._h = h
        self._middle = self._p + h / 2 * self._v + self.lead

    def take(self, inputs: Mapping[str, Any]) -> None:
        """As in Body: `force`, N, and `torque` about the centre of mass, N m, in world axes."""
        given = {"force": NOTHING, "torque": NOTHING}
        for name, value in inputs.items():
            check_known("input", name, given, StepError)
            try:
                given[name] = real_numbers(value).reshape(3)
            except (TypeError, ValueError):
                raise StepError(f"input {name!r} = {shown(value)}: use 3 real numbers") from None
        self._force, self._torque = given.values()

    def attempt(self, points: Points, places: Array, forces: Array) -> Array:
        """As in Body."""
        h, k, τ_given = self._h, len(places) - len(points.arms), self._torque
        if len(points.couples):
            forces, couple = _split_couples(points, forces)
            τ_given = τ_given + couple
        force = forces.sum(axis=0)
        v̂ = self._v + h / 2 * ((force + self._force) / self.mass + self._gravity)
        arms = places - (self._p + h / 2 * v̂)
        τ = _torque_of(arms[:k].T.dot(forces[:k])) + τ_given
        held = points.arms.T.dot(forces[k:]) if len(points.arms) else None
        ω̂, τ, mean = self._turning(τ, held)
        if held is not None:
            held = np.concatenate([held, forces[k:].sum(axis=0)[None]])
            arms[k:] = points.arms.dot(mean.T)
            if len(points.tells):
                places[points.tells] = self._p + h / 2 * v̂ + arms[points.tells]
        self._try = _Try(force, τ, v̂, ω̂, held)
        return moving(points, arms, v̂, self._R.dot(ω̂))

    def tried_turn(self, begins: bool = False) -> tuple[Array, Array]:
        """As in PointsOfRigid."""
        if begins:
            return NOTHING, self._R
        ω̂ = self._try.turning
        return self._h * self._R.dot(ω̂), np.array(mean_rotation(rows_of(self._R), self._h, vector(ω̂)))

    @property
    def begun(self) -> tuple[Array, tuple[Array, Array, Array], tuple[Array, Array]]:
        """As compiled steps have it: R, (p, v, ω), and acceleration and torque of what acts besides contact."""
        return self._R, (self._p, self._v, self._ω), (self._gravity + self._force / self.mass, self._torque)

    def accept(self, force: Array, torque: Array, velocity: Array, turning: Array) -> None:
        """Takes what was found of a step as its last attempt, as in _Try."""
        self._try = _Try(force, torque, velocity, turning)

    def _turning(self, τ: Array, moment: Array | None) -> tuple[Array, Array, Array]:
        """ω̂ under a torque and a moment Σ y fᵀ (3, 3) of joints; the whole torque; and (R + R⁺)/2."""
        h, held, forced = self._h, NONE, 0.0
        if moment is not None and (most := float(np.abs(moment).max())):
            held, forced = rows_of(moment), h * float(np.abs(self._inverse).max()) * most
        given = self._columns, rows_of(self._R), vector(self._ω), vector(τ)
        ω̂, whole, mean, left = find_turning(h, *given, held, forced)
        if not math.isfinite(left):
            raise StepError("forces are so large that the step overflows; the state was left as it was")
        if left:
            raise StepError(
                f"no step of {h:g} s was found that turns it: after {MOST_ITERATIONS} iterations {left:.1e} of "
                "the angular velocity is left; a smaller dt is the cure"
            )
        if moment is not None and not forced:
            mean = mean_rotation(given[1], h, ω̂)
        return np.array(ω̂), np.array(whole), np.array(mean)

    def delassus(self, points: Points, places: Array) -> Array:
        """As in Body: the derivative of the last attempt, but for how joints turn with the body, if it is not exact."""
        h, R, (force, torque, v̂, ω̂, held) = self._h, self._R, self._try
        k, arms = len(places) - len(points.arms), arms_of(points, places, self._p + h / 2 * v̂, R)
        if held is not None and self.is_exact:
            rows = rows_of(R)
            loads = vector(force - held[3]), vector(torque), rows_of(held[:3]), vector(ω̂)
            answers = answers_where_held(h, self.mass, self._columns, rows, *loads)
            return operator_where_held(answers, rows, points, arms[:k])
        given = self._columns, rows_of(R), vector(force), vector(torque), vector(ω̂)
        moving, turning, levered = map(np.array, answers_to(h, self.mass, *given))
        per_push, maps = np.zeros((6, 6)), _maps(points, arms)
        per_push[:3, :3], per_push[3:, 3:] = moving, turning
        by_joints = maps.dot(per_push).dot(maps[3 * k :].T)
        per_push[3:, :3] = levered
        moved: Array = maps.dot(per_push).dot(maps.T)
        moved[:, 3 * k :] = by_joints
        return moved

    def inverse_mass(self, points: Points) -> Array:
        """As in Body."""
        answers = np.zeros((6, 6))
        answers[:3, :3], answers[3:, 3:] = np.eye(3) / self.mass, self._R.dot(self._inverse).dot(self._R.T)
        maps = _maps(points, points.arms.dot(self._R.T))
        moved: Array = maps.dot(answers).dot(maps.T)
        return moved

    def kick(self, points: Points, impulses: Array) -> None:
        """As in Body."""
        before = self.energy
        impulses, couple = _split_couples(points, impulses)
        self._v = self._v + impulses.sum(axis=0) / self.mass
        self._ℓ = self._ℓ + _torque_of(self._R.dot(points.arms.T).dot(impulses)) + couple
        self._ω = self._inverse.dot(self._R.T.dot(self._ℓ))
        self.account.book_contact(self.energy - before, 0.0, 0.0, 0.0)

    def commit(self) -> None:
        """As in Body."""
        h, (force, torque, v̂, ω̂, _) = self._h, self._try
        given, turning = self.mass * self._gravity + self._force, self._R.dot(ω̂)
        by_loads = float(given.dot(v̂)) + float(self._torque.dot(turning))
        by_others = float(force.dot(v̂)) + float((torque - self._torque).dot(turning))
        self._acceleration = (force + given) / self.mass
        self._p, self._v = self._p + h * v̂, self._v + h * self._acceleration
        self._ℓ = self._ℓ + h * torque
        self._q = turned(self._q, h * ω̂)
        self._R = rotation_matrix(self._q)
        self._ω = self._inverse.dot(self._R.T.dot(self._ℓ))
        self.account.book(supplied=h * by_loads)
        self.account.book_contact(h * by_others, 0.0, 0.0, 0.0)


def rows_of(matrix: Array) -> Rotation:
    """Of a matrix (3, 3)."""
    a, b, c = map(vector, matrix)
    return a, b, c


def _maps(points: Points, arms: Array) -> Array:
    """As `moving`, of a body that moves, and turns, at unit rates, (3 k, 6)."""
    maps = np.empty((len(arms), 3, 6))
    maps[:, :, :3], maps[:, :, 3:] = _EYE, crossed(arms)
    if len(points.couples):
        maps[points.couples, :, :3] = 0.0
        maps[points.couples, :, 3:] = _EYE
    return maps.reshape(-1, 6)


def _torque_of(moment: Array) -> Array:
    """Σ a × f from Σ a fᵀ (3, 3)."""
    m = moment
    return np.array((m[1, 2] - m[2, 1], m[2, 0] - m[0, 2], m[0, 1] - m[1, 0]))


def _split_couples(points: Points, forces: Array) -> tuple[Array, Array]:
    """Forces (k + j, 3) without the couples among them, and the sum of these, (3,), N m."""
    alone = forces.copy()
    alone[points.couples] = 0.0
    couple: Array = forces[points.couples].sum(axis=0)
    return alone, couple
