"""Back through a step of a body in a moving frame, put together from the slopes of its parts as the step is.

Its velocities x fulfil ρ(x, place, velocities at the start, u) = Sᵀ f, however they were found, and contact forces f
their law, of what the points do: ŝ in the middle of the step, κ with the velocities of the start, and d, where they
are. So with K = ∂(ρ - Sᵀ f)/∂x and B = ∂(Sᵀ f)/∂f

    K δx = B δf - (∂ρ),    δŝ = U δx + .. = (U K⁻¹ B + ..) δf + ..,    δκ likewise,

in which the law is linearised (mechanics/contact_adjoint.py). What J owes to x goes to the rest by Kᵀ. Of a body that a
base carries v̂ and ω̂ are given, and their rows and columns are left out. ∂J/∂x is written x_.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.contact_adjoint import ContactAdjoint
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.runtime.steppers.adjoint import NONE, Reads, StateAdjoint, StepSlopes
from fenics_rom.runtime.steppers.elastic.law import LawAdjoint
from fenics_rom.runtime.steppers.frame_loads import FrameForces, FrameLoads
from fenics_rom.runtime.steppers.frame_slopes import InertiaSlopes, Moving, PointsMoved, Slopes, StepTurn
from fenics_rom.runtime.steppers.ground_ties import GroundTies
from fenics_rom.runtime.steppers.residual_motion import ResidualMaps, strained_back


class FrameParts(NamedTuple):
    """What a body in a frame is made of, but for what resists its shape."""

    model: ContactModel
    inertia: InertiaSlopes
    loads: FrameLoads
    ties: GroundTies | None
    residual: ResidualMaps | None

    @property
    def own(self) -> slice:
        """Which of the velocities x a step solves for."""
        return slice(6 if self.inertia.frame.carried else 0, None)


class TouchedPoints(NamedTuple):
    """The contact points in a step, in the frame, and what touched them."""

    rows: Array  # Vᵀ (m, 3P)
    places: Array  # y at the start (P, 3)
    inside: Array  # û (P, 3)
    start: Array  # V r and what they yield at the start (P, 3)
    start_spin: Array  # ω then (3,)
    forces: Array  # of contact (P, 3), in world axes
    contact: ContactAdjoint


class FrameAdjoint(NamedTuple):
    """A step of a FrameKernel. Carried: what the law carries, and the residual's rows [g, y, ġ, ẏ] (4, 3P)."""

    parts: FrameParts
    step: StepTurn
    ends: tuple[Moving, Moving]
    forces: FrameForces
    law: LawAdjoint
    residual_after: Array | None
    touched: TouchedPoints | None
    is_kink: bool

    def pull_back(self, after: StateAdjoint, reads: Reads) -> StepSlopes:
        """As in StepAdjoint."""
        parts, step, (start, end), energy = self.parts, self.step, self.ends, reads.energy
        ω, own, m = np.sqrt(parts.model.eigenvalues), parts.own, len(start.q)
        by_e, by_r = after.state.reshape(2, -1)
        place_, velocity_ = np.zeros((2, 6 + m))
        place_[6:], velocity_[6:] = ω * by_e + reads.q, by_r
        if len(after.frame):
            place_[:6] = after.frame[:6] + reads.place
            velocity_[:6] = after.frame[6:]
        if energy:
            stored = parts.inertia.stored(end)
            place_, velocity_ = place_ + energy * stored[0], velocity_ + energy * stored[1]
            if parts.ties is not None:
                place_ += energy * parts.ties.stored_slopes(end, step.turn.end)
        own_, rows_ = np.split(after.auxiliary, [len(after.auxiliary) - self.rows])
        rows_, seen_ = self._through_residual(rows_, reads)
        owed = self.law.after(own_, energy)
        place_[6:] += owed.end
        place_, velocity_, x_ = step.back(place_, velocity_)
        place_[6:], x_[6:] = place_[6:] + owed.start, x_[6:] + owed.velocity

        balance, by_input = self._balance()
        touch = None if self.touched is None else _Touch.of(self.touched, step, parts.residual)
        if touch is not None:
            balance = balance.with_(touch.push, -1.0)
        K, y = balance.x[own, own], np.zeros(6 + m)
        if touch is not None:
            touch_ = touch.pull_back(K, own, x_, seen_)
            place_, velocity_, x_ = place_ + touch_[0], velocity_ + touch_[1], x_ + touch_[2]
            rows_ = rows_ + touch_[3] if rows_.size else rows_
        y[own] = np.linalg.solve(K.T, x_[own])
        place_, velocity_ = place_ - y @ balance.place, velocity_ - y @ balance.velocity
        if touch is not None and rows_.size:
            rows_ = rows_ + touch.rows_of_push(y)
        own_, of_shape = self.law.before(y[6:], owed)
        place_[6:] += of_shape
        along_ω, damping = self.law.by_model(y[6:], owed)
        if len(along_ω):
            along_ω = along_ω + by_e * end.q - place_[6:] * start.q / ω
        before = StateAdjoint(
            np.concatenate([place_[6:] / ω, velocity_[6:]]),
            after.rigid,
            np.concatenate([own_, rows_.ravel()]),
            frame=np.concatenate([place_[:6], velocity_[:6]]) if len(after.frame) else NONE,
        )
        return StepSlopes(before, y @ by_input, along_ω, damping)

    def _balance(self) -> tuple[Slopes, Array]:
        """Slopes of ρ but for contact (k,), and ∂(forces)/∂u (k, p)."""
        parts, step, (start, end) = self.parts, self.step, self.ends
        balance = parts.inertia.balance(start, end, step)
        loads, by_input = parts.loads.slopes(self.forces, step, parts.inertia.frame, (start.q, end.q))
        balance = balance.with_(loads, -1.0)
        if parts.ties is not None:
            balance = balance.with_(parts.ties.push_slopes(start, end, step), -1.0)
        balance.x[6:, 6:] += self.law.by_velocity
        balance.place[6:, 6:] += self.law.by_shape
        return balance, by_input

    @property
    def rows(self) -> int:
        """How many numbers of the residual part are carried along, the last ones of all."""
        return 0 if self.residual_after is None else self.residual_after.size

    def _through_residual(self, rows_: Array, reads: Reads) -> tuple[Array, Array]:
        """Derivatives with the residual's rows before, (4, 3P), and with forces as the frame sees them, (3P,)."""
        residual = self.parts.residual
        if residual is None or self.residual_after is None:
            return np.empty((4, 0)), NONE
        rows_ = rows_.reshape(4, -1) + reads.energy * residual.of_energy(self.residual_after)
        rows_[0] += strained_back(residual.part, reads.beyond)
        return residual.pull_back(rows_)


