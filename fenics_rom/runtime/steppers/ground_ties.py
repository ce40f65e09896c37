"""Springs and dashpots between a body whose frame moves and the ground, at no cost per node.

They pull with f = -S d̂ - D ŝ at the true places of all nodes: d̂ the mean of x - x0 at both ends of a step, x0 where a
node is at rest, and ŝ = Δx/h. As x moves by h ŝ exactly, Δ(½ dᵀS d) = -h (f + D ŝ)·ŝ: the account closes at any h.

What nodes do is a matrix (3, 4 + 3m) times the fields φ = [1, X, V_x, V_y, V_z] of a node, V of a contact mode:

    x - x0 = [u, R - 1, R ⊗ q] φ,    u = p - p0
    ŝ = [v̂, J, J ⊗ q + R⁺ ⊗ r̂] φ,    J = (R⁺ - R)/h,        a = [0, (R + R⁺)/2, (R ⊗ q + R⁺ ⊗ q⁺)/2] φ

v̂ the mid-step velocity of the origin and a the arms from it. So with the sums Σ S_ij φ_i φ_jᵀ of `rom.moving_frame`

    P = Σ f φᵀ = -[u, R - 1, R ⊗ q] S - ŝ T,    T = h/2 S + D

has all that is asked for: the force (its first column), the torque Σ a × f, and on the coordinates Σ R*_ia P_i,V_a. All
depends on v̂, too. Of a free body mass 2/h (v̂ - v) is the sum of all forces, so v̂ is eliminated, exactly:

    (2/h mass + T_11) v̂ = 2/h mass v + (other forces) + (P without v̂)_1
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.frame_geometry import Geometry, Push, vector
from fenics_rom.mechanics.frame_motion import Rotation, Vector, cross_matrix
from fenics_rom.rom.moving_frame import MovingFrame
from fenics_rom.runtime.steppers.frame_slopes import Moving, StepTurn
from fenics_rom.runtime.steppers.slopes import Slopes

SAME_TURN = 1e-14  # of entries of R*ᵀ R⁺: round-off
AXES = np.stack([cross_matrix(axis) for axis in np.eye(3)])  # e_k~


class Placed(NamedTuple):
    """The ties between two steps."""

    R: Array  # (3, 3)
    position: Array  # (3,) of the frame's origin, m
    q: Array  # (m,)
    pull: Array  # [u, R - 1, R ⊗ q] S
    stored: float  # J


class TieForces(NamedTuple):
    """What ties do in a step from a place."""

    start: Placed
    turn: Geometry
    h: float  # s
    forces: Array  # P (3, 4 + 3m)
    motion: Array  # [v̂, J, R⁺] (3, 7)
    rate: Array  # r̂ (m,)

    def push(self) -> Push:
        """What the forces do to the body."""
        turn, P, start = self.turn, self.forces, self.start
        modes = P[:, 4:].reshape(9, -1)
        by_place = P[:, 1:4] + modes.dot(start.q).reshape(3, 3)  # Σ f y
        products = (start.R + turn.end).dot(by_place.T) + turn.end.dot(modes.dot(self.h * self.rate).reshape(3, 3).T)
        (_, xy, xz), (yx, _, yz), (zx, zy, _) = products.tolist()
        torque = (yz - zy) / 2, (zx - xz) / 2, (xy - yx) / 2
        return Push(vector(P[:, 0]), torque, turn.seen(torque), turn.middle.ravel().dot(modes))

    @property
    def velocity(self) -> Array:
        """v̂ (3,)."""
        return self.motion[:, 0]

    @property
    def rates(self) -> Array:
        """Of ŝ (3, 4 + 3m)."""
        J = self.motion[:, 1:4]
        rates = _fields(self.velocity, J, J, self.start.q)
        rates[:, 4:] += _modes(self.turn.end, self.rate)
        return rates

    @property
    def power(self) -> float:
        """Of the forces, W."""
        return float(self.forces.ravel().dot(self.rates.ravel()))


class GroundTies:
    """Of one contact mode.

    Args:
        frame: its moving frame, which has springs or dashpots.

    Attributes:
        placed: where the body is.
        resistance: T (4 + 3m, 4 + 3m) of the time step.
    """

    def __init__(self, frame: MovingFrame):
        nothing, m = np.zeros((4 + 3 * frame.order,) * 2), frame.order
        self._springs = nothing if frame.springs is None else frame.springs
        self._dashpots = nothing if frame.dashpots is None else frame.dashpots
        self._origin, self.resistance, self._springs_by_mode = frame.origin, nothing, _by_mode(self._springs)
        self.placed = self._before = Placed(np.eye(3), frame.origin, np.zeros(m), nothing[:3], 0.0)
        self._rows = np.zeros((7, 4 + 3 * m))  # T of 1, of y and of V r̂
        self._added: tuple[Array, tuple[Array, Array]] | None = None
        self._h = 0.0

    def set_time_step(self, h: float) -> None:
        """Of a step of h s."""
        m = len(self.placed.q)
        self._h, self._added = h, None
        self.resistance = T = h / 2 * self._springs + self._dashpots
        self._resistance_by_mode, self._rows[0] = _by_mode(T), T[0]
        self._by_modes = T[4:, 4:].reshape(3, m, 3, m).transpose(0, 2, 1, 3).reshape(9, m * m)
        self._begin()

    @property
    def within(self) -> Array:
        """VᵀK_s V (m, m) of the springs on the coordinates, 1/s²."""
        m = len(self.placed.q)
        within: Array = np.einsum("aiaj->ij", self._springs[4:, 4:].reshape(3, m, 3, m))
        return within

    def place(self, position: Vector, R: Rotation, q: Array) -> None:
        """Puts the body somewhere, with q (m,)."""
        turned, there, S = np.array(R), np.array(position), self._springs
        pull = np.multiply.outer(there - self._origin, S[0]) - S[1:4]
        pull += turned.dot(S[1:4] + q.dot(self._springs_by_mode).reshape(3, -1))
        modes = pull[:, 4:].reshape(9, -1).dot(q)
        stored = (there - self._origin).dot(pull[:, 0]) + turned.ravel().dot(pull[:, 1:4].ravel() + modes)
        self._before = self.placed
        self.placed = Placed(turned, there, q.copy(), pull, float(stored - pull[:, 1:4].trace()) / 2)
        self._begin()

    def _begin(self) -> None:
        """What does not change in a step from here."""
        if self._h:
            moved = self.placed.q.dot(self._resistance_by_mode).reshape(3, -1)
            np.add(self.resistance[1:4], moved, self._rows[1:4])

    def rollback(self) -> None:
        """Puts it where it was before."""
        self.placed = self._before
        self._begin()

    def dissipated(self, tied: TieForces) -> float:
        """By dashpots in a step, J."""
        rates = tied.rates
        return self._h * float(rates.dot(self._dashpots).ravel().dot(rates.ravel()))

    def _under(self, turn: Geometry, motion: Array, r̂: Array) -> TieForces:
        """What ties do in a step that moves so, at the r̂ that the rows are of."""
        return TieForces(self.placed, turn, self._h, -motion.dot(self._rows) - self.placed.pull, motion, r̂)

    # Of a free body, whose other forces are given and whose v̂ follows.

    def compliance(self, mass: float) -> float:
        """v̂ per force, m/s/N."""
        return float(1 / (2 / self._h * mass + self.resistance[0, 0]))

    def of_free(self, turn: Geometry, x: Array, mass: float, start: Vector, force: Vector) -> TieForces:
        """What ties do at velocities x near those of the turn, from v̂ at the start, m/s, and all other forces, N."""
        motion = np.empty((3, 7))
        motion[:, 1:4] = ((self.placed.R + turn.end) / 2).dot(cross_matrix(x[:3]))  # without what (R⁺ - R)/h cancels
        motion[:, 4:] = turn.end
        self._rows[4:] = x[3:].dot(self._resistance_by_mode).reshape(3, -1)
        pulled = self.placed.pull[:, 0] + motion[:, 1:].dot(self._rows[1:, 0])
        motion[:, 0] = self.compliance(mass) * (2 / self._h * mass * np.array(start) + force - pulled)
        return self._under(turn, motion, x[3:])

    def speed(self, mass: float) -> float:
        """Of what the pull of springs would do in a step, as √(2 J): corrections are small beside it, or round-off."""
        pull = (2 * abs(self.placed.stored) * self._springs[0, 0]) ** 0.5
        return float(mass**0.5 * self.compliance(mass) * pull)

    # Of a body that a base carries, where all but r̂ is given.

    def of_carried(self, A: Array, right: Array, turn: Geometry, position: Vector) -> tuple[Array, Array, TieForces]:
        """A r̂ = right with ties, in a step to a position of the frame's origin; and what they do without r̂."""
        placed, motion, nothing = self.placed, np.empty((3, 7)), np.zeros_like(self.placed.q)
        motion[:, 0] = (np.array(position) - placed.position) / self._h
        motion[:, 1:4], motion[:, 4:] = (turn.end - placed.R) / self._h, turn.end
        self._rows[4:] = 0.0
        tied = self._under(turn, motion, nothing)
        modal = turn.middle.ravel().dot(tied.forces[:, 4:].reshape(9, -1))
        return self._resisting(A, turn), right + modal, tied

    def _resisting(self, A: Array, turn: Geometry) -> Array:
        """A with what ties add to it; the same array as long as both are the same."""
        across = turn.middle.T.dot(turn.end)
        expected = np.eye(3) + cross_matrix(turn.turn) / 2  # of a base whose poses fit its twist
        if np.abs(across - expected).max() < SAME_TURN:
            across = expected
        if self._added is not None and self._added[0] is A and np.array_equal(self._added[1][0], across):
            return self._added[1][1]
        by_rate = across.ravel().dot(self._by_modes).reshape((len(self.placed.q),) * 2)
        total: Array = (np.diag(A) if A.ndim == 1 else A) + by_rate
        self._added = A, (across, total)
        return total

    def with_rate(self, tied: TieForces, r̂: Array) -> TieForces:
        """What ties do with the r̂ that was found."""
        moved = r̂.dot(self._resistance_by_mode).reshape(3, -1)
        return tied._replace(forces=tied.forces - tied.turn.end.dot(moved), rate=r̂)

    # Of either, to go back through a step.

    def push_slopes(self, before: Moving, after: Moving, step: StepTurn) -> Slopes:
        """Slopes of force, R*ᵀ torque and modal forces (k,)."""
        turn, k = step.turn, 6 + len(before.q)
        ends = ((turn.start, before, -1.0), (turn.end, after, 1.0))
        resisting = [self._springs / 2 + sign / step.h * self._dashpots for _, _, sign in ends]
        places = [_fields(at.position - self._origin, R, R, at.q) for R, at, _ in ends]
        for place in places:
            place[:, 1:4] -= np.eye(3)
        (start, end), (resists_start, resists_end) = places, resisting
        P = -start.dot(resists_start) - end.dot(resists_end)
        arms = np.mean([_fields(np.zeros(3), R, R, at.q) for R, at, _ in ends], axis=0)
        there = turn.start.T.dot(_axis(arms.dot(P.T)))
        found = []
        for (R, at, _), resists in zip(ends, resisting, strict=True):
            moved = _tangents(R, at.q)
            by_place = -moved @ resists  # ∂P (k, 3, 4 + 3m)
            moved[:3] = 0.0
            products = np.matmul(arms, by_place.transpose(0, 2, 1)) + moved @ P.T / 2
            turning = _axis(products.transpose(1, 2, 0)).T @ turn.middle
            modal = np.einsum("x,nxm->nm", turn.middle.ravel(), by_place[:, :, 4:].reshape(k, 9, -1))
            found.append(np.hstack([by_place[:, :, 0], turning, modal]).T)
        by_turn, back, modes = np.zeros((k, 3)), np.eye(3) - step.half, P[:, 4:].reshape(3, 3, -1)
        by_turn[3:6], seen = cross_matrix(there) / 2, np.einsum("ij,iam->jam", turn.start, modes)
        by_turn[6:] = np.einsum("kja,jam->mk", AXES, seen) / 2
        found[0][3:6, 3:6] += back @ cross_matrix(there)
        found[0][6:, 3:6] += np.einsum("kab,bc,acm->mk", AXES, np.eye(3) + step.half, seen)
        return step.slopes(found[0], found[1], by_turn)

    def stored_slopes(self, at: Moving, R: Array) -> Array:
        """Slopes of what is stored with the place, (k,)."""
        pull = _fields(at.position - self._origin, R, R, at.q)
        pull[:, 1:4] -= np.eye(3)
        slopes: Array = np.tensordot(_tangents(R, at.q), pull.dot(self._springs), 2)
        return slopes


