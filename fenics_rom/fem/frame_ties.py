"""Springs and dashpots between the ground and a full-order body whose frame moves, by the places of all its nodes.

    f = -S d - T ŝ,    T = h/2 S + D,    d = x - x0 at the start of a step,    ŝ = v̂ + J y + R⁺ r̂,    J = (R⁺ - R)/h

at a = (R y + R⁺ y⁺)/2 from the origin, y = X + q, are those of `runtime/steppers/ground_ties.py`, without sums. Every
rank has all nodes of them.
"""

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse
from numpy import ndarray as Array

from fenics_rom.fem.nodal_motion import Motion
from fenics_rom.mechanics.frame_geometry import Geometry, Push
from fenics_rom.mechanics.frame_motion import cross_matrix
from fenics_rom.system.system import System

AXES = np.identity(3)


class NodalTies:
    """Of a body.

    Attributes:
        springs: S (N, N), N/m.
        total: Σ S (1,), N/m.
    """

    def __init__(self, system: System):
        frame, algebra = system.moving_frame, system.algebra
        assert frame is not None
        N, rows = len(system.body.nodes), algebra.rows()
        nothing = scipy.sparse.csr_matrix((N, N))
        self.springs = nothing if frame.springs is None else frame.springs
        self._dashpots = nothing if frame.dashpots is None else frame.dashpots
        self._arms, self._origin, self._algebra = system.body.nodes - frame.origin, frame.origin, algebra
        self._unknowns, self._here = system.body.unknowns, slice(rows.start // 3, rows.stop // 3)
        assert self._unknowns.node_shares is not None
        self._shares = self._unknowns.node_shares.T.tocsr()[self._here]
        self.total = float(self.springs.sum())
        self._known: tuple[float, Any] | None = None

    def resistance(self, h: float) -> scipy.sparse.csr_matrix:
        """T (N, N) of a step of h s."""
        if self._known is None or self._known[0] != h:
            self._known = h, (h / 2 * self.springs + self._dashpots).tocsr()
        resistance: scipy.sparse.csr_matrix = self._known[1]
        return resistance

    def of_all(self, field: Array) -> Array:
        """A field of the nodes here (n, 3) as one of all nodes (N, 3), 0 where a base holds them."""
        return self._unknowns.expand(self._algebra.gather(np.ascontiguousarray(field.reshape(-1, 1)))).reshape(-1, 3)

    def of_here(self, field: Array) -> Array:
        """What forces on all nodes (N, any) put on those here, (n, any)."""
        here: Array = self._shares @ field
        return here

    def places(self, motion: Motion) -> Array:
        """y (N, 3) in the frame, m."""
        places: Array = self._arms + self.of_all(motion.q)
        return places

    def pull(self, motion: Motion) -> tuple[Array, float]:
        """S d (N, 3), N, and what is stored, J."""
        d = motion.position - self._origin + self.places(motion) @ motion.R.T - self._arms
        pull = self.springs @ d
        return pull, float((d * pull).sum()) / 2

    def heat(self, rates: Array) -> float:
        """Of dashpots at velocities of all nodes (N, 3), W."""
        return float((rates * (self._dashpots @ rates)).sum())


class TieForces(NamedTuple):
    """What ties do at velocities of a step."""

    forces: Array  # f (N, 3), N, in world axes
    rates: Array  # ŝ (N, 3), m/s
    arms: Array  # a (N, 3), m
    velocity: Array  # v̂ (3,), m/s
    push: Push

    @property
    def power(self) -> float:
        """Of the forces, W."""
        return float((self.forces * self.rates).sum())


class TiedStep:
    """A step of h s from a motion.

    Args:
        ties: of the body.
        now: from where.
        h: s.
        mass: of a free body, kg.
    """

    def __init__(self, ties: NodalTies, now: Motion, h: float, mass: float):
        self._ties, self._now, self._h, self._mass, self._T = ties, now, h, mass, ties.resistance(h)
        self._places, (self._pull, self.stored) = ties.places(now), ties.pull(now)
        self._weights = np.asarray(self._T.sum(axis=1)).ravel()
        self.compliance = 1 / (2 / h * mass + self._weights.sum())  # v̂ per force of a free body, m/s/N

    @property
    def speed(self) -> float:
        """Of what the pull of springs would do in the step, as √(2 J)."""
        return float(np.sqrt(self._mass * abs(2 * self.stored * self._ties.total)) * self.compliance)

    def of_free(self, turn: Geometry, ω̂: Array, r̂: Array, force: Array) -> TieForces:
        """At velocities ω̂ and r̂ (n, 3) of a body that other forces (3,) act on, N in world axes."""
        now = self._now
        inside = self._inside((now.R + turn.end) / 2 @ cross_matrix(ω̂), turn, r̂)
        pushed = 2 / self._h * self._mass * (now.R @ now.v) + force
        pushed = pushed - self._pull.sum(axis=0) - self._weights @ inside
        return self._at(turn, r̂, inside, self.compliance * pushed)

    def of_carried(self, turn: Geometry, r̂: Array, position: Array) -> TieForces:
        """At velocities r̂ (n, 3) of a body whose base goes to a position."""
        now = self._now
        return self._at(
            turn, r̂, self._inside((turn.end - now.R) / self._h, turn, r̂), (position - now.position) / self._h
        )

    def _inside(self, J: Array, turn: Geometry, r̂: Array) -> Array:
        inside: Array = self._places @ J.T + self._ties.of_all(r̂) @ turn.end.T
        return inside

    def _at(self, turn: Geometry, r̂: Array, inside: Array, velocity: Array) -> TieForces:
        rates = inside + velocity
        forces = -self._pull - self._T @ rates
        ends = self._places + self._h * self._ties.of_all(r̂)
        arms = (self._places @ self._now.R.T + ends @ turn.end.T) / 2
        push = Push.of(forces, turn, arms, self._ties.of_here)
        return TieForces(forces, rates, arms, velocity, push)

    def coupled(
        self, tied: TieForces, turn: Geometry, r̂: Array, inertial: tuple[Array, Array, Array]
    ) -> tuple[Array, Array, Array]:
        """What balances of force (world axes), of turning and of displacements lack by v̂, ω̂ and r̂.

        Args:
            tied: at the velocities.
            turn: of these.
            r̂: (n, 3).
            inertial: J, B and C of `frame_coupling` by inertia, of ω̂ alone.

        Returns:
            J (6, 6) of (v̂, ω̂), B (rows here, 6) of r̂ in the first six balances, C (rows here, 6) of the six in those
            of the displacements.
        """
        R, R_end, middle, h, T = self._now.R, turn.end, turn.middle, self._h, self._T
        mean, f, a = (R + R_end) / 2, tied.forces, tied.arms
        ends = self._places + h * self._ties.of_all(r̂)
        J, B, C = np.zeros((6, 6)), np.empty((6, len(r̂), 3)), np.empty((6, len(r̂), 3))
        J[:3, :3] = np.identity(3) / self.compliance
        for k, e in enumerate(AXES):
            by_v = -np.outer(self._weights, e)
            J[3:, k], C[k] = -np.cross(a, by_v).sum(axis=0) @ middle, -self._ties.of_here(by_v @ middle)
            spun, tilted = mean @ cross_matrix(e) @ R.T @ mean, h / 2 * R @ cross_matrix(e)
            moved = ends @ spun.T
            by_ω = -(T @ moved)
            torque = (np.cross(a, by_ω) + h / 2 * np.cross(moved, f)).sum(axis=0) @ middle
            torque = torque + np.array(tied.push.torque) @ tilted
            J[:3, 3 + k] = -by_ω.sum(axis=0)
            J[3:, 3 + k], C[3 + k] = -torque, -self._ties.of_here(by_ω @ middle + f @ tilted)
            axis = middle @ e  # of the torque as the frame sees it
            by_r = (h / 2 * np.cross(f, axis) - T @ np.cross(axis, a)) @ R_end
            B[k], B[3 + k] = -self._ties.of_here(by_v @ R_end), -self._ties.of_here(by_r)
        J[3:, 3:] += inertial[0]
        B[3:] += inertial[1].T.reshape(3, -1, 3)
        C[3:] += inertial[2].T.reshape(3, -1, 3)
        return J, B.reshape(6, -1).T, C.reshape(6, -1).T
