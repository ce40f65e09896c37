"""A step of a free body whose points others push: under forces that are tried, until they fit.

Under forces f on k points a step is one whose balance lacks ρ = Sᵀ f, with the S of `frame_contact`, and is found to
round-off: so are the velocities u(f) of the points. With R* = R (1 + h/2 ω̂~), n = 1 + h²|ω̂|²/4, g the forces as the
frame sees them and the residual part's compliance C, they change as

    δu = δv̂ - (R⁺y⁺)~ R* δω̂/n + R⁺ (V δr̂ + C δg),    δg = R*ᵀ δf + h/2 (Rᵀf)~ δω̂,    δv̂ = h/2m Σ δf,

as R⁺ y⁺ - R y = h (u - v̂), and Sᵀ f with its arms a, δa = h/2 (δu - δv̂), and R*ᵀ. So W = ∂u/∂f is exact, too, and not
quite symmetric where the body turns. Of two free bodies the second is pushed at the place X of the first one's point,
which goes with the frame: at the arm X - p̂, with u = v̂ + (R* ω̂) × (X - p̂) + R* û of its own point. Where springs and
dashpots tie the body to the ground v̂ depends on ω̂ and r̂, too, and forces by v̂ on them (`ground_ties`).

A couple c turns the frame, and by maps T̄ of the nodes of a surface, which stay as they are in the frame, its shape: it
does the work h c·(R* ω̂ + R* T̄ û), and momenta grow by it as they do by a torque, whatever T̄ is.

Two points a and b of the body that touch one another have the velocity R* (û_a - û_b), and forces f and -f at one
place: no momentum grows by them, whatever gap is left.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.contact import ContactSolution
from fenics_rom.mechanics.frame_contact import hold
from fenics_rom.mechanics.frame_geometry import Geometry, Push, arms_of, crossed, vector
from fenics_rom.mechanics.frame_motion import ZERO, cross_matrix, dot
from fenics_rom.mechanics.surface_points import NONE, mean_turning_maps, spread_matrix
from fenics_rom.runtime.steppers.frame_slopes import SPIN
from fenics_rom.runtime.steppers.free_frame import FreeFrame


def are_relative(weights: Array) -> Array:
    """Which points (k,), by weights (k, n) of others, stand for one relative to another: they add up to 0, not to 1."""
    relative: Array = np.abs(weights.sum(axis=1)) < 0.5
    return relative


class PushedPoints(NamedTuple):
    """Contact points of a body, or places between them, that others push: k of them."""

    nodes: Array  # (k, n) among the contact points
    weights: Array  # (k, n) of these
    follows: Array  # (k,) where it is pushed at the point of another body
    couples: Array  # (any,) which of them stand for how a surface turns
    within: Array  # (any,) which of them stand for a point relative to another one of the body
    nodes_of: Array  # (n,) all that carry them
    spread: Array  # (3 k, 3 n) of what these do
    rows: Array  # Vᵀ of the points, (m, 3 k)
    compliance: Array | None  # C (3 k, 3 k), m/s/N, in the frame's axes

    @staticmethod
    def of(body: FreeFrame, nodes: Array, weights: Array, follows: Array, couples: Array = NONE) -> "PushedPoints":
        """Those of a body in steps of its length."""
        held, compliance = zip(body.places()[nodes[couples]], weights[couples], strict=True), None
        turning = [mean_turning_maps(places - shares.dot(places), shares) for places, shares in held]
        some, spread = spread_matrix(nodes, weights, couples, turning)
        if body.residual is not None:
            compliance = spread.dot(body.residual.delassus_of(some)).dot(spread.T)
        rows = body.points.of(some).rows.dot(spread.T)
        within = are_relative(weights).nonzero()[0]
        return PushedPoints(nodes, weights, follows, couples, within, some, spread, rows, compliance)

    def on_nodes(self, forces: Array, turn: Geometry, P: int) -> Array:
        """Forces (P, 3) on contact points that are forces and couples (k, 3), all in world axes."""
        spread = np.zeros((P, 3))
        seen = forces.dot(turn.middle).ravel().dot(self.spread).reshape(-1, 3)
        spread[self.nodes_of] = np.linalg.solve(turn.middle.T, seen.T).T
        return spread

    def mean(self, values: Array) -> Array:
        """Of values (P, 3) at the contact points, (k, 3)."""
        mean: Array = (self.weights[:, :, None] * values[self.nodes]).sum(axis=1)
        return mean


class _Try(NamedTuple):
    """What forces do at velocities x."""

    turn: Geometry
    middle: Array  # p̂ (3,)
    translation: Array  # v̂ (3,)
    inside: Array  # û (k, 3) in the frame
    arms: Array  # (k, 3) from p̂
    push: Push


class PushedStep:
    """A step that a body begins under inputs u.

    Raises:
        StepError: the body would turn too far.
    """

    def __init__(self, body: FreeFrame, u: Array):
        self._body, self._x = body, body.begin_step(u)
        self._points: PushedPoints | None = None
        self._try: _Try | None = None

    def begin_at(self, points: PushedPoints) -> None:
        """The points that are pushed from now on."""
        body, self._points = self._body, points
        self._start, self._free = points.mean(body.places()), np.zeros((len(points.nodes), 3))
        if body.residual is not None:
            free = body.residual.points[2][points.nodes_of]
            self._free = points.spread.dot(free.ravel()).reshape(-1, 3)

    def velocities(self, forces: Array, places: Array) -> Array:
        """Mid-step velocities (k, 3) under forces (k, 3), N, in world axes.

        Args:
            forces: on the points.
            places: (k, 3), m, where they act; those of points of its own are written.

        Raises:
            StepError: no step was found.
        """
        body, self._forces, self._places = self._body, forces, places
        push_at = self._push_at if len(forces) else None
        body.iterate(self._x, push_at, float(np.abs(forces).sum()))
        if body.found is not None:
            self._x = hold(body, self._x, body, body.reactions_found, push_at)
        if not len(forces):
            return forces
        assert self._points is not None
        self._try = now = self._tried(self._x)
        own = ~self._points.follows
        places[own] = (now.middle + now.arms)[own]
        return self._velocities(now)

    def _velocities(self, now: _Try) -> Array:
        assert self._points is not None
        spin, inside = now.turn.middle.dot(self._x[:3]), now.inside.dot(now.turn.middle.T)
        velocities: Array = now.arms.dot(cross_matrix(spin).T) + inside + now.translation
        velocities[self._points.couples] = spin + inside[self._points.couples]
        velocities[self._points.within] = inside[self._points.within]
        return velocities

    def _push_at(self, x: Array) -> Push:
        return self._tried(x).push

    def _tried(self, x: Array) -> _Try:
        body, points, f, h = self._body, self._points, self._forces, self._body.h
        assert points is not None
        turn = body.geometry(x)
        seen = f.dot(turn.middle)
        inside = x[3:].dot(points.rows).reshape(-1, 3) + self._free
        if points.compliance is not None:
            inside += points.compliance.dot(seen.ravel()).reshape(-1, 3)
        arms, alone, couple = (
            arms_of(turn, self._start, self._start + h * inside),
            f.copy(),
            f[points.couples].sum(axis=0),
        )
        alone[points.couples] = arms[points.couples] = 0.0
        alone[points.within] = arms[points.within] = 0.0
        v̂ = body.translation(turn, vector(alone.sum(axis=0)), x)
        middle = body.frame.position + h / 2 * v̂
        if points.follows.any():
            arms[points.follows] = (self._places - middle)[points.follows]
        push = Push.of(alone, turn, arms, lambda _: points.rows.dot(seen.ravel()))
        if len(points.couples):
            push = push.beside(Push(ZERO, vector(couple), vector(couple.dot(turn.middle)), 0 * push.modal))
        return _Try(turn, middle, v̂, inside, arms, push)

    def operator(self) -> Array:
        """W = ∂u/∂f at the last forces, (3 k, 3 k), in world axes."""
        now, points, x, f, body, h = self._try, self._points, self._x, self._forces, self._body, self._body.h
        assert now is not None
        assert points is not None
        R, middle, follows, k = now.turn.start, now.turn.middle, points.follows[:, None, None], len(f)
        by_turn = -h / 2 * crossed(f.dot(R)).reshape(-1, 3)  # ∂g/∂ω̂
        by_x, by_force = self._slopes_of_velocity(now, points, by_turn)
        # The torque Σ a × f, of arms that move, too: by half of what points do, or against the centre
        twists, along = h / 2 * crossed(f), np.eye(3, by_x.shape[2])
        twists[points.couples] = twists[points.within] = 0.0
        slopes, levers = body.slopes(x, now.push), np.empty((by_x.shape[2], 3 * k))
        slopes[SPIN] -= middle.T.dot(np.matmul(twists, np.where(follows, 0.0, by_x) - along).sum(axis=0))
        slopes[SPIN, SPIN] -= h / 2 * cross_matrix(np.array(now.push.torque).dot(R))
        slopes[6:, SPIN] -= points.rows.dot(by_turn)
        torque = np.matmul(np.where(follows, 0.0, twists), by_force).sum(axis=0)
        torque -= crossed(now.arms).transpose(1, 0, 2).reshape(3, -1)
        levers[:3] = np.tile(np.eye(3), k)
        levers[:3].reshape(3, k, 3)[:, points.within] = 0.0
        for couple in points.couples:
            there = slice(3 * couple, 3 * couple + 3)
            levers[:3, there] = 0.0
            torque[:, there] += np.eye(3)
        levers[SPIN], levers[6:] = middle.T.dot(torque), _of_world_forces(points.rows, middle)
        spread, by_x = body.newton.keep(slopes).dot(levers), by_x.reshape(3 * k, -1)
        if body.found is not None:
            spread[3:] -= body.held_back(x, spread[3:])
        W: Array = by_x.dot(spread) + by_force.reshape(3 * k, 3 * k)
        return W

    def _slopes_of_velocity(self, now: _Try, points: PushedPoints, by_turn: Array) -> tuple[Array, Array]:
        """∂u of each point by v̂, ω̂ and r̂, (k, 3, 6 + m), and by f where these stay, (k, 3, 3 k)."""
        turn, follows, couples, k = now.turn, points.follows[:, None, None], points.couples, len(points.nodes)
        R, middle, h = turn.start, turn.middle, self._body.h
        by_x, by_force = np.zeros((k, 3, 6 + len(points.rows))), np.zeros((k, 3, 3 * k))
        turned = R + h / 2 * np.matmul(R, crossed(now.inside))
        by_x[:, :, :3] = np.eye(3) - np.where(follows, h / 2 * cross_matrix(middle.dot(self._x[:3])), 0.0)
        own = crossed(2 * now.arms - self._start.dot(R.T)).dot(middle) / (1 + dot(turn.turn, turn.turn) / 4)
        by_x[:, :, SPIN] = np.where(follows, crossed(now.arms).dot(R) + turned - R, own)
        outward = np.where(follows, middle, turn.end)
        by_x[couples, :, :3], by_x[couples, :, SPIN], outward[couples] = 0.0, turned[couples], middle
        within = points.within
        by_x[within, :, :3], by_x[within, :, SPIN], outward[within] = 0.0, (turned - R)[within], middle
        by_x[:, :, 6:] = np.matmul(outward, points.rows.T.reshape(k, 3, -1))
        if points.compliance is not None:
            by_x[:, :, SPIN] += np.matmul(outward, points.compliance.dot(by_turn).reshape(k, 3, 3))
            by_force = np.matmul(outward, _of_world_forces(points.compliance, middle).reshape(k, 3, -1))
        return by_x, by_force

    def on_nodes(self, P: int) -> Array:
        """The forces that were tried last, on P contact points, in world axes."""
        assert self._points is not None
        assert self._try is not None
        return self._points.on_nodes(self._forces, self._try.turn, P)

    def close(self, contact: ContactSolution | None) -> float:
        """Takes the step under the forces that were tried last; `contact` has them on all contact points."""
        push, power = None, 0.0
        if contact is not None:
            assert self._try is not None
            push, power = self._try.push, float(self._forces.ravel().dot(self._velocities(self._try).ravel()))
        return self._body.end_step(self._x, contact, push, power)


def _of_world_forces(operator: Array, middle: Array) -> Array:
    """An operator (n, 3 k) on forces as the frame sees them, on those in world axes."""
    turned: Array = operator.reshape(len(operator), -1, 3).dot(middle.T).reshape(operator.shape)
    return turned
