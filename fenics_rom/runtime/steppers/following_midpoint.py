"""Steps of a linear body in which all contact pairs do what they did in the step before: `ContactMidpoint`, shorter.

Then it takes no search for forces, and few products of matrices (`steady_pairs`).
"""

import math
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.contact import ContactWork, ObstacleMotion, is_zero
from fenics_rom.mechanics.contact_search import TangentPlanes
from fenics_rom.mechanics.followed_contact import Followed, LawToFollow
from fenics_rom.runtime.steppers.contact_interface import CONTACT, MOTION
from fenics_rom.runtime.steppers.followed_points import FollowedPoints, LinearBody, PairsBegun
from fenics_rom.runtime.steppers.kernel import BookedKernel, StepWork
from fenics_rom.runtime.steppers.steady_pairs import SteadyPairs

FEWEST_KEPT_PAIRS, MOST_KEPT_NUMBERS = 4, 400_000  # sets of pairs that were followed last, and of their matrices


class FollowedWork(NamedTuple):
    """Of a step, what its work is worked out from."""

    numbers: Array  # FollowedPoints.numbers
    forces: Array  # of contact (3P,), N
    rates: Array  # of what carries a force beyond the basis, and of the points there, (6P,)
    normal_power: float | None  # as in ContactSolution


class FollowingMidpoint(BookedKernel):
    """Of the midpoint step. Arguments and attributes as in BookedKernel."""

    _a: Array  # A⁻¹, diagonal (m,) or whole,
    _Ra: Array  # and a root of A⁻¹ D A⁻¹
    _points: FollowedPoints | None = None
    _at_planes: FollowedPoints | None = None  # the same where they stay on what is round
    _pairs: dict[tuple[FollowedPoints, bytes], SteadyPairs]  # of these, of those sets that were followed last

    def _points_to_follow(self, obstacles: ObstacleMotion | None) -> FollowedPoints | None:
        """The contact points, where pairs may do what they did in the step before."""
        interface = self._interface
        if obstacles is None or interface is None or not interface.solver.search.is_steady:
            return None
        known, residual, solver = self._points, self.residual, interface.solver
        if known is not None and known.still is obstacles:
            return known
        rests = np.array_equal(obstacles.end, obstacles.start) and is_zero(obstacles.velocities_before)
        alone = len(solver.obstacles) == 1 and solver.law.stiffness is None and not obstacles.turns
        if residual is None or self.branches is not None or not (rests and alone):
            return None
        if known is not None and np.array_equal(known.still.start, obstacles.start):
            known.still = obstacles
            return known
        changed = self.state, self._rigid_displacement
        body = LinearBody(self._model, self.h, self._a, self._Sᵀ.T, self._delassus, residual, *changed)
        self._points, self._pairs = FollowedPoints(body, solver, obstacles), {}
        return self._points

    def _points_at_planes(self, points: FollowedPoints, planes: TangentPlanes) -> FollowedPoints:
        """The same as long as they stay there."""
        known = self._at_planes
        if known is None or known.planes is not planes or known.body is not points.body:
            self._pairs = {key: pairs for key, pairs in self._pairs.items() if key[0] is points}
            self._at_planes = known = FollowedPoints(points.body, points.solver, points.still, planes)
        known.still = points.still
        return known

    def _follow(self, points: FollowedPoints, u: Array) -> tuple[SteadyPairs, Followed, PairsBegun] | None:
        """A step in which all pairs do what they did; None where they do not."""
        assert self._interface is not None
        mark = self._interface.environment.mark
        begun = points.begin(u)
        if mark is not None:
            mark(MOTION)
        found = None if begun is None else self._follow_pairs(points, begun)
        if mark is not None:
            mark(CONTACT)
        return found

    def _follow_pairs(
        self, points: FollowedPoints, begun: PairsBegun
    ) -> tuple[SteadyPairs, Followed, PairsBegun] | None:
        """The same from what pairs do but for contact."""
        assert self._interface is not None
        solver, chosen = self._interface.solver, begun.margin < 0.0
        search = solver.search
        while (law := LawToFollow.of(search, chosen)) is not None:
            pairs = self._steady_pairs(points, law, begun)
            found = pairs.step(begun, law.kept)
            if found is None:
                return None
            if found.missed is None:
                solver.search = search
                return pairs, found, begun
            chosen, search = chosen | found.missed, search.beside(law.key, found.solution.kept)
        return None

    def _steady_pairs(self, points: FollowedPoints, law: LawToFollow, begun: PairsBegun) -> SteadyPairs:
        """Those that take part, by a law."""
        assert self._interface is not None
        pairs = self._pairs.get((points, law.key))
        if pairs is None:
            of_pairs = self._interface.solver.operator_of(self._delassus, law.chosen, law.key)
            pairs = SteadyPairs(points, law.key, *of_pairs, begun)
            most = max(FEWEST_KEPT_PAIRS, MOST_KEPT_NUMBERS // pairs.size)
            self._pairs = dict(list(self._pairs.items())[1 - most :]) | {(points, law.key): pairs}
        return pairs

    def _end_followed_step(
        self, points: FollowedPoints, pairs: SteadyPairs, found: Followed, begun: PairsBegun
    ) -> float:
        """The same as `_end_step`; the work is worked out together with that of other steps."""
        assert self._interface is not None
        assert self.residual is not None
        numbers = points.numbers.copy()
        told = partial(points.told, numbers), self._delassus, self.h, points.still
        contact = self._interface.solver.keep_followed(found, begun.frames, *told, planes=begun.planes)
        rates = self.residual.move(pairs.beyond)
        self._leave(FollowedWork(numbers, contact.forces.ravel(), rates.ravel(), contact.normal_power))
        self._at_touch = None, rates[1].reshape(-1, 3)
        np.add(points.after_state, pairs.after_state, self.state)
        np.add(points.after_rigid, pairs.after_rigid, self._rigid_displacement)
        self.contact = contact
        return float(self.state.dot(self.state)) + 2 * self.residual.stored

    def flush(self) -> None:
        """As in Kernel."""
        followed = [work for work in self._owed if isinstance(work, FollowedWork)]
        if followed and self.residual is not None:
            others = [work for work in self._owed if not isinstance(work, FollowedWork)]
            self._owed = [*others, self._work_of(followed, self.residual.heat)]
        super().flush()

    def _work_of(self, followed: list[FollowedWork], heat_of_residual: float) -> StepWork:
        """What followed steps are to be booked for together."""
        *parts, normal = zip(*followed, strict=True)
        numbers, forces, rates = (np.concatenate(part).reshape(len(followed), -1) for part in parts)
        m, (_, p) = self._model.order, self._model.inputs.shape
        start = 2 * m + len(self._rigid_displacement)
        e, r, inputs = numbers[:, :m], numbers[:, m : 2 * m], numbers[:, start : start + p]
        pushed, by_contact = inputs @ self._model.inputs.T, forces @ self._Sᵀ.T
        right = pushed + 2 / self.h * r - self._ω * e + by_contact
        v, heat = (right * A if A.ndim == 1 else right @ A.T for A in (self._a, self._Ra))
        ġ, ẏ = np.split(rates, 2, axis=1)
        power = float(np.vdot(by_contact, v) + np.vdot(forces, ẏ))
        by_normals = power if None in normal else math.fsum(normal)
        of_contact = ContactWork(0.0, -self.h * by_normals, self.h * (by_normals - power))
        supplied = self.h * float(np.vdot(pushed, v))
        dissipated = self.h * float(np.vdot(heat, heat)) + heat_of_residual * float(np.vdot(ġ, ẏ))
        return StepWork(supplied, dissipated, (lambda: of_contact,))