class _Touch(NamedTuple):
    """What contact points do in a step, and forces on them, with slopes through what the points yield."""

    touched: TouchedPoints
    residual: ResidualMaps | None
    turned: Array  # R* (3, 3)
    start: Array  # R
    place: Array  # of d (3P, k)
    push: Slopes  # of Sᵀ f where f stays
    by_forces: Array  # B (k, 3P)
    push_rows: tuple[Array, Array]  # of Sᵀ f with y and û, (k, 3P)
    seen: Slopes  # of R*ᵀ f
    motions: tuple[Slopes, Slopes]  # of ŝ and of κ, (3P, k)
    by_yielding: tuple[Array, Array]  # of these with f (3P, 3P)
    blocks: tuple[tuple[Array, Array, Array], ...]  # of these with y, û and u at the start, (P, 3, 3)

    @staticmethod
    def of(touched: TouchedPoints, step: StepTurn, residual: ResidualMaps | None) -> "_Touch":
        points = PointsMoved(step, touched.rows, touched.places, touched.inside)
        P, turned, (start_ω, mean_ω) = len(touched.places), step.turn.middle, (touched.start_spin, step.spin)
        mean = points.joined(points.velocity(mean_ω, touched.inside), is_mean=True)
        kept = points.joined(points.velocity(start_ω, touched.start), is_mean=False)
        push, seen = points.push(touched.forces), points.seen(touched.forces)
        pushed, by_forces, motions = push.slopes, push.by_forces, [mean.slopes, kept.slopes]
        by_yielding = [np.zeros((3 * P, 3 * P))] * 2
        if residual is not None:
            C = residual.delassus
            through = push.by_mean @ C
            pushed, by_forces = _also(pushed, through, seen), by_forces + _of_world(through, turned)
            for number, by_û in enumerate((mean.by_mean, kept.by_mean)):
                through = (by_û @ C.reshape(P, 3, -1)).reshape(3 * P, -1)
                motions[number] = _also(motions[number], through, seen)
                by_yielding[number] = _of_world(through, turned)
        return _Touch(
            touched,
            residual,
            turned,
            step.turn.start,
            points.displacement(),
            pushed,
            by_forces,
            (push.by_place, push.by_mean),
            seen,
            (motions[0], motions[1]),
            (by_yielding[0], by_yielding[1]),
            tuple((each.by_place, each.by_mean, each.by_start) for each in (mean, kept)),
        )

    def pull_back(self, K: Array, own: slice, x_: Array, seen_: Array) -> tuple[Array, Array, Array, Array]:
        """What is owed to the place, to velocities at the start and to x, (k,), and to the residual's rows (4, 3P).

        From what is owed to x, and to the forces as the frame sees them (3P,).
        """
        (mean, kept), P = self.motions, len(self.touched.places)
        further_x, place_ = np.zeros(len(x_)), np.zeros(len(x_))
        φ = np.zeros(3 * P)
        if len(seen_):
            further_x, place_ = seen_ @ self.seen.x, seen_ @ self.seen.place
            φ = seen_.reshape(-1, 3).dot(self.turned.T).ravel()
        spread = np.linalg.solve(K, self.by_forces[own])
        W, by_start = (
            motion.x[:, own] @ spread + by_force
            for motion, by_force in zip(self.motions, self.by_yielding, strict=True)
        )
        φ = φ + (x_ + further_x)[own] @ spread
        moved = self.touched.contact.through(W, by_start).pull_back(φ.reshape(-1, 3))
        d_, κ_, s_ = (part.ravel() for part in moved)
        further_x = further_x + s_ @ mean.x + κ_ @ kept.x
        place_ = place_ + d_ @ self.place + s_ @ mean.place + κ_ @ kept.place
        rows_ = np.zeros((4, 3 * P))
        if self.residual is not None:
            (of_y, of_û, _), (kept_y, kept_û, kept_u) = self.blocks
            rows_ = np.multiply.outer(self.residual.step[5, :4], _back(of_û, s_) + _back(kept_û, κ_))
            rows_[1] += d_.reshape(-1, 3).dot(self.start).ravel() + _back(of_y, s_) + _back(kept_y, κ_)
            rows_[3] += _back(kept_u, κ_)
        return place_, s_ @ mean.velocity + κ_ @ kept.velocity, further_x, rows_

    def rows_of_push(self, y: Array) -> Array:
        """What the residual's rows (4, 3P) are owed by what forces do, from what that is owed (k,)."""
        assert self.residual is not None
        by_place, by_mean = self.push_rows
        rows_ = np.multiply.outer(self.residual.step[5, :4], y @ by_mean)
        rows_[1] += y @ by_place
        return rows_


def _also(slopes: Slopes, through: Array, seen: Slopes) -> Slopes:
    """Slopes with those by way of forces as the frame sees them."""
    return Slopes(slopes.place + through @ seen.place, slopes.velocity, slopes.x + through @ seen.x)


def _of_world(operator: Array, turned: Array) -> Array:
    """An operator (n, 3P) on forces as the frame sees them, R*ᵀ f, on those in world axes."""
    whole: Array = operator.reshape(len(operator), -1, 3).dot(turned.T).reshape(operator.shape)
    return whole


def _back(blocks: Array, owed: Array) -> Array:
    """Of (P, 3, 3), transposed, (3P,)."""
    back: Array = np.einsum("pij,pi->pj", blocks, owed.reshape(-1, 3)).ravel()
    return back
