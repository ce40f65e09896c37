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

from fenics_rom.mechanics.braking import WORK_ROUND_OFF
from fenics_rom.mechanics.complementarity import Frames
from fenics_rom.mechanics.complementarity.frictional import SHARES
from fenics_rom.mechanics.complementarity.solution import CONVERGENCE_TOLERANCE, STAGNATION_RESIDUAL
from fenics_rom.mechanics.contact import ContactLaw
from fenics_rom.mechanics.contact_pairs import NormalRule
from fenics_rom.mechanics.obstacles import Obstacle
from fenics_rom.mechanics.points_operator import columns_of
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.midpoint_map import compliance
from fenics_rom.runtime.steppers.residual_maps import ResidualMaps

MOST_CORRECTIONS = 5  # of the forces of all steps
LEAST_REDUCTION = 0.1  # of the error of the first step that is not solved, for another correction to pay
SAME_NORMALS = 1e-13  # by which normals may turn: forces are then off by less than they may lack
FEWEST_TOGETHER = 4  # steps that are taken as pairs; fewer one by one
_ONES, _TINY = np.ones(3), 1e-300


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
    inverse: Array  # J (3A, 3A) in axes that last (see Frames), N s/m


class KeptSteps(NamedTuple):
    """K steps that fulfil the law."""

    states: Array  # x (K + 1, n), from the start on
    inputs: Array  # (K, p)
    forces: Array  # f (K, 3A) in the frames, N
    q: Array  # what they have to stop (K, 3A), m/s
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
    q: Array  # (L, 3A), m/s
    forces: Array  # (L, 3A), N
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
        radius = meeting.obstacle.core[0]
        self._rule = NormalRule(meeting.law, len(meeting.points), h, quasi_static=False, radii=[radius])
        self._model, self._residual, self._active = model, residual, pairs.chosen.nonzero()[0]
        m, p, rows, A = model.order, model.inputs.shape[1], meeting.rows, len(self._active)
        of_carried, of_active = _components(carried), _components(self._active)
        self._components = of_active
        self._among = np.flatnonzero(np.isin(of_carried, of_active))
        self._S, R = rows[of_active], np.empty((len(rows), 0))
        self._compliance = compliance(model, h)
        bounds = np.cumsum([m, m, len(of_carried), len(of_carried), p])
        n, self._parts = int(bounds[3]), bounds[:3]

        # All that follows is linear in z = [x, u, f]; these columns pick its parts, as states are rows.
        e, r, g, ġ, u, f = np.split(np.eye(bounds[4] + 3 * A), bounds, axis=1)
        v, _ = self._rates(self._forces(e, r, u, f))
        ġ_mid = self._residual_rates(g, ġ, f)
        if residual is not None:
            R = columns_of(residual.part.operator, carried)
        self._R = R[of_carried]
        rigid, ω = np.arange(m) < model.rigid, np.sqrt(model.eigenvalues)
        self.by_state = np.where(rigid, 1.0, 1 / model.safe_frequencies)
        after = np.hstack([e + h * np.where(rigid, 1.0, ω) * v, 2 * v - r, g + h * ġ_mid, 2 * ġ_mid - ġ])
        displacement, velocity = e @ (rows * self.by_state).T + g @ R.T, r @ rows.T + ġ @ R.T
        middle = v @ rows.T + ġ_mid @ R.T
        given, forces = slice(n + p), slice(n + p, None)  # without forces, and by them
        self._motion = np.hstack([displacement, velocity, middle])[given].copy()
        self._answer = middle[forces].copy()

        # Pairs that stay in touch have no approach but of round-off: it is to end, as where it is towards the obstacle.
        law, part = meeting.law, np.full((3, A), 0.5 if meeting.law.friction else 0.0)
        part[0] = 0.0 if self._rule.is_elastic else 0.5
        self._part = part.ravel()
        self._asked = np.repeat([True, law.friction > 0, law.friction > 0], A)  # tangents only where there is friction
        self._F = F = _turn(pairs.frames, A)
        self._lasting = np.eye(3 * A)  # from axes that last to the frames
        if pairs.frames is not None and not pairs.frames.are_alike:
            self._lasting = F[:, np.arange(3 * A).reshape(A, 3).T.ravel()]
        self._J = self._lasting @ pairs.inverse @ self._lasting.T
        q = (middle[given][:, of_active] @ F.T - velocity[given][:, of_active] @ F.T * self._part) * self._asked
        self._W = F @ self._answer[:, of_active] @ F.T
        self._by_force = np.tile(self._W.diagonal().reshape(3, A).sum(axis=0) / (3 * SHARES[0]), 3)  # 1/ρ (3A,)
        self._push = F @ after[forces]
        step = after[given] + q @ self._J.T @ self._push
        self._drift = np.zeros(3 * A)  # of φ in a step, as it was in the last block
        self._powers, self._step_u = [step[:n].copy()], step[n:].copy()

    def split(self, x: Array) -> list[Array]:
        """e, r (m,), g and ġ (3c,) of a state."""
        return np.split(x, self._parts)

    def guess(self, forces: Array, q: Array) -> Array:
        """φ (1, 3A), N, that goes on with forces that were found for q, (3, A) each in axes that last, N and m/s."""
        if not q.size:
            return np.empty((1, 0))
        forces, q = self._lasting @ forces.ravel(), self._lasting @ q.ravel()
        φ: Array = self._corrected(forces[None], (self._W @ forces + q)[None])[0] - self._J @ q
        return φ

    def in_lasting_axes(self, vectors: Array) -> Array:
        """Of pairs in the frames (3A,), (3, A) in axes that last."""
        lasting: Array = (vectors @ self._lasting).reshape(3, -1)
        return lasting

    def take(self, start: Array, inputs: Array, φ: Array) -> KeptSteps | None:
        """The steps from a state x (n,) that fulfil the law; None where the first does not.

        Args:
            start: x (n,).
            inputs: (L, p) of each, with the loads, L a power of two, N.
            φ: (1, 3A) or (L, 3A), N, to begin with.
        """
        L = len(inputs)
        if self._drift.any():  # it is likely to go on
            φ = φ + np.arange(1, L + 1)[:, None] * self._drift
        known = inputs[:1] if (inputs == inputs[0]).all() else inputs  # one row is of all steps
        count, before = -1, np.inf
        for _ in range(1 + MOST_CORRECTIONS):
            with np.errstate(over="ignore", invalid="ignore"):  # steps that are not finite are not taken
                x = self._carry(start, known @ self._step_u + φ @ self._push, L)
                look = self._look(np.hstack([x[:-1], inputs]), φ)
            solved = leading(look.is_due & (look.error <= CONVERGENCE_TOLERANCE))
            if solved == L or not (solved > count or look.error[solved] <= LEAST_REDUCTION * before):
                break
            count, before, φ = solved, look.error[solved], look.corrected
        K = leading(look.is_due & (look.error <= STAGNATION_RESIDUAL) & np.isfinite(x[1:]).all(axis=1))
        if not K:
            return None
        drift = (look.corrected[K - 1] - look.corrected[0]) / K
        matters = L * np.abs(drift @ self._W).max(initial=0.0) > CONVERGENCE_TOLERANCE * np.abs(look.q).max(initial=0.0)
        self._drift = drift if matters and K == L else 0 * drift
        return KeptSteps(x, inputs, look.forces, look.q, look.gaps).first(K)

    def works(self, steps: KeptSteps) -> Works:
        """What these steps did."""
        e, r, g, ġ = np.split(steps.states[:-1], self._parts, axis=1)
        f, u, h, A = steps.forces, steps.inputs, self._h, len(self._active)
        in_space = f @ self._F
        v, heat = self._rates(self._forces(e, r, u, in_space))
        ġ_mid = self._residual_rates(g, ġ, in_space)
        ẏ_mid = ġ_mid @ self._R
        moved = v @ self._S.T + ẏ_mid[:, self._among]
        power = normal = float(np.vdot(in_space, moved))
        if self._meeting.law.friction:
            normal = float(np.vdot(f[:, :A], (moved @ self._F.T)[:, :A]))
        dissipated = h * float(np.vdot(heat, heat))
        if self._residual is not None:
            dissipated += self._residual.heat * float(np.vdot(ġ_mid, ẏ_mid))
        supplied = h * float(np.vdot(u @ self._model.inputs.T, v))
        return Works(supplied, dissipated, -h * normal, h * (normal - power))

    def _forces(self, e: Array, r: Array, u: Array, f: Array) -> Array:
        """What acts in steps from states with inputs and forces in space, (L, m) N kg^-1/2; arguments have L rows."""
        forces: Array = u @ self._model.inputs.T + f @ self._S + 2 / self._h * r - np.sqrt(self._model.eigenvalues) * e
        return forces

    def _rates(self, forces: Array) -> tuple[Array, Array]:
        """v̂ (L, m) under forces (L, m), and that whose square is dissipated per time, (L, m)."""
        a, heat = self._compliance
        return (forces * a, forces * heat) if a.ndim == 1 else (forces @ a, forces @ heat.T)

    def _residual_rates(self, g: Array, ġ: Array, f: Array) -> Array:
        """ġ̂ (L, 3c) from g, ġ (L, 3c) and forces in space (L, 3A)."""
        if self._residual is None:
            return g
        by_g, _, by_rate, _, by_force, _ = self._residual.step[4]
        rates: Array = by_g * g + by_rate * ġ
        rates[:, self._among] += by_force * f
        return rates

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
        chosen, A, L = self.pairs.chosen, len(self._active), len(z)
        displacement, velocity, free = np.split(z @ self._motion, 3, axis=1)
        places = displacement.reshape(L, -1, 3) + self._meeting.points
        gaps, n = self._meeting.obstacle.distance(places.reshape(-1, 3))
        gaps, n = gaps.reshape(L, -1), n.reshape(L, -1)
        approach, normal = _along(n, velocity), _along(n, free)

        level, asked, _ = self._rule.asks(
            gaps, -np.inf, None, approach, normal
        )  # what is of gaps < 0 changes no others
        is_due = ((normal < level) == chosen).all(axis=1)
        if self._rule.too_far is not None:
            is_due &= (self._rule.too_far[:, self._active] <= 1).all(axis=1)
        if self.pairs.frames is None:
            nothing = np.zeros((L, 0))
            return _Look(is_due, np.zeros(L), gaps, nothing, nothing, nothing)
        own = self._components
        targets = velocity[:, own] @ self._F.T * self._part
        q = (free[:, own] @ self._F.T - targets) * self._asked
        Jq = q @ self._J.T
        thrown = (self._part.item(0) * approach - asked)[:, self._active]
        q[:, :A] += thrown
        f = Jq + φ
        u, speed = f @ self._W + q, np.abs(q).max(axis=1) + _TINY
        if not chosen.all():
            moved = normal + _along(n, f @ self._F @ self._answer)
            is_due &= ((moved < level) <= chosen).all(axis=1)  # none is missed
        by_friction = (f[:, A:] * targets[:, A:]).sum(axis=1)
        is_due &= by_friction <= WORK_ROUND_OFF * np.abs(f).max(axis=1) * speed
        is_due &= np.abs(n[:, own] - self.pairs.frames.normals.ravel()).max(axis=1) <= SAME_NORMALS
        corrected, error = self._corrected(f, u)
        round_off = np.abs(thrown) <= STAGNATION_RESIDUAL * speed[:, None]
        if round_off.any():  # what is there of it goes with the error of the step before
            u[:, :A] -= thrown * round_off
            corrected, _ = self._corrected(f, u)
        return _Look(is_due, error / speed, gaps, q, f, corrected - Jq)

    def _corrected(self, f: Array, u: Array) -> tuple[Array, Array]:
        """Forces (L, 3A) that fulfil the linearised law, from f that cause u (L, 3A), and what those lack (L,), m/s.

        As in complementarity.frictional: f is to be P(z), z = f - ρ u.
        """
        A = len(self._active)
        projected = f - u / self._by_force
        pressure, first, second = projected[:, :A], projected[:, A : 2 * A], projected[:, 2 * A :]
        np.maximum(pressure, 0.0, out=pressure)
        cone, length = self._meeting.law.friction * pressure, np.sqrt(first * first + second * second)
        share = cone / (np.maximum(length, cone) + _TINY)
        first *= share
        second *= share
        off = f - projected
        lacking = off * self._by_force
        return projected + (lacking - off @ self._W) @ self._J.T, np.abs(lacking).max(axis=1)


def _along(normals: Array, vectors: Array) -> Array:
    """Parts (L, P) of vectors along unit normals, both (L, 3P)."""
    along: Array = (normals * vectors).reshape(-1, 3).dot(_ONES)
    return along.reshape(len(normals), -1)


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
