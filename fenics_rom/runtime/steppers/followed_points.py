"""What the contact points of a linear body do in a step at an obstacle that rests, by few products.

With x = [e, r, s, u, 1] of the state, the displacement s along rigid motions and the inputs, and with what the residual
part adds to each point, y and ẏ, all that a step begins with is linear: what drives the body, where points are and
their velocities, along axes that last (see Frames); where the obstacle is flat, what the normal law makes of them, too.
"""

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.complementarity import Frames
from fenics_rom.mechanics.contact import ObstacleMotion, PointMotion
from fenics_rom.mechanics.contact_solver import ContactSolver
from fenics_rom.mechanics.followed_contact import PairsMotion
from fenics_rom.mechanics.obstacles import HalfSpace
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.runtime.steppers.residual_motion import ResidualMotion

_ONES, _HALF = np.ones(3), np.array(0.5)


class FollowedWork(NamedTuple):
    """Of a step, what its work is worked out from."""

    inputs: Array  # (p,)
    right: Array  # (m,) all that drives the body, N kg^-1/2
    by_contact: Array  # (m,) contact alone
    velocity: Array  # v̂ (m,)
    forces: Array  # of contact (3P,), N
    rates: Array  # of what carries a force beyond the basis, and of the points there, (2, 3P)
    normal_power: float | None  # as in ContactSolution


class FollowedPoints:
    """The points of one contact mode in steps of h s, at one obstacle that rests.

    Args:
        model: of the contact mode.
        h: time step, s.
        applied: gives A⁻¹ times columns (m, k).
        rows: (3P, m) of the points.
        residual: how they yield beyond the basis.
        state, rigid: [e, r] (2m,) and s (ρ,), which steps change.
        solver: of the rigid contact law.
        still: the obstacle, which does not move.

    Attributes:
        still: as given.
    """

    def __init__(
        self,
        model: ContactModel,
        h: float,
        applied: Callable[[Array], Array],
        rows: Array,
        residual: ResidualMotion,
        state: Array,
        rigid: Array,
        solver: ContactSolver,
        still: ObstacleMotion,
    ):
        self.still, self._solver, self._rule, self._obstacle = still, solver, solver.rule(h), solver.obstacles[0]
        placed, (m, p), ρ, P = solver.points - still.start[0], model.inputs.shape, len(rigid), len(solver.points)
        gaps, normals = self._obstacle.distance(placed)
        self._frames = Frames(normals) if isinstance(self._obstacle, HalfSpace) else None
        self._slides = solver.law.friction > 0

        ends = np.cumsum([m, m, ρ, p, 1])
        e, r, s, u, one = (slice(*bound) for bound in pairwise((0, *ends)))
        right, motion = np.zeros((m, ends[-1])), np.zeros((3, 3 * P, ends[-1]))
        right[:, e], right[:, r], right[:, u] = np.diag(-np.sqrt(model.eigenvalues)), 2 / h * np.eye(m), model.inputs
        motion[0, :, e], motion[0, :, :ρ], motion[0, :, s] = rows / model.safe_frequencies, 0.0, rows[:, :ρ]
        motion[1, :, r], motion[2] = rows, rows @ applied(right)
        turn, added = np.eye(3) if self._frames is None else self._frames.axes[0].T, residual.maps.added[:, 1::2]
        self._motion, self._added = motion, added

        places, velocities, free = np.einsum("ij,kpjn->kipn", turn, motion.reshape(3, P, 3, -1))
        places[:, :, one] = placed.T[:, :, None]
        if self._frames is not None:
            places[0, :, one] = gaps[:, None]
        of_x = self._of_pairs(places, velocities, free)
        self._by_beyond = self._of_pairs(*np.einsum("ka,ij->kiaj", added, turn).reshape(3, 3, 6))
        self._product = np.concatenate([of_x.reshape(-1, ends[-1]), right])

        self._numbers, self._begin = np.zeros(ends[-1] + 6 * P), np.empty(len(self._product))
        self._x, self._beyond = self._numbers[: ends[-1]], self._numbers[ends[-1] :].reshape(6, P)
        self._x[one] = 1.0
        self._inputs, self._followed = (
            self._x[u],
            [
                (self._x[: 2 * m], state),
                (self._x[s], rigid),
                (self._beyond.reshape(2, 3, P), residual.state.reshape(4, P, 3)[1::2].swapaxes(1, 2)),  # y and ẏ
            ],
        )
        self._pairs, self._right = self._begin[: len(of_x) * P].reshape(-1, P), self._begin[len(of_x) * P :]
        self._free, self._outwards, of_law = self._pairs[:3], self._pairs[0], 6 if self._slides else 3
        self._sliding, self._of_law = self._pairs[3:6] if self._slides else None, list(self._pairs[of_law:])

    def _of_pairs(self, places: Array, velocities: Array, free: Array) -> Array:
        """What `motion` asks of pairs, (k, ...), from where they are and their velocities in axes that last, (3, ...).

        That is PairsMotion.free, `sliding`, and what the normal law makes of them or, of what is not flat, the places
        and velocities.
        """
        sliding, of_law = velocities / 2, [*places, *velocities]
        if self._frames is not None:
            sliding[0], of_law = 0.0, [*self._rule.linear(places[0], velocities[0]), velocities[0]]
        return np.array([*free - sliding, *sliding, *of_law] if self._slides else [*free, *of_law])

    def motion(self, u: Array) -> tuple[PairsMotion | None, Array]:
        """What pairs do in a step under u (p,), and what drives the body (m,), N kg^-1/2; the next step overwrites it.

        No pairs where the obstacle is not flat, but all normals are alike.
        """
        self._inputs[:] = u
        for own, values in self._followed:
            own[:] = values
        self._product.dot(self._x, self._begin)
        pairs = self._pairs
        pairs += self._by_beyond.dot(self._beyond)
        if self._frames is None:
            return self._of_round(), self._right
        closing, half, later, approach = self._of_law
        asked = self._rule.of(closing, half, later, approach, -closing.item(closing.argmax()), None)
        return PairsMotion(self._frames, None, asked, self._outwards, self._free, self._sliding, None), self._right

    def _of_round(self) -> PairsMotion | None:
        """The motion of pairs whose normals differ, from what the products say."""
        own = len(self._pairs) - 6
        places, velocities, free = self._pairs[own : own + 3], self._pairs[own + 3 :], self._free
        gaps, normals = self._obstacle.distance(places.T)
        frames = self._solver.search.frames_along(normals)
        n = frames.lasting_normals
        if n is None:
            return None
        approach, outwards, across = _ONES.dot(velocities * n), _ONES.dot(free * n), None
        if self._slides:
            across = _HALF * approach
            outwards += across
        asked = self._rule.asks(gaps, gaps.item(gaps.argmin()), None, approach)
        return PairsMotion(frames, n, asked, outwards, free, self._sliding, across)

    def told(self) -> Callable[[], tuple[PointMotion, Array, Array]]:
        """Tells what the points do in the step for which `motion` was asked last, and ContactSolver.follow's `told`."""
        numbers, own, rows, added = self._numbers.copy(), len(self._x), self._motion, self._added

        def told() -> tuple[PointMotion, Array, Array]:
            by_point = numbers[own:].reshape(2, 3, -1).swapaxes(1, 2)
            points = PointMotion(*rows.dot(numbers[:own]).reshape(3, -1, 3) + np.tensordot(added, by_point, 1))
            return points, points.free_velocity, points.velocity

        return told
