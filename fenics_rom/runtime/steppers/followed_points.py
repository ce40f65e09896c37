"""What the contact points of a linear body do in a step at an obstacle that rests, by one product.

With x = [e, r, s, u, 1, y, ẏ] of the state, the displacement s along rigid motions, the inputs, and what the residual
part adds to the points, all that a step begins with is linear: what drives the body, where points are, and their
velocities, along axes that last (see Frames). So is what the normal law makes of it, where the obstacle is flat.
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
        ends = np.cumsum([m, m, ρ, p, 1, 3 * P, 3 * P])
        e, r, s, u, one, y, ẏ = (slice(*bound) for bound in pairwise((0, *ends)))
        right, motion = np.zeros((m, ends[-1])), np.zeros((3, 3 * P, ends[-1]))
        right[:, e], right[:, r], right[:, u] = np.diag(-np.sqrt(model.eigenvalues)), 2 / h * np.eye(m), model.inputs
        motion[0, :, e], motion[0, :, :ρ], motion[0, :, s] = rows / model.safe_frequencies, 0.0, rows[:, :ρ]
        motion[1, :, r], motion[2] = rows, rows @ applied(right)
        for part, (_, by_y, _, by_ẏ) in zip(motion, residual.maps.added, strict=True):
            part[:, y] += by_y * np.eye(3 * P)
            part[:, ẏ] += by_ẏ * np.eye(3 * P)
        self._motion = motion

        gaps, normals = self._obstacle.distance(placed)
        self._frames = Frames(normals) if isinstance(self._obstacle, HalfSpace) else None
        turn = np.eye(3) if self._frames is None else self._frames.axes[0].T
        places, velocities, free = np.einsum("ij,kpjn->kipn", turn, motion.reshape(3, P, 3, -1))
        places[:, :, one], self._slides = placed.T[:, :, None], solver.law.friction > 0
        sliding = velocities / 2 if self._slides else np.zeros((3, 0, ends[-1]))
        of_law = [places, velocities]
        if self._frames is not None:
            places[0, :, one], approach = gaps[:, None], velocities[0]
            of_law = [*self._rule.linear(places[0], approach), approach]
            sliding[0] = 0.0
        blocks = [free - sliding if self._slides else free, sliding, *of_law, right]
        blocks = [block.reshape(-1, ends[-1]) for block in blocks]
        self._product, bounds = np.concatenate(blocks), np.cumsum([0, *map(len, blocks)]).tolist()
        self._blocks = [slice(*bound) for bound in pairwise(bounds)]
        self._x = x = np.zeros(ends[-1])
        x[one] = 1.0
        beyond = residual.state.reshape(4, -1)[1::2]  # y and ẏ
        self._inputs, self._followed = x[u], [(x[: 2 * m], state), (x[s], rigid), (x[ends[4] :].reshape(2, -1), beyond)]

    def motion(self, u: Array) -> tuple[PairsMotion | None, Array]:
        """What pairs do in a step under u (p,), and what drives the body (m,), N kg^-1/2.

        No pairs where the obstacle is not flat, but all normals are alike.
        """
        self._inputs[:] = u
        for own, values in self._followed:
            own[:] = values
        begin = self._product.dot(self._x)
        free, sliding, *of_law, right = [begin[block] for block in self._blocks]
        free, sliding = free.reshape(3, -1), sliding.reshape(3, -1) if self._slides else None
        if self._frames is None:
            return self._of_round(free, sliding, *of_law), right
        closing, half, later, approach = of_law
        asked = self._rule.of(closing, half, later, approach, -closing.item(closing.argmax()), None)
        return PairsMotion(self._frames, None, asked, free[0], free, sliding, None), right

    def _of_round(self, free: Array, sliding: Array | None, places: Array, velocities: Array) -> PairsMotion | None:
        """The motion of pairs whose normals differ, from what the product says."""
        gaps, normals = self._obstacle.distance(places.reshape(3, -1).T)
        frames = self._solver.search.frames_along(normals)
        n = frames.lasting_normals
        if n is None:
            return None
        approach, outwards, across = _ONES.dot(velocities.reshape(3, -1) * n), _ONES.dot(free * n), None
        if sliding is not None:
            across = _HALF * approach
            outwards += across
        asked = self._rule.asks(gaps, gaps.item(gaps.argmin()), None, approach)
        return PairsMotion(frames, n, asked, outwards, free, sliding, across)

    def points(self) -> Callable[[], PointMotion]:
        """Tells what the points do in the step for which `motion` was asked last."""
        x, rows = self._x.copy(), self._motion
        return lambda: PointMotion(*rows.dot(x).reshape(3, -1, 3))
