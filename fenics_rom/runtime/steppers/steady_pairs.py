"""A step of a linear body in which all pairs do at one obstacle what they did in the step before.

With the law as it was linearised then, forces are f = J q + φ of the velocities q that they have to stop, and one
product gives all that they do: in this step to the pairs, and to the body, its points and their shape beyond the basis
after it. Then the law itself is asked, to the tolerance of a search. What forces lack is linearised in turn; where that
does not lead on quickly, another pair takes part, or friction would do work on the body, nothing is lost but the time.
"""

import math

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.complementarity import Delassus, KeptLaw
from fenics_rom.mechanics.complementarity.cones import project
from fenics_rom.mechanics.complementarity.following import SLOWEST
from fenics_rom.mechanics.complementarity.solution import (
    CONVERGENCE_TOLERANCE,
    NEAR,
    STAGNATION_RESIDUAL,
    Solution,
    largest,
)
from fenics_rom.mechanics.contact_pairs import WORK_ROUND_OFF
from fenics_rom.mechanics.followed_contact import Followed
from fenics_rom.runtime.steppers.followed_points import FollowedPoints, PairsBegun

_ONES, _FIRST = np.ones(3), np.array([[1.0], [0.0], [0.0]])
NEGLIGIBLE = 0.1  # of what forces may lack: what they lack in every step may as well add up
_NEARLY = 30.0  # of vectors: where their lengths are no more than so many times what may be left, components are asked
_MOST_CORRECTIONS = 6  # where it takes more, there is a change that is to be looked into


