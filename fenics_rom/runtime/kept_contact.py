"""Many steps in which all contact pairs do what they did: one affine map, and Newton's method on all steps together.

With the law of contact linearised where the last step left it, forces are f = J q + φ of the velocities q that they
have to stop (`complementarity.KeptLaw`). A step is then affine in the state x = [e, r, g, ġ], in which e holds the
displacement along rigid motions, too, and g and ġ are of the points that carry a force beyond the basis:

    x⁺ = A x + B u + C f = S x + U u + Φ φ,    q = Q x + D u,    S = A + C J Q.

Steps are taken as pairs, as pairs of pairs and so on, with S, S², S⁴, ..: by few products of matrices with matrices.
Then the law itself is asked of all steps at once: which pairs take part, and what their forces lack. That is linearised
in turn, as another φ of each step, and all states are found anew: Newton's method, whose unknowns are the forces of all
steps, as where directions of friction turn. Up to the first step that does not fulfil the law, to the tolerance of a
search, these are the steps that searches take.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.complementarity import Frames
from fenics_rom.mechanics.complementarity.frictional import SHARES
from fenics_rom.mechanics.complementarity.solution import CONVERGENCE_TOLERANCE, STAGNATION_RESIDUAL
from fenics_rom.mechanics.contact import ContactLaw
from fenics_rom.mechanics.contact_pairs import WORK_ROUND_OFF
from fenics_rom.mechanics.obstacles import Obstacle
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.midpoint_map import compliance
from fenics_rom.runtime.steppers.residual_motion import ResidualMaps

MOST_CORRECTIONS = 5  # of the forces of all steps
LEAST_REDUCTION = 0.1  # of the error of the first step that is not solved, for another correction to pay
SAME_NORMALS = 1e-13  # by which normals may turn: forces are then off by less than they may lack
FEWEST_TOGETHER = 4  # steps that are taken as pairs; fewer one by one
_TINY = 1e-300


class Meeting(NamedTuple):
    """What P points meet: one obstacle at rest, by the rigid law."""

    law: ContactLaw
    obstacle: Obstacle
    points: Array  # (P, 3) at rest, as seen from the obstacle, m
    rows: Array  # (3P, m) of the points in the contact mode


class KeptPairs(NamedTuple):
    """Which pairs take part, and what their forces follow."""

    chosen: Array  # (P,) which
    frames: Frames | None  # theirs, A of them; None where no pair does
    inverse: Array  # J (3A, 3A), N s/m


class KeptSteps(NamedTuple):
    """K steps that fulfil the law."""

    states: Array  # x (K + 1, n), from the start on
    inputs: Array  # (K, p)
    forces: Array  # f (K, 3, A) in the frames, N
    q: Array  # what they have to stop (K, 3, A), m/s
    gaps: Array  # at the start of each (K, P), m

    def first(self, count: int) -> "KeptSteps":
        """The first of them."""
        states, *others = self
        return KeptSteps(states[: count + 1], *(part[:count] for part in others))


class Works(NamedTuple):
    """Of some steps together, J."""

    supplied: float  # by inputs
    dissipated: float  # but for contact
    contact: float  # dissipated by impacts
    friction: float  # dissipated by friction


class _Look(NamedTuple):
    """What the law says of L steps."""

    is_due: Array  # (L,) whether those pairs take part that are said to, and friction does not help
    error: Array  # (L,) of the law, as a share of the velocities that forces have to stop
    gaps: Array  # (L, P), m
    q: Array  # (L, 3, A), m/s
    forces: Array  # (L, 3, A), N
    corrected: Array  # φ (L, 3A) with which it would be fulfilled, but for what is of second order, N


class KeptContactMap:
    """Steps of h s of one contact mode in which the same pairs do the same.

    Args:
        model: of the contact mode.
        h: time step, s.
        residual: how points yield beyond the basis; None where they do not.
        carried: points (c,) that carry a force beyond it, the pairs' among them.
        meeting: what they meet.
        pairs: which take part.

    Attributes:
        carried, pairs: as given.
        by_state: (m,) of the reduced displacement in e.
    """

    def __init__(
        self,
        model: ContactModel,
        h: float,
        residual: ResidualMaps | None,
        carried: Array,
        meeting: Meeting,
        pairs: KeptPairs,
    ):
        self.carried, self.pairs, self._meeting, self._h = carried, pairs, meeting, h
        self._active = pairs.chosen.nonzero()[0]
        m, p, rows, law = model.order, model.inputs.shape[1], meeting.rows, meeting.law
        of_carried, of_active = _components(carried), _components(self._active)
        among = np.flatnonzero(np.isin(of_carried, of_active))
        bounds = np.cumsum([m, m, len(of_carried), len(of_carried), p])
        n, self._parts = int(bounds[3]), bounds[:3]
        # All that follows is linear in z = [x, u, f]; these rows pick its parts.
        e, r, g, ġ, u, f = np.split(np.eye(bounds[4] + len(of_active)), bounds)
        f_carried = np.zeros_like(g)
        f_carried[among] = f
        rigid, ω = np.arange(m) < model.rigid, np.sqrt(model.eigenvalues)[:, None]
        self.by_state = np.where(rigid, 1.0, 1 / model.safe_frequencies)
        a, heat = compliance(model, h)
        right = model.inputs @ u + 2 / h * r - ω * e + rows[of_active].T @ f
        v = np.diag(a) @ right if a.ndim == 1 else a @ right
        R, ġ_mid = np.empty((len(rows), 0)), g
        if residual is not None:
            R = residual.part.compliance[:, of_carried]
            ġ_mid = residual.step[4, 0] * g + residual.step[4, 2] * ġ + residual.step[4, 4] * f_carried
        after = np.vstack([e + h * np.where(rigid[:, None], 1.0, ω) * v, 2 * v - r, g + h * ġ_mid, 2 * ġ_mid - ġ])
        displacement, velocity = (rows * self.by_state) @ e + R @ g, rows @ r + R @ ġ
        middle = rows @ v + R @ ġ_mid
        given = slice(n + p)  # x and u, without forces
        self._motion = np.vstack([displacement, velocity, middle])[:, given].T.copy()
        self._answer = middle[:, n + p :].T.copy()

        # What the law looks at, in the frames.
        self._F = F = _turn(pairs.frames, len(self._active))
        A, by_forces = len(self._active), (np.diag(heat) @ right if heat.ndim == 1 else heat @ right)
        of_pairs, targets = F @ middle[of_active], F @ velocity[of_active] / 2
        q = of_pairs[:, given].copy()
        # Pairs that stay in touch have no approach but of round-off, which is to end and not to be thrown back.
        targets[:A] *= 1 - law.restitution
        if not law.friction:
            q[A:] = targets[A:] = 0
        q -= targets[:, given]
        self._q, self._Jq, self._target = q.T.copy(), (pairs.inverse @ q).T.copy(), targets[A:, given].T.copy()
        self._W = of_pairs[:, n + p :] @ F.T
        self._by_force = self._W.diagonal().reshape(3, A).sum(axis=0) / (3 * SHARES[0])  # 1/ρ (A,)
        self._push = F @ after[:, n + p :].T
        step = after[:, given] + self._push.T @ (pairs.inverse @ q)
        self._powers, self._step_u = [step[:, :n].T.copy()], step[:, n:].T.copy()

        # What the account asks for.
        self._account = np.vstack([v, by_forces, ġ_mid]).T.copy()
        self._G, self._S, self._R, self._among = model.inputs.T, rows[of_active], R[of_carried], among
        self._heat = 0.0 if residual is None else residual.heat

    def split(self, x: Array) -> list[Array]:
        """e, r (m,), g and ġ (3c,) of a state."""
        return np.split(x, self._parts)

    def guess(self, forces: Array, q: Array) -> Array:
        """φ (1, 3A), N, that goes on with forces that were found for q, (3, A) each, N and m/s."""
        if not q.size:
            return np.empty((1, 0))
        u = self._W @ forces.ravel() + q.ravel()
        φ: Array = self._corrected(forces[None], u.reshape(1, *q.shape))[0] - self.pairs.inverse @ q.ravel()
        return φ

    def take(self, start: Array, inputs: Array, φ: Array) -> KeptSteps | None:
        """The steps from a state x (n,) that fulfil the law; None where the first does not.

        Args:
            start: x (n,).
            inputs: (L, p) of each, with the loads, L a power of two, N.
            φ: (1, 3A) or (L, 3A), N, to begin with.
        """
        L = len(inputs)
        known = inputs[:1] if (inputs == inputs[0]).all() else inputs  # one row is of all steps
        count, before = -1, np.inf
        for _ in range(1 + MOST_CORRECTIONS):
            x = self._carry(start, known @ self._step_u + φ @ self._push, L)
            look = self._look(np.hstack([x[:-1], inputs]), φ)
            solved = leading(look.is_due & (look.error <= CONVERGENCE_TOLERANCE))
            if solved == L or not (solved > count or look.error[solved] <= LEAST_REDUCTION * before):
                break
            count, before, φ = solved, look.error[solved], look.corrected
        K = leading(look.is_due & (look.error <= STAGNATION_RESIDUAL) & np.isfinite(x[1:]).all(axis=1))
        return KeptSteps(x, inputs, look.forces, look.q, look.gaps).first(K) if K else None

    def works(self, steps: KeptSteps) -> Works:
        """What these steps did."""
        x, u, h, A = steps.states[:-1], steps.inputs, self._h, len(self._active)
        f = steps.forces.reshape(len(u), -1)
        forces = f @ self._F
        m = self._S.shape[1]
        v, heat, ġ_mid = np.split(np.hstack([x, u, forces]) @ self._account, [m, 2 * m], axis=1)
        ẏ_mid = ġ_mid @ self._R
        by_contact = forces @ self._S
        power = float(np.vdot(by_contact, v) + np.vdot(forces, ẏ_mid[:, self._among]))
        normal = power
        if self._meeting.law.friction:
            closing = (v @ self._S.T + ẏ_mid[:, self._among]) @ self._F.T
            normal = float(np.vdot(f[:, :A], closing[:, :A]))
        dissipated = h * float(np.vdot(heat, heat)) + self._heat * float(np.vdot(ġ_mid, ẏ_mid))
        return Works(h * float(np.vdot(u @ self._G, v)), dissipated, -h * normal, h * (normal - power))

    def _carry(self, start: Array, push: Array, steps: int, level: int = 0) -> Array:
        """States (steps + 1, n) of x⁺ = x Sᵀ + push, with S to the power of 2^level; push is (steps, n), or (1, n)."""
        if level == len(self._powers):
            self._powers.append(self._powers[-1] @ self._powers[-1])
        power, states = self._powers[level], np.empty((steps + 1, len(start)))
        if steps <= FEWEST_TOGETHER:
            states[0] = start
            for k in range(steps):
                states[k + 1] = states[k] @ power + push[min(k, len(push) - 1)]
            return states
        first, second = (push, push) if len(push) == 1 else (push[::2], push[1::2])
        states[::2] = self._carry(start, first @ power + second, steps // 2, level + 1)
        states[1::2] = states[:-1:2] @ power + first
        return states

    def _look(self, z: Array, φ: Array) -> _Look:
        """Asks the law of steps that begin at states with inputs z = [x, u] (L, n + p)."""
        law, P, A, L = self._meeting.law, len(self._meeting.points), len(self._active), len(z)
        displacement, velocity, free = (z @ self._motion).reshape(L, 3, P, 3).swapaxes(0, 1)
        gaps, n = self._meeting.obstacle.distance((self._meeting.points + displacement).reshape(-1, 3))
        gaps, n = gaps.reshape(L, P), n.reshape(L, P, 3)
        approach, normal = (n * velocity).sum(axis=2), (n * free).sum(axis=2)

        # All as in contact_pairs.normal_law.
        closing, half = gaps / -self._h, (1 - law.restitution) / 2 * approach
        level = np.maximum(closing, (closing + half) / (2 - law.restitution))
        asked = np.minimum(np.where(gaps < 0, np.maximum(half, closing - np.abs(approach)), half), 0.0)
        is_due = ((normal < level) == self.pairs.chosen).all(axis=1)
        if self.pairs.frames is None:
            nothing = np.zeros((L, 3, 0))
            return _Look(is_due, np.zeros(L), gaps, nothing, nothing, φ)
        q, Jq, target = z @ self._q, z @ self._Jq, z @ self._target
        q[:, :A] += (half - asked)[:, self._active]
        f = Jq + φ
        u, f, q = ((f @ self._W + q).reshape(L, 3, A), f.reshape(L, 3, A), q.reshape(L, 3, A))
        if A < P:
            moved = normal + (n * (f.reshape(L, -1) @ self._F @ self._answer).reshape(L, P, 3)).sum(axis=2)
            is_due &= ((moved < level) <= self.pairs.chosen).all(axis=1)  # none is missed
        speed = np.abs(q).max(axis=(1, 2))
        by_friction = np.einsum("li,li->l", f[:, 1:].reshape(L, -1), target)
        is_due &= by_friction <= WORK_ROUND_OFF * np.abs(f).max(axis=(1, 2)) * speed
        is_due &= np.abs(n[:, self._active] - self.pairs.frames.normals).max(axis=(1, 2)) <= SAME_NORMALS

        corrected, error = self._corrected(f, u)
        return _Look(is_due, error / (speed + _TINY), gaps, q, f, corrected - Jq)

    def _corrected(self, f: Array, u: Array) -> tuple[Array, Array]:
        """Forces (L, 3A) that fulfil the linearised law, from f that cause u (L, 3, A), and what those lack (L,), m/s.

        As in complementarity.frictional: f is to be P(z), z = f - ρ u.
        """
        z = f - u / self._by_force
        cone = self._meeting.law.friction * np.maximum(z[:, 0], 0.0)
        share = cone / (np.maximum(np.hypot(z[:, 1], z[:, 2]), cone) + _TINY)
        projected = np.stack([np.maximum(z[:, 0], 0.0), share * z[:, 1], share * z[:, 2]], axis=1)
        off = f - projected
        lacking, flat = self._by_force * off, (len(f), -1)
        moves = lacking.reshape(flat) - off.reshape(flat) @ self._W
        return projected.reshape(flat) + moves @ self.pairs.inverse.T, np.abs(lacking).max(axis=(1, 2))


def _components(points: Array) -> Array:
    """Places of three components each (3 s,) of some points (s,)."""
    return (3 * points[:, None] + np.arange(3)).ravel()


def _turn(frames: Frames | None, pairs: int) -> Array:
    """F (3A, 3A) from space, pair after pair, to the frames: first all normal parts."""
    if frames is None:
        return np.empty((0, 0))
    F, each = np.zeros((3, pairs, pairs, 3)), np.arange(pairs)
    F[:, each, each] = np.broadcast_to(frames.axes, (pairs, 3, 3)).transpose(2, 0, 1)
    return F.reshape(3 * pairs, 3 * pairs)


def leading(holds: Array) -> int:
    """How many of the first ones hold."""
    return int(holds.argmin()) if not holds.all() else len(holds)
