"""Contact of many bodies of one kind with rigid obstacles in one step: the law of `contact_solver`, for all at once.

Every point of a body is paired with the obstacle that it has to be stopped from first. Bodies with a point that two
obstacles press on at once, and those that the splitting does not settle, are left to `ContactSolver`, one by one.

Arrays hold bodies along their last axis and axes x, y, z along the first but for that of obstacles: (O, 3, P, B). On
flat ground whose normal is the last axis, normals are None (`complementarity.normals`): a third less to be done.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.batch_braking import BatchBraking
from fenics_rom.mechanics.body_axis import put, taken
from fenics_rom.mechanics.complementarity.normals import NORMAL, along, subtract_along
from fenics_rom.mechanics.complementarity.problems import Problems
from fenics_rom.mechanics.complementarity.splitting import Splitting
from fenics_rom.mechanics.contact import ContactLaw
from fenics_rom.mechanics.contact_pairs import BACK
from fenics_rom.mechanics.obstacles import HalfSpace, Obstacle

ROUND_OFF = 1e-14  # of the work that forces do at what they add: that of work, as the sum over the points has it


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


class Response(NamedTuple):
    """What T bodies do under contact forces."""

    push: Array  # (T, m) what that adds to what drives them
    yields: Array  # (3, P, T) what it adds to the velocities of their residual parts, m/s
    work: Array  # (T,) of the forces at what they add to the velocities of the points, fᵀ W f, W


class BatchForces(NamedTuple):
    """What contact does in a step; of the T bodies that touch."""

    touching: Array  # (T,) which they are
    forces: Array  # (3, P, T) on the points, N
    response: Response
    work: Array  # (T,) of the forces, relative to the obstacles, W
    obstacle: Array  # (P, T) that each point is paired with
    normals: Array | None  # (3, P, T)
    velocities: Array  # u (3, P, T) of the points under them, less what the law has them be; see `Splitting`
    swung: Array | None  # (P, T) in how many steps in a row friction did not stop points; None: in none
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
        self._radii = np.array([obstacle.core[0] for obstacle in obstacles])  # what goes deeper goes through, m
        flat = [obstacle.height for obstacle in obstacles if isinstance(obstacle, HalfSpace)]
        self._heights = None  # (P, 1) of the points above flat ground, m, if that is all there is
        if len(flat) == len(obstacles) == 1 and flat[0] is not None:
            self._heights = self._points[NORMAL] - flat[0]

    def distances(self, displacement: Array, offsets: Array) -> tuple[Array, Array | None]:
        """Gaps (O, P, B), m, and normals (O, 3, P, B) of points that moved by (3, P, B), obstacles by (O, 3, B), m."""
        if self._heights is not None:
            gap = displacement[NORMAL] + self._heights
            gap -= offsets[0, NORMAL]
            return gap[None], None
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
        distances: tuple[Array, Array | None],
        operator: Splitting,
        respond: Callable[[Array], Response],
        dt: float,
        obstacles: BatchObstacles,
        friction: Array,
        pushed: Array,
        forces: Array,
        u: Array,
        swung: Array,
    ) -> BatchForces | None:
        """Contact forces of one step; None where nothing touches.

        Args:
            motion: what the points do, and would do without contact.
            distances: at the start of the step.
            operator: W of all bodies.
            respond: what bodies do under forces (3, P, T) on their points, N.
            dt: h, s.
            obstacles: how they move.
            friction: μ (B,).
            pushed: (O, P, B) pairs that had forces in the step before.
            forces, u: (3, P, B) of the step before; may be made those of this one.
            swung: (O, P, B) in how many steps in a row pairs were not stopped; see `Braking`.
        """
        pairs = self._pairs(motion, distances, dt, obstacles, pushed)
        touching = pairs.due.any(axis=(0, 1)).nonzero()[0]
        if not len(touching):
            return None
        if len(touching) < len(friction):
            pairs, friction = pairs.of(touching), friction[touching]
            forces, u, swung = (taken(part, touching) for part in (forces, u, swung))
        forces, u = np.ascontiguousarray(forces), np.ascontiguousarray(u)
        chosen = _Chosen.of_pairs(pairs, friction)
        alone, settled = (pairs.due & pairs.too_far).any(axis=(0, 1)), np.ones(len(touching), bool)
        settled[operator.look(chosen.problems, forces, u)] = False
        several = len(self._obstacles) > 1
        if several:
            alone |= np.count_nonzero(pairs.due, axis=0).max(axis=0) > 1
            alone |= pairs.others_due(chosen, u) & settled
        of_points = swung[0] if len(swung) == 1 else _picked(swung, chosen.obstacle)
        braking = BatchBraking(of_points, chosen.tangential_target)
        part, found, pending = chosen, (forces, u), np.arange(len(touching))
        again = chosen.to_solve_again(forces, u, settled, braking, pending)
        while again.any():
            if not again.all():
                left = again.nonzero()[0]
                part, found, pending = part.of(left), (taken(found[0], left), taken(found[1], left)), pending[left]
            alone[pending[operator.search(part.problems, *found)]] = True
            if several:
                alone[pending] |= pairs.of(pending).others_due(part, found[1])
            if part is not chosen:
                put(forces, pending, found[0])
                put(u, pending, found[1])
            again = part.to_solve_again(*found, np.ones(len(pending), bool), braking, pending)
        response = respond(forces)
        work = chosen.make_passive(forces, response)
        of_points = chosen.obstacle, chosen.problems.normals, u, braking.swung
        return BatchForces(touching, forces, response, work, *of_points, touching[alone])

    def _pairs(
        self,
        motion: BatchMotion,
        distances: tuple[Array, Array | None],
        dt: float,
        obstacles: BatchObstacles,
        pushed: Array,
    ) -> "_Pairs":
        """How fast every pair comes near, and what the law says of it; see ContactSolver._all_pairs."""
        (gaps, normals), e = distances, self._law.restitution
        relative, free = motion.velocity[None], motion.free_velocity[None]
        if len(obstacles.velocities) > 1 or obstacles.velocities.any():
            w = obstacles.velocities[:, :, None]
            relative, free = relative - w, free - w
        # What pushes keeps to an obstacle that changes its velocity.
        half_change = (obstacles.velocities - obstacles.velocities_before) / 2
        if half_change.any():
            relative = relative + half_change[:, :, None] * pushed[:, None]
        approach, normal_velocity = along(relative, normals), along(free, normals)
        level = gaps / -dt
        np.maximum(level, (level + approach / 2) / 2, out=level)
        target = (approach / 2 - gaps / dt) / 2
        np.minimum(target, approach / 2, out=target)
        if e > 0:
            leaves = normal_velocity >= BACK * (1 + e) * approach if e < 1 else True
            np.copyto(target, (1 - e) / 2 * approach, where=leaves)
        np.minimum(target, 0.0, out=target)
        if gaps.min(initial=0.0) < 0:
            speed = np.sqrt(np.square(obstacles.velocities).sum(axis=1))[:, None]
            target[-gaps / dt > np.abs(approach) + np.abs(normal_velocity) + speed] = 0.0
        # What is far, and due by nothing but forces on others, would tell of velocities that there are not.
        missed, target = target, np.maximum(target, -np.abs(normal_velocity).max(axis=(0, 1)))
        due, tangential, too_far = normal_velocity < level, relative / 2, np.zeros(target.shape, dtype=bool)
        if np.isfinite(self._radii).any():
            too_far = gaps + dt * target < -self._radii[:, None, None]
        subtract_along(tangential, approach / 2, normals)
        return _Pairs(normals, free, normal_velocity, level, target, missed, tangential, due, too_far)


class _Pairs(NamedTuple):
    """What the law says of every pair in one step; velocities in m/s."""

    normals: Array | None  # (O, 3, P, B)
    free: Array  # relative mid-step velocity without contact, (O, 3, P, B)
    normal_velocity: Array  # its normal part, (O, P, B)
    level: Array  # normal velocities below which a pair takes part, (O, P, B)
    target: Array  # c, (O, P, B)
    missed: Array  # the same if forces on others make it due, (O, P, B)
    tangential_target: Array  # c_t, (O, 3, P, B)
    due: Array  # whether it takes part without contact forces, (O, P, B)
    too_far: Array  # whether the law lets it through an obstacle, which the solver of one body does not, (O, P, B)

    def of(self, bodies: Array) -> "_Pairs":
        """Those of some of the bodies."""
        normals = None if self.normals is None else taken(self.normals, bodies)
        return _Pairs(normals, *(taken(part, bodies) for part in self[1:]))

    def others_due(self, chosen: "_Chosen", u: Array) -> Array:
        """Bodies (B,) with a pair that comes too close under the forces of those that were chosen, which lead to u."""
        moved = u - chosen.problems.q
        due = self.normal_velocity + along(moved[None], self.normals) < self.level
        np.put_along_axis(due, chosen.obstacle[None], False, axis=0)
        return due.any(axis=(0, 1))


class _Chosen(NamedTuple):
    """The pair of every point that takes part first, as in _Pairs; arrays are its own but for `free`."""

    problems: Problems
    obstacle: Array  # (P, B)
    free: Array  # (3, P, B)
    level: Array  # (P, B)
    target: Array  # (P, B)
    missed: Array  # (P, B)
    tangential_target: Array  # (3, P, B)

    @staticmethod
    def of_pairs(pairs: _Pairs, friction: Array) -> "_Chosen":
        """Of every point the pair that is furthest below its level; with friction (B,)."""
        parts = pairs.free, pairs.level, pairs.target, pairs.missed, pairs.tangential_target, pairs.due
        if len(pairs.level) == 1:
            obstacle = np.zeros(pairs.level.shape[1:], np.int8)
            free, level, target, missed, c_t, due = (part[0] for part in parts)
            normals = None if pairs.normals is None else pairs.normals[0]
        else:
            obstacle = (pairs.normal_velocity - pairs.level).argmin(axis=0).astype(np.int8)
            free, level, target, missed, c_t, due = (_picked(part, obstacle) for part in parts)
            normals = None if pairs.normals is None else _picked(pairs.normals, obstacle)
        if not friction.all():
            c_t = c_t * (friction > 0)
        q = free - c_t
        subtract_along(q, target, normals)
        problems = Problems.whole(q, normals, due.astype(float), friction)
        return _Chosen(problems, obstacle, free, level, target, missed, c_t)

    def of(self, bodies: Array) -> "_Chosen":
        """Those of some of the bodies."""
        return _Chosen(self.problems.of(bodies), *(taken(part, bodies) for part in self[1:]))

    def to_solve_again(self, forces: Array, u: Array, settled: Array, braking: BatchBraking, bodies: Array) -> Array:
        """Bodies (B,) that are not settled, or have pairs that were missed, or are asked for another c_t.

        Under forces (3, P, B), at u. Missed pairs of settled bodies are made to take part. Of `braking` these are the
        `bodies` (B,).
        """
        again = ~settled
        if not again.all():
            missed = self._add_missed(u, settled)
            if missed.any():
                again |= missed
                braking.ask_anew(bodies, self.problems, self.tangential_target, missed.nonzero()[0])
                settled = settled & ~missed
            again |= braking.asks_less(bodies, self.problems, self.tangential_target, forces, u, settled)
        return again

    def _add_missed(self, u: Array, settled: Array) -> Array:
        """Has pairs take part that come too close under the forces; bodies (B,) with such."""
        due = self.problems.due
        if due.all():
            return np.zeros(due.shape[1], bool)
        missed = (self.target + along(u, self.problems.normals) < self.level) & (due == 0) & settled
        due[missed] = 1.0
        if missed.any():
            change = (self.missed - self.target) * missed
            subtract_along(self.problems.q, change, self.problems.normals)
            np.add(self.target, change, out=self.target)
        return missed.any(axis=0)

    def make_passive(self, forces: Array, response: Response) -> Array:
        """Makes forces, and their response, smaller where they would do work on a body; that which they do, (B,), W."""
        given, spent = np.einsum("apb,apb->b", forces, self.free), response.work
        work: Array = given + spent
        added = (work > ROUND_OFF * spent).nonzero()[0]
        if len(added):
            share = np.maximum(-given[added] / spent[added], 0.0)
            for part in (forces, response.yields):
                put(part, added, taken(part, added) * share)
            response.push[added] *= share[:, None]
            work[added] = share * (given[added] + share * spent[added])
        return work


def _picked(part: Array, obstacle: Array) -> Array:
    """Of (O, ..., P, B) that of one obstacle for each point."""
    picked: Array = np.take_along_axis(part, obstacle.reshape(1, *(1,) * (part.ndim - 3), *obstacle.shape), axis=0)[0]
    return picked