def _tangents(R: Array, q: Array) -> Array:
    """How [p, R, R ⊗ q] changes with the place, (k, 3, 4 + 3m)."""
    m = len(q)
    tangents = np.zeros((6 + m, 3, 4 + 3 * m))
    tangents[:3, :, 0] = np.eye(3)
    turned = R @ AXES
    tangents[3:6, :, 1:4] = turned
    tangents[3:6, :, 4:] = (turned[..., None] * q).reshape(3, 3, -1)
    tangents[6:, :, 4:] = np.einsum("ia,mn->mian", R, np.eye(m)).reshape(m, 3, -1)
    return tangents


def _fields(first: Array, along: Array, turned: Array, q: Array) -> Array:
    """[a, B, C ⊗ q] (3, 4 + 3m)."""
    return np.hstack([first[:, None], along, _modes(turned, q)])


def _modes(C: Array, q: Array) -> Array:
    """C ⊗ q (3, 3m) of C (3, 3): C_ia q_n."""
    modes: Array = (C[:, :, None] * q).reshape(3, -1)
    return modes


def _by_mode(sums: Array) -> Array:
    """Of sums (4 + 3m, 4 + 3m) those over x, y and z of a vector V_n, (m, 3 (4 + 3m))."""
    m = (len(sums) - 4) // 3
    return np.ascontiguousarray(sums[4:].reshape(3, m, -1).transpose(1, 0, 2).reshape(m, -1))


def _axis(products: Array) -> Array:
    """Σ a × f (3, ...) of Σ a_i f_j (3, 3, ...)."""
    return np.stack([products[1, 2] - products[2, 1], products[2, 0] - products[0, 2], products[0, 1] - products[1, 0]])
