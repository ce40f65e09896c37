"""A step of a body in a moving frame, to be gone back through; see parted_adjoint.py.

Each part tells its slopes, and they are added up as the step is. Of a body that a base carries v̂ and ω̂ are given: their
rows are left out, and what J owes to them it owes to the base. ∂J/∂x is written x_.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.contact_adjoint import ContactAdjoint
from fenics_rom.runtime.steppers.acts.following import FollowingLoads
from fenics_rom.runtime.steppers.acts.found_slopes import FoundSlopes
from fenics_rom.runtime.steppers.elastic.law import LawAdjoint
from fenics_rom.runtime.steppers.frame_loads import FrameForces, FrameLoads
from fenics_rom.runtime.steppers.frame_slopes import InertiaSlopes, Moving, PointsMoved, StepTurn
from fenics_rom.runtime.steppers.ground_ties import GroundTies
from fenics_rom.runtime.steppers.residual_maps import ResidualMaps
from fenics_rom.runtime.steppers.slopes import Slopes
from fenics_rom.runtime.steppers.touch_adjoint import Touch, of_world


class TouchedPoints(NamedTuple):
    """The contact points in a step, in the frame, and what touched them."""

    rows: Array  # Vᵀ (m, 3P)
    places: Array  # y at the start (P, 3)
    inside: Array  # û (P, 3)
    start: Array  # V r and what they yield at the start (P, 3)
    start_spin: Array  # ω then (3,)
    forces: Array  # of contact (P, 3), in world axes
    contact: ContactAdjoint


class Acting(NamedTuple):
    """What acts on a body in a step, but for contact."""

    loads: FrameLoads
    forces: FrameForces
    following: FollowingLoads | None
    u: Array  # (p,), with what was found
    middle: Array  # q (m,) where loads that follow act
    reach: float  # s: the middle is q + reach v̂, where it follows v̂
    ties: GroundTies | None
    edges: Array  # q (m,) where pressures on open surfaces act as a whole, as the body was expected to go on
    guided_by: str  # by what that was: "x", "velocity" (r) at the start, or "law", which carries it along


class FramePart(NamedTuple):
    """As in StepPart."""

    inertia: InertiaSlopes
    step: StepTurn
    ends: tuple[Moving, Moving]
    acting: Acting
    law: LawAdjoint
    found: FoundSlopes | None
    residual: ResidualMaps | None
    touched: TouchedPoints | None
    pressed: tuple[PointsMoved, Array] | None = None  # contact points that forces (P, 3) are known to act on

    @property
    def own(self) -> slice:
        """As in StepPart."""
        return slice(6 if self.inertia.frame.carried else 0, None)

    @property
    def shape(self) -> slice:
        """As in StepPart."""
        return slice(6, None)

    @property
    def turned(self) -> Array | None:
        """As in StepPart."""
        following = self.acting.following
        return None if following is None else following.slope(self.acting.u, self.acting.middle)

    @property
    def half(self) -> float:
        """As in StepPart."""
        return self.step.h / 2

    def back(self, place_: Array, velocity_: Array) -> tuple[Array, Array, Array]:
        """As in StepPart."""
        return self.step.back(place_, velocity_)

    def stored(self) -> tuple[Array, Array]:
        """As in StepPart."""
        _, end = self.ends
        place, velocity = self.inertia.stored(end)
        if self.acting.ties is not None:
            place = place + self.acting.ties.stored_slopes(end, self.step.turn.end)
        return place, velocity

    def balance(self) -> tuple[Slopes, Array]:
        """As in StepPart."""
        (start, end), step = self.ends, self.step
        loads, forces, following, _, middle, reach, ties, edges, _ = self.acting
        balance = self.inertia.balance(start, end, step)
        of_loads, by_input = loads.slopes(forces, step, self.inertia.frame, (start.q, end.q))
        balance = balance.with_(of_loads, -1.0)
        if ties is not None:
            balance = balance.with_(ties.push_slopes(start, end, step), -1.0)
        slope = self.turned
        if following is not None and slope is not None:
            balance.place[6:, 6:] -= slope
            balance.x[6:, 6:] -= reach * slope
            for column, follower in following.followers:
                by_input[6:, column] += follower.force(middle)
        if following is not None and following.rims:
            mean, origin = (step.turn.start + step.turn.end) / 2, self.inertia.frame.origin
            by_edges = self._by_edges()
            balance.place[:, 6:] -= by_edges
            guided = {"x": balance.x, "velocity": balance.velocity}.get(self.acting.guided_by)
            if guided is not None:
                guided[:, 6:] -= self.half * by_edges
            for column, rim in following.rims:
                wrench = rim.wrench(edges, origin)
                by_input[:6, column] += np.concatenate([mean @ wrench[:3], wrench[3:]])
        if self.pressed is not None:
            points, forces_known = self.pressed
            balance = balance.with_(points.push(forces_known).slopes, -1.0)
        return balance, by_input

    def _by_edges(self) -> Array:
        """What pressures on open surfaces do as a whole changes by with the shape, (k, m)."""
        following, turn, m = self.acting.following, self.step.turn, len(self.acting.edges)
        assert following is not None
        by_edges = np.zeros((6 + m, m))
        by_edges[:6] = following.wrench_slopes(self.acting.u, self.acting.edges, self.inertia.frame.origin)
        by_edges[:3] = (turn.start + turn.end) / 2 @ by_edges[:3]
        return by_edges

    @property
    def by_velocity_before(self) -> Array | None:
        """As in StepPart."""
        following = self.acting.following
        if following is None or not following.rims or self.acting.guided_by != "law":
            return None
        return -self.half * self._by_edges()

    @property
    def by_forces(self) -> Array:
        """∂(Sᵀ f)/∂f (k, 3P) of forces that are known; (k, 0) where there are none."""
        if self.pressed is None:
            return np.zeros((6 + len(self.ends[0].q), 0))
        return self.pressed[0].by_forces()

    def touch(self) -> Touch | None:
        """As in StepPart."""
        touched, step, residual, (start, end) = self.touched, self.step, self.residual, self.ends
        if touched is None:
            return None
        points = PointsMoved(step, touched.rows, touched.places, touched.inside)
        P, turned, (start_ω, mean_ω) = len(touched.places), step.turn.middle, (touched.start_spin, step.spin)
        mean = points.joined(points.velocity(mean_ω, touched.inside), (start.v + end.v) / 2, is_mean=True)
        kept = points.joined(points.velocity(start_ω, touched.start), start.v, is_mean=False)
        moving = [mean, kept]
        if touched.contact.found.rows is not None:  # of a body that touches itself
            moving.append(points.middle())
        push, seen = points.push(touched.forces), points.seen(touched.forces)
        pushed, by_forces, motions = push.slopes, push.by_forces, [each.slopes for each in moving]
        by_yielding = [np.zeros((3 * P, 3 * P))] * len(moving)
        if residual is not None:
            C = residual.delassus
            through = push.by_mean @ C
            pushed, by_forces = _also(pushed, through, seen), by_forces + of_world(through, turned)
            for number, each in enumerate(moving):
                through = (each.by_mean @ C.reshape(P, 3, -1)).reshape(3 * P, -1)
                motions[number] = _also(motions[number], through, seen)
                by_yielding[number] = of_world(through, turned)
        return Touch(
            touched.contact,
            residual,
            turned,
            step.turn.start,
            points.displacement(),
            by_forces,
            tuple(motions),
            tuple(by_yielding),
            tuple((each.by_place, each.by_mean, each.by_start) for each in moving),
            pushed,
            (push.by_place, push.by_mean),
            seen,
        )


def _also(slopes: Slopes, through: Array, seen: Slopes) -> Slopes:
    """Slopes with those by way of forces as the frame sees them."""
    return slopes._replace(place=slopes.place + through @ seen.place, x=slopes.x + through @ seen.x)
