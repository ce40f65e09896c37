"""Contact of many bodies of one kind with rigid obstacles in one step: the law of `contact_solver`, for all at once.

Every point of a body is paired with the obstacle that it has to be stopped from first. Bodies with a point that two
obstacles press on at once, and those that the splitting does not settle, are left to `ContactSolver`, one by one.

Arrays hold bodies along their last axis and axes x, y, z along the first but for that of obstacles: (O, 3, P, B).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.body_axis import in_one_piece, put, taken
from fenics_rom.mechanics.complementarity.problems import Problems
from fenics_rom.mechanics.complementarity.splitting import Splitting
from fenics_rom.mechanics.contact import ContactLaw
from fenics_rom.mechanics.obstacles import Obstacle

HELPING = 1e-9  # of force times velocity: work of friction on a body that is looked at; less is left to `make_passive`


class BatchObstacles(NamedTuple):
    """How O obstacles move in a step, beside each of B bodies."""

    start: Array  # displacements at its start, (O, 3, B), m
    velocities: Array  # in it, (O, 3, B), m/s
    velocities_before: Array  # in the step before, (O, 3, B), m/s

    def of(self, bodies: Array | slice) -> "BatchObstacles":
        """Beside some of the bodies."""
        return BatchObstacles(*(taken(part, bodies) for part in self))


class BatchMotion(NamedTuple):
    """What the contact points of B bodies do in a step."""

    displacement: Array  # at its start, (3, P, B), m
    velocity: Array  # at its start, (3, P, B), m/s
    free_velocity: Array  # in its middle, if no contact forces act, (3, P, B), m/s

    def of(self, bodies: Array) -> "BatchMotion":
        """Of some of the bodies."""
        return BatchMotion(*(taken(part, bodies) for part in self))


class BatchForces(NamedTuple):
    """What contact does in a step; of the T bodies that touch."""

    touching: Array  # (T,) which they are
    forces: Array  # (3, P, T) on the points, N
    moved: Array  # (3, P, T) W f, m/s
    obstacle: Array  # (P, T) that each point is paired with
    normals: Array  # (3, P, T)
    relative: Array  # (3, P, T) free velocities relative to these obstacles, m/s
    z: Array  # (3, P, T) to begin the next search with, m/s
    alone: Array  # (A,) which of the B bodies are to be solved one by one


class BatchContactSolver:
    """Contact of the points of bodies with obstacles; it keeps nothing of the past.

    Args:
        points: (P, 3) at rest, m.
        obstacles: O of them.
        law: how they meet, a rigid one; friction is given for each body.
    """

    def __init__(self, points: Array, obstacles: Sequence[Obstacle], law: ContactLaw):
        self._points, self._obstacles, self._law = points.T[:, :, None].copy(), tuple(obstacles), law

    def distances(self, displacement: Array, offsets: Array) -> tuple[Array, Array]:
        """Gaps (O, P, B), m, and normals (O, 3, P, B) of points that moved by (3, P, B), obstacles by (O, 3, B), m."""
        gaps, normals = [], []
        for obstacle, offset in zip(self._obstacles, offsets, strict=True):
            places = self._points + displacement
            places -= offset[:, None]
            gap, normal = obstacle.distance(places.reshape(3, -1).T)
            gaps.append(gap.reshape(displacement.shape[1:]))
            normals.append(np.ascontiguousarray(normal.T).reshape(displacement.shape))
        return np.stack(gaps), np.stack(normals)

    def solve(
        self,
        motion: BatchMotion,
        distances: tuple[Array, Array],
        operator: Splitting,
        dt: float,
        obstacles: BatchObstacles,
        friction: Array,
        pushed: Array,
        z: Array,
    ) -> BatchForces | None:
        """Contact forces of one step; None where nothing touches.

        Args:
            motion: what the points do, and would do without contact.
            distances: at the start of the step.
            operator: W of the points.
            dt: h, s.
            obstacles: how they move.
            friction: μ (B,).
            pushed: (O, P, B) pairs that had forces in the step before.
            z: (3, P, B) to begin with, m/s.
        """
        approaches = self._approaches(motion, distances, dt, obstacles, pushed)
        touching = approaches.due.any(axis=(0, 1)).nonzero()[0]
        if not len(touching):
            return None
        if len(touching) < len(friction):
            motion, obstacles, approaches = motion.of(touching), obstacles.of(touching), approaches.of(touching)
            distances = taken(distances[0], touching), taken(distances[1], touching)
            friction, z = friction[touching], taken(z, touching)
        pairs = self._pairs(motion, distances, dt, obstacles, approaches)
        chosen = _Chosen.of_pairs(pairs, friction)
        crowded = np.count_nonzero(pairs.due, axis=0).max(axis=0) > 1
        T = len(touching)
        forces, moved, z, unsettled = np.empty_like(z), np.empty_like(z), z.copy(), np.zeros(T, bool)
        pending, part = np.arange(T), chosen
        while len(pending):
            places = in_one_piece(pending)
            found, z_found, failed = operator.solve(part.problems, taken(z, places))
            velocities = operator.moved(found)
            for whole, values in ((forces, found), (z, z_found), (moved, velocities)):
                put(whole, places, values)
            unsettled[pending[failed]] = True
            again = (part.stop_helping_friction(found, velocities) | part.add_missed(velocities)).nonzero()[0]
            pending, part = pending[again], part.of(again)
        if len(self._obstacles) > 1:
            crowded |= pairs.others_due(moved, chosen.obstacle)
        chosen.make_passive(forces, moved)
        alone = touching[crowded | unsettled]
        return BatchForces(touching, forces, moved, chosen.obstacle, chosen.normals, chosen.free, z, alone)

    def _approaches(
        self, motion: BatchMotion, distances: tuple[Array, Array], dt: float, obstacles: BatchObstacles, pushed: Array
    ) -> "_Approaches":
        """How fast every pair comes near, and whether it is due; see ContactSolver._all_pairs."""
        (gaps, normals), e = distances, self._law.restitution
        approach, normal_velocity = (_along(part, normals) for part in (motion.velocity, motion.free_velocity))
        if obstacles.velocities.any():
            moving = _along(obstacles.velocities[:, :, None], normals)
            approach -= moving
            normal_velocity -= moving
        half_change = (obstacles.velocities - obstacles.velocities_before) / 2
        if half_change.any():
            half_change = half_change[:, :, None] * pushed[:, None]
            approach += _along(half_change, normals)
        level = gaps / -dt
        np.maximum(level, (level + (1 - e) / 2 * approach) / (2 - e), out=level)
        return _Approaches(normal_velocity, approach, level, normal_velocity < level, half_change)

    def _pairs(
        self,
        motion: BatchMotion,
        distances: tuple[Array, Array],
        dt: float,
        obstacles: BatchObstacles,
        approaches: "_Approaches",
    ) -> "_Pairs":
        """What the law says of every pair; see ContactSolver._all_pairs."""
        (gaps, normals), w, e = distances, obstacles.velocities[:, :, None], self._law.restitution
        normal_velocity, approach, level, due, half_change = approaches
        target = np.minimum((1 - e) / 2 * approach, 0.0)
        if gaps.min(initial=0.0) < 0:
            speed = np.sqrt(np.square(obstacles.velocities).sum(axis=1))[:, None]
            np.maximum(target, -np.maximum(gaps / dt + np.abs(approach) + speed, 0.0), out=target)
        relative = motion.velocity - w
        if half_change.ndim == 4:
            relative += half_change
        relative -= approach[:, None] * normals
        relative /= 2
        return _Pairs(normals, motion.free_velocity - w, normal_velocity, level, target, relative, due)


class _Approaches(NamedTuple):
    """How every pair comes near in one step; velocities in m/s."""

    normal_velocity: Array  # mid-step without contact, relative, (O, P, B)
    approach: Array  # relative normal velocity at the start of the step, (O, P, B)
    level: Array  # normal velocities below which a pair takes part, (O, P, B)
    due: Array  # whether it takes part without contact forces, (O, P, B)
    half_change: Array  # what obstacles that push change their velocities by, half of it, (O, 3, P, B); (O, 3, B): 0

    def of(self, bodies: Array) -> "_Approaches":
        """Those of some of the bodies."""
        return _Approaches(*(taken(part, bodies) for part in self))


class _Pairs(NamedTuple):
    """What the law says of every pair in one step; velocities in m/s."""

    normals: Array  # (O, 3, P, B)
    free: Array  # relative mid-step velocity without contact, (O, 3, P, B)
    normal_velocity: Array  # its normal part, (O, P, B)
    level: Array  # normal velocities below which a pair takes part, (O, P, B)
    target: Array  # c, (O, P, B)
    tangential_target: Array  # c_t, (O, 3, P, B)
    due: Array  # whether it takes part without contact forces, (O, P, B)

    def of(self, bodies: Array) -> "_Pairs":
        """Those of some of the bodies."""
        return _Pairs(*(taken(part, bodies) for part in self))

    def others_due(self, moved: Array, chosen: Array) -> Array:
        """Bodies (B,) with a pair that comes too close under the forces of the pairs that were chosen."""
        due = self.normal_velocity + _along(self.normals, moved) < self.level
        np.put_along_axis(due, chosen[None], False, axis=0)
        return due.any(axis=(0, 1))


class _Chosen(NamedTuple):
    """The pair of every point that takes part first, as in _Pairs; arrays are its own."""

    problems: Problems
    obstacle: Array  # (P, B)
    normals: Array  # (3, P, B)
    free: Array  # (3, P, B)
    normal_velocity: Array  # (P, B)
    level: Array  # (P, B)
    tangential_target: Array  # (3, P, B)

    @staticmethod
    def of_pairs(pairs: _Pairs, friction: Array) -> "_Chosen":
        """Of every point the pair that is furthest below its level; with friction (B,)."""
        if len(pairs.level) == 1:
            obstacle = np.zeros(pairs.level.shape[1:], np.int8)
            normals, free, normal_velocity, level, target, c_t, due = (part[0] for part in pairs)
        else:
            obstacle = (pairs.normal_velocity - pairs.level).argmin(axis=0).astype(np.int8)
            normals, free, normal_velocity, level, target, c_t, due = (_picked(part, obstacle) for part in pairs)
        c_t = c_t * (friction > 0)
        q = free - target * normals
        q -= c_t
        problems = Problems(q, normals, due.astype(float), friction)
        return _Chosen(problems, obstacle, normals, free, normal_velocity, level, c_t)

    def of(self, bodies: Array) -> "_Chosen":
        """Those of some of the bodies."""
        return _Chosen(self.problems.of(bodies), *(taken(part, bodies) for part in self[1:]))

    def add_missed(self, moved: Array) -> Array:
        """Has pairs take part that come too close under the forces; bodies (B,) with such."""
        due = self.problems.due
        missed = (self.normal_velocity + _along(self.normals, moved) < self.level) & (due == 0)
        due[missed] = 1.0
        return missed.any(axis=0)

    def stop_helping_friction(self, forces: Array, moved: Array) -> Array:
        """Sets c_t = 0 where friction would do work on a body; bodies (B,) with such."""
        c_t, q = self.tangential_target, self.problems.q
        negligible = HELPING * np.abs(forces).max(axis=(0, 1)) * np.abs(q).max(axis=(0, 1))
        suspects = (np.einsum("apb,apb->b", forces, c_t) > negligible).nonzero()[0]
        helped = np.zeros(len(negligible), bool)
        if not len(suspects):
            return helped
        f, moved, n, c_t, own = (taken(part, suspects) for part in (forces, moved, self.normals, c_t, q))
        tangential = f - _along(f, n) * n
        work = _along(tangential, moved + own + c_t)
        helps = (work > negligible[suspects]) & c_t.any(axis=0) & (work.sum(axis=0) > negligible[suspects])
        put(q, suspects, own + c_t * helps)
        put(self.tangential_target, suspects, c_t * ~helps)
        helped[suspects] = helps.any(axis=0)
        return helped

    def make_passive(self, forces: Array, moved: Array) -> None:
        """Makes forces, and what they move, smaller where together they would do work on a body."""
        spent, given = (np.einsum("apb,apb->b", forces, velocity) for velocity in (moved, self.free))
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(spent > 0, np.clip(-given / spent, 0.0, 1.0), 1.0)
        forces *= share
        moved *= share


def _along(vectors: Array, directions: Array) -> Array:
    """Scalar products (..., P, B) of (..., 3, P, B)."""
    product = vectors * directions
    along: Array = product[..., 0, :, :] + product[..., 1, :, :]
    along += product[..., 2, :, :]
    return along


def _picked(part: Array, obstacle: Array) -> Array:
    """Of (O, ..., P, B) that of one obstacle for each point."""
    picked: Array = np.take_along_axis(part, obstacle.reshape(1, *(1,) * (part.ndim - 3), *obstacle.shape), axis=0)[0]
    return picked
