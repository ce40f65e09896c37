"""How a body meets obstacles: the points that can touch, the law, how obstacles move in a step, and what contact did.

The law inside a step of passive midpoint integration is in `mechanics.contact_solver`, which finds the forces.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError
from fenics_rom.mechanics.obstacle_poses import between, mean_twists, velocities_at

LEAST_TOLD = 1e-6  # of the velocities that forces stop: what they leave below is small against the error of any step
_ONES = np.ones(3)


def is_zero(values: Array) -> bool:
    """Whether some numbers are all zero; five times as fast as `any`."""
    return not values.tobytes().strip(b"\0")


class ObstacleMotion(NamedTuple):
    """How O obstacles move in one step."""

    start: Array  # displacements from where the scene puts them at its start, (O, 3), m; or poses, see `obstacle_poses`
    end: Array  # at its end, (O, 3), m, or (O, 7)
    velocities_before: Array  # in the step before, (O, 3), m/s; of poses with angular velocities, (O, 6)

    @property
    def turns(self) -> bool:
        """Whether poses are given."""
        return self.start.shape[1] > 3

    def velocities(self, dt: float) -> Array:
        """In a step of dt, s, as `velocities_before`."""
        if self.end is self.start:
            return np.zeros(self.velocities_before.shape)
        return mean_twists(self.start, self.end, dt) if self.turns else (self.end - self.start) / dt

    def velocities_at(self, places: Array, dt: float) -> tuple[Array, Array]:
        """Of what turns, at places (P, 3), m, in a step of dt, s, and at its start: (O, P, 3) each, m/s."""
        return velocities_at(places, self.start, self.end, self.velocities_before, dt)

    def in_step(self, step: int) -> "ObstacleMotion":
        """In one of steps in a row, of arrays with these first; with one row alone where they rest."""
        return ObstacleMotion(*(part[min(step, len(part) - 1)] for part in self))

    def part(self, begin: float, share: float, dt: float) -> "ObstacleMotion":
        """In the part of the step of dt, s, that begins when `begin` of it is taken and is `share` of it."""
        before = self.velocities_before if begin == 0 else self.velocities(dt)
        start, end = (between(self.start, self.end, of) for of in (begin, begin + share))
        return ObstacleMotion(start, end, before)


class PointMotion(NamedTuple):
    """What the contact points do in one step."""

    displacement: Array  # at its start, (P, 3), m
    velocity: Array  # at its start, (P, 3), m/s
    free_velocity: Array  # in its middle, if no contact forces act, (P, 3), m/s
    middle: Array | None = None  # where they are then, seen from anywhere, (P, 3), m; None: near where it starts


@dataclass(frozen=True)
class ContactLaw:
    """How a body meets obstacles.

    Args:
        restitution: e, in [0, 1]: the part of the approaching speed that an impact gives back.
        friction: Coulomb's coefficient μ >= 0.
        stiffness: k, N/m, of a spring at every point in place of the rigid law, which then knows no restitution:
            λ = max(0, -k g - (k h/2 + d) s); where nothing presses it yet, λ = max(0, -(k h/2 + d) (g/h + s)). So it
            takes no less than it stores, whatever the step. None: rigid.
        damping: d, N s/m, of a dashpot beside each spring.

    Raises:
        SceneError: a number out of its range, or damping or restitution that would not act.

    Example:
        >>> smooth = fr.ContactLaw(friction=0.1)
    """

    restitution: float = 0.0
    friction: float = 0.0
    stiffness: float | None = None
    damping: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= self.restitution <= 1:
            raise SceneError(f"contact: restitution: use a number in [0, 1] (got {self.restitution!r})")
        for name in ("friction", "damping"):
            if not 0 <= getattr(self, name) < math.inf:
                raise SceneError(f"contact: {name}: use a finite number >= 0 (got {getattr(self, name)!r})")
        if self.stiffness is None:
            if self.damping:
                raise SceneError("contact: damping acts beside a stiffness, and none is given")
        elif not 0 < self.stiffness < math.inf:
            raise SceneError(f"contact: stiffness: use a finite number > 0, in N/m (got {self.stiffness!r})")
        elif self.restitution:
            raise SceneError("contact: restitution belongs to the rigid law: use 0 beside a stiffness")

    def in_steps(self, dt: float) -> tuple[float, float]:
        """In steps of dt, s: rate by which a gap is closed, 1/s, and compliance along the normal, m/s/N; 0: rigid."""
        if self.stiffness is None:
            return -1 / dt, 0.0
        damper = self.stiffness * dt / 2 + self.damping
        return -self.stiffness / damper, 1 / damper


def rigid_law(law: ContactLaw) -> ContactLaw:
    """That of obstacles without springs, beside the same friction."""
    return law if law.stiffness is None else ContactLaw(friction=law.friction)


class ContactWork(NamedTuple):
    """Where the work of contact in a step went, J: h Σ f·v̂ = supplied - contact - friction - numerical."""

    supplied: float  # by obstacles that move
    contact: float  # dissipated by impacts, >= 0; with the penalty law also what its springs take up (< 0: give back)
    friction: float  # dissipated by friction, >= 0
    numerical: float = 0.0  # what a step without inertia does not know of its way


class Opposite(NamedTuple):
    """What of a body the points of C pairs touch; pairs with obstacles have no weights."""

    nodes: Array  # (C, 3) contact points that carry the place
    weights: Array  # (C, 3) of these


class Carriers(NamedTuple):
    """The places of a body at which C pairs touch obstacles."""

    nodes: Array  # (C, 3) contact points that carry them
    weights: Array  # (C, 3) of these


class ContactSolution(NamedTuple):
    """What contact does in one step."""

    forces: Array  # (P, 3) on the points, N
    iterations: int  # systems of equations solved
    pairs: Array  # (C,) of those that took part: obstacle times P plus point, of points on the body itself O times P
    normals: Array  # (C, 3) theirs
    pair_forces: Array  # (C, 3) theirs, N
    obstacle_velocities: Array  # (O, 3), m/s
    normal_power: float | None  # Σ λ s of the pairs, W; None where there is no friction: then it is all
    opposite: Opposite | None = None  # of a body that may touch itself
    surface_velocities: Array | None = None  # of the obstacles at the pairs (C, 3), m/s; None where none of them turns
    carriers: Carriers | None = None  # where obstacles meet faces of a body, too, and not its contact points alone

    @property
    def by_obstacle(self) -> Array:
        """Resultants on the body (O, 3), N."""
        resultants = np.zeros((len(self.obstacle_velocities) + 1, 3))
        np.add.at(resultants, self.pairs // len(self.forces), self.pair_forces)
        return resultants[:-1]

    @property
    def touched_points(self) -> Array:
        """Those of the contact points that take part, (any,)."""
        points = self.pairs % len(self.forces)
        if self.carriers is not None:
            points = np.unique(self.carriers.nodes[self.carriers.weights > 0])
        if self.opposite is None:
            return points
        return np.union1d(points, self.opposite.nodes[self.opposite.weights.any(axis=1)])

    def relative(self, velocities: Array) -> Array:
        """Of velocities (P, 3) of the points, how pairs (C, 3) move relative to what they touch, m/s."""
        obstacle, point = np.divmod(self.pairs, len(velocities))
        w = self.surface_velocities
        if w is None:
            w = np.concatenate([self.obstacle_velocities, np.zeros((1, 3))])[obstacle]
        relative = (velocities[point] if self.carriers is None else _mean_at(velocities, self.carriers)) - w
        return relative if self.opposite is None else relative - _mean_at(velocities, self.opposite)

    def of_surface(self, velocities: Array) -> Array:
        """Of velocities of obstacles at all pairs of points (O P, 3), those at the pairs that took part, (C, 3)."""
        if self.carriers is None:
            return velocities[self.pairs]
        P = len(self.forces)
        of_pairs = (self.pairs // P * P)[:, None] + self.carriers.nodes
        return _mean_at(velocities, Carriers(of_pairs, self.carriers.weights))

    @property
    def touching(self) -> int:
        """Number of pairs that push, by more than round-off."""
        pressure = (self.pair_forces * self.normals).dot(_ONES)
        return len(set(self.pairs[pressure > 1e-9 * pressure.max()].tolist()))

    @property
    def normal_forces(self) -> Array:
        """Of all that touches it together on each point, (P,), N."""
        pressure, P = (self.pair_forces * self.normals).dot(_ONES), len(self.forces)
        pressing = np.zeros(P)
        if self.carriers is None:
            np.add.at(pressing, self.pairs % P, pressure)
        for places in (self.carriers, self.opposite):
            if places is not None:
                np.add.at(pressing, places.nodes, places.weights * pressure[:, None])
        return pressing

    @property
    def power_of_obstacles(self) -> float:
        """What obstacles that move supply, W."""
        if self.surface_velocities is not None:
            return float(self.pair_forces.ravel().dot(self.surface_velocities.ravel()))
        w = self.obstacle_velocities
        return 0.0 if is_zero(w) else float(self.by_obstacle.ravel().dot(w.ravel()))

    def work(self, velocity: Array, dt: float) -> ContactWork:
        """Where the work went.

        Args:
            velocity: (P, 3) mid-step velocities v̂ of the points, m/s, as the step has found them.
            dt: of the step, s.
        """
        return self.work_at(float(self.forces.ravel().dot(velocity.ravel())), dt)

    def work_at(self, power: float, dt: float) -> ContactWork:
        """The same from the power Σ f·v̂ of the forces on the points, W."""
        supplied = self.power_of_obstacles
        whole = power - supplied
        normal = whole if self.normal_power is None else self.normal_power
        return ContactWork(dt * supplied, -dt * normal, dt * (normal - whole))


def _mean_at(values: Array, places: "Opposite | Carriers") -> Array:
    """Of values of points (P, any) those at places, (C, any)."""
    mean: Array = (places.weights[:, :, None] * values[places.nodes]).sum(axis=1)
    return mean


def mean_contact(parts: Sequence[tuple[float, ContactSolution | None]]) -> ContactSolution | None:
    """Contact in a step that was taken in parts, by their shares of it: its forces have the impulses of all parts.

    A pair is named once for each part that it touched in, with the normal that it had there.
    """
    touched = [(share, part) for share, part in parts if part is not None]
    if not touched:
        return None
    speeds = [part.surface_velocities for _, part in touched if part.surface_velocities is not None]
    power = [share * part.normal_power for share, part in touched if part.normal_power is not None]
    opposite = [part.opposite for _, part in touched if part.opposite is not None]
    carriers = [part.carriers for _, part in touched if part.carriers is not None]
    return ContactSolution(
        np.sum([share * part.forces for share, part in touched], axis=0),
        sum(part.iterations for _, part in touched),
        np.concatenate([part.pairs for _, part in touched]),
        np.concatenate([part.normals for _, part in touched]),
        np.concatenate([share * part.pair_forces for share, part in touched]),
        touched[-1][1].obstacle_velocities,
        sum(power) if power else None,
        Opposite(*map(np.concatenate, zip(*opposite, strict=True))) if opposite else None,
        np.concatenate(speeds) if speeds else None,
        Carriers(*map(np.concatenate, zip(*carriers, strict=True))) if carriers else None,
    )


def equilibrium_work(
    before: ContactSolution | None,
    after: ContactSolution | None,
    velocity: Array,
    dt: float,
    obstacles: ObstacleMotion,
    law: ContactLaw,
    surface: Array | None = None,
) -> ContactWork:
    """Where the work went in a step from one equilibrium to the next, on whose way all forces change linearly.

    Without inertia there are no impacts, though a point may touch or leave an obstacle in the middle of a step, and
    friction takes what the force at the end of the step does, which is never negative: the rest is numerical.

    Args:
        before, after: contact in the equilibria that the step leads from and to; None where nothing touched.
        velocity, dt: as in `ContactSolution.work`.
        obstacles: how they move.
        law: of the contact.
        surface: velocities of the obstacles at all pairs, (O P, 3), m/s; None where none turns.
    """
    w, supplied, done, contact, friction = obstacles.velocities(dt), 0.0, 0.0, 0.0, 0.0
    for one in (before, after):
        if one is not None:
            forces, speeds = (one.by_obstacle, w) if surface is None else (one.pair_forces, one.of_surface(surface))
            supplied += dt / 2 * float(forces.ravel().dot(speeds.ravel()))
            done += dt / 2 * float(one.forces.ravel().dot(velocity.ravel()))
    if after is not None:
        springs, friction = after.work(velocity, dt)[1:3]
        contact = 0.0 if law.stiffness is None else springs
    return ContactWork(supplied, contact, friction, supplied - contact - friction - done)


class HeldBack(NamedTuple):
    """Steps in which points would have gone through obstacles, or the body itself: they were held before these."""

    steps: int = 0  # how many
    dt: float = math.inf  # s, in which none would have gone so far, about
    springs: int = 0  # in how many of them springs would have let points through
    depth: float = 0.0  # as deep, m, or as far of what went through a mesh

    @property
    def message(self) -> str:
        """What to say of a run; empty where there was no such step."""
        if self.springs:
            return (
                f"in {self.springs} steps springs of contact would have let points through an obstacle, or the body "
                f"itself, by up to {self.depth:.2g} m: they were held as the rigid law does; stiffer springs, or a "
                "smaller dt, would do"
            )
        if not self.steps:
            return ""
        return (
            f"in {self.steps} steps points would have gone through an obstacle, or the body itself, as they moved by "
            "more than half of its thickness: they were held before it, and left as fast as they came; a dt of "
            f"{self.dt:.1g} s would do"
        )

    def with_step(self, dt: float) -> "HeldBack":
        """With one more step, for which this dt would have done, s."""
        return self._replace(steps=self.steps + 1, dt=min(self.dt, dt))

    def with_springs(self, depth: float) -> "HeldBack":
        """With one more step in which springs would have let points go so far, m."""
        return self._replace(steps=self.steps + 1, springs=self.springs + 1, depth=max(self.depth, depth))


class ContactResidual(NamedTuple):
    """Steps whose forces solve the contact problem but for a residual."""

    steps: int = 0  # how many
    residual: float = 0.0  # the largest, as a share of the velocities that the forces had to stop

    @property
    def message(self) -> str:
        """What to say of a run; empty where no step was off by so much that it matters."""
        if self.residual < LEAST_TOLD:
            return ""
        return (
            f"in {self.steps} steps contact forces were not found exactly (the worst leave {self.residual:.0e} of the "
            "velocities that they stop), and were made smaller so that they do no work; a smaller dt or less friction "
            "may help"
        )

    def with_step(self, residual: float) -> "ContactResidual":
        """With one more step, which left a residual."""
        return ContactResidual(self.steps + 1, max(self.residual, residual))