class SteadyPairs:
    """Pairs that take part, at one obstacle, and what their forces do.

    Args:
        points: that they are of.
        key: which of all pairs take part, as booleans.
        active: (C,) these.
        operator: of the pairs.
        begun: of a step, to tell axes that last.

    Attributes:
        key: as given.
        beyond: [f, R f] of all points in the last step (2, 3P), N and m, which the next one overwrites.
        after_state, after_rigid: what its forces added to [e⁺, r⁺] (2m,) and s⁺ (ρ,), in the same way.
    """

    def __init__(self, points: FollowedPoints, key: bytes, active: Array, operator: Delassus, begun: PairsBegun):
        body, friction, self._share = points.body, points.solver.law.friction, points.share
        frames, C, P = begun.frames, len(active), len(begun.margin)
        self.key, self._active, self._operator = key, active, operator
        self._friction, self._idle = friction, np.flatnonzero(~np.frombuffer(key, dtype=bool))
        self._among = (np.arange(6)[:, None] * P + active).ravel()  # of (6, P)
        is_flat, own = begun.normals is None, frames.of(active)
        framed = operator.framed(own) if is_flat else operator.lasting(frames)
        self._W, ρ, compliance, self._μ, self._zeros = framed.law_arrays(friction)
        self._ρ, self._compliance, self._softest = ρ.ravel(), compliance.ravel(), float(compliance.max())
        axes = np.broadcast_to(frames.axes if is_flat else np.eye(3), (P, 3, 3))  # of the frames, or those that last
        spread = np.zeros((P, 3, 3, C))  # forces along these, on all points along the axes of space
        spread[active, :, :, np.arange(C)] = axes[active]
        self._turn = None  # from axes that last
        if is_flat and not frames.are_alike:
            self._turn = spread[active].transpose(2, 3, 1, 0).reshape(3 * C, 3 * C)
        spread = spread.reshape(3 * P, 3 * C)
        moved = np.einsum("pif,pij->jpf", (body.delassus @ spread).reshape(P, 3, -1)[self._idle], axes[self._idle])
        moved = moved[: 1 if is_flat else 3].reshape(-1, 3 * C)  # of idle pairs, along normals that stay
        after = body.after(body.applied(body.rows.T @ spread))
        self._acts = np.concatenate([self._W, moved, spread, body.residual.part.compliance @ spread, after])
        self._does, ends = np.empty(len(self._acts)), np.cumsum([3 * C, len(moved), 3 * P, 3 * P, 2 * body.model.order])
        self._moved, self._moved_idle, forces, _, self.after_state, self.after_rigid = np.split(self._does, ends)
        self._forces, self.beyond = forces.reshape(P, 3), self._does[ends[1] : ends[3]].reshape(2, -1)
        self._fastest, self._strongest = 0, 0  # of velocities and forces, or so
        self._law: KeptLaw | None = None
        self._normals: Array | None = None  # of all pairs, in the last step

    def step(self, begun: PairsBegun, kept: KeptLaw) -> Followed | None:
        """The step by a kept law; None where something else is due."""
        moves, C, n = begun.moves.ravel(), len(self._active), begun.normals
        if len(self._idle):
            moves = moves.take(self._among)
        q, velocity = moves[: 3 * C], moves[3 * C :]
        if n is None:
            approach = velocity[:C]
        else:
            n, approach = self._normals_of_active(n), self._of(begun.approach)
            if n is None:
                return None
        target = None
        if not self._share or not self._is_round_off(approach, q):
            q, target = q.copy(), self._of(begun.target())
            off = self._share * approach - target
            q.reshape(3, C)[:] += off * (_FIRST if n is None else n)
        law = self._solve(q, n, kept)
        if law is None:
            return None
        f, power = self._f, None
        if self._friction:
            if n is None:
                pressure, by_friction = f[:C], f[C:].dot(velocity[C:])
            else:
                pressure = _ONES.dot(f.reshape(3, C) * n)
                by_friction = f.dot(velocity) - pressure.dot(approach)
            if by_friction > 0 and self._is_work(by_friction, f, q):
                return None
            power = 0.0
            if target is not None:
                power = float(pressure.dot(target))
        if len(self._idle):
            away = self._moved_idle
            if n is not None:
                away = _ONES.dot(away.reshape(3, -1) * self._idle_normals)
            away = away + begun.margin.take(self._idle)
            if away.item(away.argmin()) < 0.0:
                return None  # one is missed
        solution = Solution(f.reshape(3, -1), self._velocities.reshape(3, -1), 0, 0.0, law)
        return Followed(self.key, self._active, self._operator, solution, self._forces.copy(), power, n is None)

    def _of(self, values: Array) -> Array:
        """Those of the pairs that take part, of values of all (P,)."""
        return values.take(self._active) if len(self._idle) else values

    def _normals_of_active(self, normals: Array) -> Array | None:
        """Of all, (3, P), those of the pairs that take part; None where these are alike: another frame is theirs."""
        if normals is not self._normals:
            n = normals
            if len(self._idle):
                n, self._idle_normals = normals.take(self._active, axis=1), normals.take(self._idle, axis=1)
            self._normals, self._active_normals = normals, n
            ends = n[:, 0].tobytes(), n[:, -1].tobytes()
            self._are_alike = ends[0] == ends[1] and bool((n == n[:, :1]).all())
        return None if self._are_alike else self._active_normals

    def _is_round_off(self, approach: Array, q: Array) -> bool:
        """Whether pairs come near or leave by no more than what forces may lack: then that is to end, either way."""
        length = math.sqrt(approach.dot(approach))
        if length <= STAGNATION_RESIDUAL * abs(q.item(self._fastest)):  # no component is larger
            return True
        if length > STAGNATION_RESIDUAL * math.sqrt(q.dot(q)):
            return False
        self._fastest = int(np.abs(q).argmax())  # another may be now
        return length <= STAGNATION_RESIDUAL * abs(q.item(self._fastest))

    def _is_solved(self, off: Array, q: Array) -> bool:
        """Whether forces are off by no more than they may be."""
        self._fastest = int(np.abs(q).argmax())  # another may be now
        return largest(np.abs(self._compliance * off)) <= CONVERGENCE_TOLERANCE * abs(q.item(self._fastest))

    def _is_work(self, by_friction: float, f: Array, q: Array) -> bool:
        """Whether it is more than round-off; see contact_pairs.helping_pairs.

        It is to be twice as much: friction is to stop half the velocity at the start.
        """
        if by_friction <= 2 * WORK_ROUND_OFF * abs(f.item(self._strongest) * q.item(self._fastest)):
            return False
        self._strongest, self._fastest = int(np.abs(f).argmax()), int(np.abs(q).argmax())  # others may be now
        return by_friction > 2 * WORK_ROUND_OFF * abs(f.item(self._strongest) * q.item(self._fastest))

    def _solve(self, q: Array, n: Array | None, last: KeptLaw) -> KeptLaw | None:
        """Sets forces by the kept law, and by what it makes of what they lack, and what they do.

        Args:
            q: (3C,) what they have to stop, m/s.
            n: normals (3, C) of what is round, else None.
            last: the law as the last step left it.

        Returns:
            The law to go on with; None where there is more to look into.
        """
        kept, length = last, math.sqrt(q.dot(q))
        if last.earlier:
            change = q - last.q.ravel()
            if math.sqrt(change.dot(change)) > NEAR * abs(q.item(self._fastest)):  # else no component is, either
                kept = last.nearest(q.reshape(3, -1), largest(np.abs(q)))
        if kept.inverse is None or (kept.is_worn and self._friction):  # without friction there is none to be found anew
            return None
        is_steady = not (last.earlier or last.lacked) and isinstance(last.lacking, float)
        if not (is_steady or self._turn is None):
            return None
        if kept is not self._law:
            self._law, self._inverse = kept, kept.inverse
            self._φ = (kept.forces + kept.lacking).ravel() - kept.inverse.dot(kept.q.ravel())
            if self._turn is not None:
                self._inverse, self._φ = self._turn @ kept.inverse @ self._turn.T, self._turn @ self._φ
        inverse = self._inverse
        Jq = inverse.dot(q)
        foreseen = f = Jq + self._φ
        allowed, before, corrections = CONVERGENCE_TOLERANCE * abs(q.item(self._fastest)), length, 0
        nearly = _NEARLY * CONVERGENCE_TOLERANCE * length
        is_last = not kept.lacked  # where forces were corrected in the last step, they are likely to be in this one
        if is_last:
            self._acts.dot(f, self._does)
        else:
            self._W.dot(f, self._moved)
        while True:
            u = self._moved + q
            z = self._ρ * u
            np.subtract(f, z, z)
            projected = project(z.reshape(3, -1), n, self._μ, self._zeros).forces.ravel()
            off = f - projected
            error = math.sqrt(off.dot(off)) * self._softest  # no component is larger
            if error <= allowed or (error <= nearly and self._is_solved(off, q)):
                break
            if corrections == _MOST_CORRECTIONS or not error < SLOWEST * before:
                return None
            moves = self._compliance * off
            moves -= self._W.dot(off)  # as FollowedLaw.corrected
            f, before = inverse.dot(moves), error
            f += projected
            self._W.dot(f, self._moved)
            corrections += 1
        if corrections or not is_last:
            self._acts.dot(f, self._does)
        self._f, self._velocities = f, u
        if is_steady and not corrections:
            return last  # it says the same of the next step
        if self._turn is not None:
            return None  # it is not as steady as that
        lacking, lacked = kept.foreseen((projected - foreseen).reshape(3, -1) + kept.lacking, corrections > 0)
        is_negligible = False
        if not (corrections or lacked):
            size = math.sqrt(np.vdot(lacking, lacking)) * self._softest
            is_negligible = size <= NEGLIGIBLE * CONVERGENCE_TOLERANCE * largest(np.abs(q))
        at = q.reshape(3, -1).copy(), projected.reshape(3, -1), 0.0 if is_negligible else lacking
        earlier = last.earlier if corrections else ()
        now = KeptLaw(kept.statuses, inverse, *at, lacked, kept.worn(corrections), earlier)
        if kept is not last:
            return now.after(last)
        self._law, self._φ = now, (now.forces + now.lacking).ravel() - Jq
        return now
