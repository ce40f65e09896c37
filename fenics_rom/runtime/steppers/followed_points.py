"""What a linear body and its contact points do in a step at an obstacle that rests, by few products.

With x = [e, r, s, u, 1] of the state, the displacement s along rigid motions and the inputs, and with what the residual
part adds to each point, y and ẏ, all that a step begins with is linear: the state that it leads to but for contact, and
where points are and their velocities, along axes that last (see Frames); where the obstacle is flat, what the normal
law makes of them, too.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.complementarity import Frames
from fenics_rom.mechanics.contact import ObstacleMotion, PointMotion
from fenics_rom.mechanics.contact_search import TangentPlanes
from fenics_rom.mechanics.contact_solver import ContactSolver
from fenics_rom.mechanics.obstacles import HalfSpace
from fenics_rom.mechanics.points_operator import Operator
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.runtime.steppers.residual_motion import ResidualMotion

ROUND_OFF = 4 * float(np.finfo(float).eps)  # of normals that stay
SHORT_WAY = 1e-13  # of the size of the body, that points which stay may go
STEPS_UNTURNED = 64  # after which points are taken to stay where they are: planes take as long to make as ten steps
_ONES = np.ones(3)


class LinearBody(NamedTuple):
    """A linear body in steps of h s."""

    model: ContactModel  # of the contact mode, of order m
    h: float
    compliance: Array  # A⁻¹ (m,) or (m, m)
    rows: Array  # of the points (3P, m)
    delassus: Operator  # W of all of them (3P, 3P), m/s/N
    residual: ResidualMotion  # how they yield beyond the basis
    state: Array  # [e, r] (2m,), which steps change
    rigid: Array  # s (ρ,), which they do, too

    def applied(self, columns: Array) -> Array:
        """A⁻¹ times columns (m, k)."""
        return self.compliance[:, None] * columns if self.compliance.ndim == 1 else self.compliance @ columns

    def after(self, v: Array) -> Array:
        """What mid-step velocities (m, k) change of [e⁺ + e, r⁺ - r, s⁺ - s], (2m + ρ, k)."""
        travel = self.h * np.sqrt(self.model.eigenvalues)
        return np.concatenate([travel[:, None] * v, 2 * v, self.h * v[: len(self.rigid)]])


class PairsBegun(NamedTuple):
    """What the pairs of P points and an obstacle do in a step, but for contact, in axes that last (see Frames)."""

    frames: Frames
    margin: Array  # by how much they come less near than a pair that takes part, (P,), m/s
    moves: Array  # (6, P): what forces have to stop, if an approach is to end that is away from the obstacle, too,
    #               and the velocity at the start, m/s; of what is round (12, P), after normals, approach along these,
    #               NormalLaw.target and margin
    closing: Array | None  # -g/h (P,), m/s, where all normals are the first of the axes; None elsewhere
    planes: TangentPlanes | None  # that the points are at, to go on with


class FollowedPoints:
    """The points of one contact mode in steps of one length, at one obstacle that rests.

    Args:
        body: that has them.
        solver: of the rigid contact law.
        still: the obstacle, which does not move.
        planes: where points are on what is round, if they stay there.

    Attributes:
        body, solver, still, planes: as given.
        share: of the velocity along normals at the start that `PairsBegun.moves` has pairs keep; where that is none,
            and normals are the first of the axes, impacts lose nothing.
        pushed: what forces on the points (3P,) add to [e⁺, r⁺, s⁺], (2m + ρ, 3P).
        numbers: [x, y, ẏ] of the last step, which the next one overwrites.
        after_state, after_rigid: [e⁺, r⁺] (2m,) and s⁺ (ρ,) but for contact, in the same way.
    """

    def __init__(
        self, body: LinearBody, solver: ContactSolver, still: ObstacleMotion, planes: TangentPlanes | None = None
    ):
        self.body, self.solver, self.still, self.planes = body, solver, still, planes
        self._rule, self._obstacle, law = solver.rule(body.h), solver.obstacles[0], solver.law
        model, h, rows, rigid = body.model, body.h, body.rows, body.rigid
        placed, (m, p), ρ, P = solver.points - still.start[0], model.inputs.shape, len(rigid), len(solver.points)
        at = planes
        if at is None and isinstance(self._obstacle, HalfSpace):
            gaps, normals = self._obstacle.distance(placed)
            at = TangentPlanes(placed, gaps, Frames(normals))
        self._frames = None if at is None else at.frames

        ends = np.cumsum([m, m, ρ, p, 1])
        e, r, s, u, one = (slice(*bound) for bound in pairwise((0, *ends)))
        right, motion, state = np.zeros((m, ends[-1])), np.zeros((3, 3 * P, ends[-1])), np.eye(2 * m + ρ, ends[-1])
        right[:, e], right[:, r], right[:, u] = np.diag(-np.sqrt(model.eigenvalues)), 2 / h * np.eye(m), model.inputs
        v, state[r] = body.applied(right), -state[r]
        motion[0, :, e], motion[0, :, :ρ], motion[0, :, s] = rows / model.safe_frequencies, 0.0, rows[:, :ρ]
        motion[1, :, r], motion[2] = rows, rows @ v
        self._motion, self._added = motion, body.residual.maps.added[:, 1::2]

        # What of the velocity at the start pairs are to have in the middle, along normals and tangents.
        self._shares = np.full(3, 0.5 if law.friction else 0.0)
        if self._frames is not None:
            self._shares[0] = 0.0 if self._rule.is_elastic else 0.5
        self.share, self._share = float(self._shares[0]), self._shares[0]
        axes = np.broadcast_to(np.eye(3) if at is None else at.frames.axes, (P, 3, 3))
        places, velocities, free = np.einsum("pji,kpjn->kipn", axes, motion.reshape(3, P, 3, -1))
        places[:, :, one] = np.einsum("pji,pj->ip", axes, placed if at is None else placed - at.places)[:, :, None]
        if at is not None:
            places[0, :, one] += at.gaps[:, None]
        of_x = self._of_pairs(places, velocities, free)
        if planes is not None:
            of_x[8, :, one] -= planes.gaps[:, None]
        by_beyond = self._of_pairs(*np.einsum("ka,pji->kipaj", self._added, axes).reshape(3, 3, P, 6))
        # It is the same of all pairs, where these have the same axes.
        self._by_beyond = by_beyond[:, 0].copy() if planes is None else by_beyond.transpose(2, 0, 1).copy()
        self.pushed = body.after(body.applied(rows.T))
        self._product = np.concatenate([of_x.reshape(-1, ends[-1]), state + body.after(v)])

        self.numbers, whole = np.zeros(ends[-1] + 6 * P), np.zeros(6 * P + len(self._product))
        self._round, self._begun = whole[: 12 * P].reshape(12, P), whole[6 * P :]
        self._normals, (self._approach, self._target, self._margin) = self._round[:3], self._round[3:6]
        self._x, self._beyond = self.numbers[: ends[-1]], self.numbers[ends[-1] :].reshape(6, P)
        self._x[one] = 1.0
        self._before, self._along, self._inputs = self._x[: 2 * m], self._x[s], self._x[u]
        self._carried = body.residual.state.reshape(4, P, 3)[1::2].swapaxes(1, 2)  # y and ẏ
        self._added_before = self._beyond.reshape(2, 3, P)
        pairs, self.after_state, self.after_rigid = np.split(self._begun, len(of_x) * P + np.array([0, 2 * m]))
        self._pairs = pairs.reshape(-1, P)
        self._moves, self._last = self._pairs[:6], self._pairs[6:]
        self._q, self._velocity = self._pairs[:3], self._pairs[3:6]
        if planes is not None:
            self._way = self._pairs[8:].ravel()  # that the points are from the planes' places
            curvature, size = np.abs(self._obstacle.curvature(planes.places)).max(), np.ptp(solver.points, axis=0).max()
            self._farthest = float(min(ROUND_OFF / max(curvature, 1e-300), SHORT_WAY * size) ** 2)

    def _of_pairs(self, places: Array, velocities: Array, free: Array) -> Array:
        """What is asked of pairs, (k, ...), from where they are and their velocities in axes that last, (3, ...).

        That is PairsBegun.moves, of what is flat both parts of `margin`, and of what is round the places.
        """
        q, last = free - self._shares.reshape(3, *(1,) * (free.ndim - 1)) * velocities, places
        if self._frames is not None:
            closing, later = self._rule.linear(places[0], velocities[0])
            if self.share:
                q[0] = free[0] - later
            margins = free[0] - closing, closing
            last = np.array(margins if self.planes is None else [*margins, *places])
        return np.concatenate([q, velocities, last])

    def begin(self, u: Array) -> PairsBegun | None:
        """What pairs do in a step under u (p,); None where points left the planes, or all round normals are alike."""
        self._before[:], self._inputs[:] = self.body.state, u
        self._along[:], self._added_before[:] = self.body.rigid, self._carried
        self._product.dot(self._x, self._begun)
        pairs = self._pairs
        if self.planes is None:
            pairs += self._by_beyond.dot(self._beyond)
        else:
            pairs += np.einsum("akp,ap->kp", self._by_beyond, self._beyond)
            if not self._way.dot(self._way) <= self._farthest:
                return None  # they turn
        moves, last = self._moves, self._last
        if self._frames is not None:
            later = moves[0] if self.share else moves[0] - (last[1] + moves[3] / 2) / 2
            return PairsBegun(self._frames, np.minimum(last[0], later), moves, last[1], self.planes)
        gaps, normals = self._obstacle.distance(last.T)
        frames, planes = self.solver.search.frames_along(normals), None
        if frames.are_alike:
            return None
        n, approach, margin = self._normals, self._approach, self._margin
        n[:] = frames.normals.T
        _ONES.dot(self._velocity * n, approach)
        _ONES.dot(self._q * n, margin)
        if self.share:
            margin += self._share * approach
        level, self._target[:], _ = self._rule.asks(gaps, gaps.item(gaps.argmin()), None, approach, margin)
        margin -= level
        if self.solver.search.unturned >= STEPS_UNTURNED and frames is self.solver.search.frames:
            planes = TangentPlanes(last.T.copy(), gaps, frames)
        return PairsBegun(frames, margin, self._round, None, planes)

    def flat_targets(self) -> tuple[Array, Array]:
        """NormalLaw.target at a flat obstacle in the step that was begun last, and by how much `moves` has more."""
        approach, closing = self._velocity[0], self._last[1]
        outwards = self._last[0] + closing
        target = self._rule.of(closing, -closing.item(closing.argmax()), None, approach, outwards).target
        return target, outwards - self._q[0] - target

    def told(self, numbers: Array) -> tuple[PointMotion, Array, Array]:
        """Of a step with these `numbers`, what the points do, as ContactSolver.keep_followed asks for."""
        own = len(self._x)
        by_point = numbers[own:].reshape(2, 3, -1).swapaxes(1, 2)
        beyond = np.tensordot(self._added, by_point, 1)
        points = PointMotion(*self._motion.dot(numbers[:own]).reshape(3, -1, 3) + beyond)
        return points, points.free_velocity, points.velocity
