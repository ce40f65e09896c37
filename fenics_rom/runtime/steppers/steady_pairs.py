"""A step of a linear body in which all pairs do at one obstacle what they did in the step before.

With the law as it was linearised then, forces are f = J q + φ of the velocities q that they have to stop, and one
product gives all that they do: in this step to the pairs, and to the body, its points and their shape beyond the basis
after it. Then the law itself is asked, to the tolerance of a search. What forces lack is linearised in turn; where that
does not lead on quickly, another pair takes part, or friction would do work on the body, nothing is lost but the time.
A law that took many corrections is linearised anew.
"""

import math

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.braking import WORK_ROUND_OFF
from fenics_rom.mechanics.complementarity import Delassus, KeptLaw
from fenics_rom.mechanics.complementarity.cones import project
from fenics_rom.mechanics.complementarity.following import SLOWEST, FollowedLaw
from fenics_rom.mechanics.complementarity.solution import CONVERGENCE_TOLERANCE, STAGNATION_RESIDUAL, Solution, largest
from fenics_rom.mechanics.followed_contact import Followed
from fenics_rom.mechanics.points_operator import columns_of
from fenics_rom.runtime.steppers.followed_points import FollowedPoints, PairsBegun

_ONES = np.ones(3)
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
        size: how many numbers its matrix has.
        beyond: [f, R f] of all points in the last step (2, 3P), N and m, which the next one overwrites.
        after_state, after_rigid: what its forces added to [e⁺, r⁺] (2m,) and s⁺ (ρ,), in the same way.
    """

    def __init__(self, points: FollowedPoints, key: bytes, active: Array, operator: Delassus, begun: PairsBegun):
        body, friction, self._points = points.body, points.solver.law.friction, points
        frames, C, P = begun.frames, len(active), len(begun.margin)
        self.key, self._active, self._operator = key, active, operator
        self._friction, self._idle = friction, np.flatnonzero(~np.frombuffer(key, dtype=bool))
        is_flat, own, rows = begun.closing is not None, frames.of(active), P * np.arange(len(begun.moves))[:, None]
        self._among, self._among_idle = (rows + active).ravel(), (rows[[0, 1, 2, 5]] + self._idle).ravel()
        self._framed = operator.framed(own) if is_flat else operator.lasting(frames)
        self._W, ρ, compliance, self._μ, self._zeros = self._framed.law_arrays(friction)
        self._ρ, self._compliance, self._softest = ρ.ravel(), compliance.ravel(), float(compliance.max())
        axes, self._turn = own.axes if is_flat else None, None  # those that last are of space, or of the frames
        spread = np.zeros((P, 3, 3, C))  # forces along these, on all points along the axes of space
        spread[active, :, :, np.arange(C)] = np.eye(3) if axes is None else axes
        if axes is not None and not frames.are_alike:
            self._turn = spread[active].transpose(2, 3, 1, 0).reshape(3 * C, 3 * C)

        def along_axes(each: Array) -> Array:
            """What forces on the pairs (..., C, 3) move, of forces along these axes, (..., 3C)."""
            each = each.swapaxes(1, 2) if axes is None else np.einsum("rcj,cji->ric", each, axes)
            return each.reshape(-1, 3 * C)

        idle = columns_of(body.delassus, active).reshape(P, 3, -1)[self._idle]
        along = np.einsum("pif,pi->pf", idle, frames.normals[self._idle]) if is_flat else idle.swapaxes(0, 1)
        moved = along_axes(along.reshape(-1, C, 3))
        yielding = along_axes(columns_of(body.residual.part.operator, active).reshape(3 * P, C, 3))
        of_points = (
            spread.reshape(3 * P, -1),
            yielding,
            along_axes(points.pushed.reshape(-1, P, 3).take(active, axis=1)),
        )
        self._acts = np.concatenate([self._W, moved, *of_points])
        self.size = self._acts.size
        self._does, ends = np.empty(len(self._acts)), np.cumsum([3 * C, len(moved), 3 * P, 3 * P, 2 * body.model.order])
        self._moved, self._moved_idle, forces, _, self.after_state, self.after_rigid = np.split(self._does, ends)
        self._forces, self.beyond = forces.reshape(P, 3), self._does[ends[1] : ends[3]].reshape(2, -1)
        self._fastest, self._strongest = 0, 0  # of velocities and forces, or so
        self._law: KeptLaw | None = None
        self._excess_of = np.empty((0, 0)), np.empty((0, 0))  # J, and what it makes of forces

    def step(self, begun: PairsBegun, kept: KeptLaw) -> Followed | None:
        """The step by a kept law; None where something else is due."""
        moves, C, n = begun.moves.ravel(), len(self._active), None
        of_active = moves.take(self._among) if len(self._idle) else moves
        if begun.closing is not None:
            q, velocity = of_active[: 3 * C], of_active[3 * C :]
            approach, rest = velocity[:C], self._of(begun.closing)
        else:
            n, approach, rest = of_active[: 3 * C].reshape(3, C), of_active[3 * C : 4 * C], of_active[4 * C : 5 * C]
            q, velocity = of_active[6 * C : 9 * C], of_active[9 * C :]
            if n.item(0) == n.item(C - 1) and (n == n[:, :1]).all():
                return None  # another frame is theirs
        target, share = None, self._points.share
        if not (self._is_round_off(approach, rest, q) if share else n is None):
            if n is None:
                target, off = map(self._of, self._points.flat_targets())
            else:
                target, off = rest, share * approach - rest
            if n is None:
                q = q.copy()
                q[:C] += off
            else:
                q = q + (off * n).ravel()
        law = self._solve(q, n, kept)
        if law is None:
            return None
        f, power, missed = self._f, None, None
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
            if n is None:
                away = self._moved_idle + begun.margin.take(self._idle)
            else:
                of_idle = moves.take(self._among_idle).reshape(4, -1)
                away = _ONES.dot(self._moved_idle.reshape(3, -1) * of_idle[:3]) + of_idle[3]
            if away.item(away.argmin()) < 0.0:
                missed = np.zeros(len(begun.margin), dtype=bool)
                missed[self._idle] = away < 0.0
        solution = Solution(f.reshape(3, -1), self._velocities.reshape(3, -1), 0, 0.0, law)
        forces = self._forces.copy()
        return Followed(self.key, self._active, self._operator, solution, forces, power, n is None, missed)

    def _of(self, values: Array) -> Array:
        """Those of the pairs that take part, of values of all (P,)."""
        return values.take(self._active) if len(self._idle) else values

    def _is_round_off(self, approach: Array, rest: Array, q: Array) -> bool:
        """Whether pairs move and lie apart by no more than what forces may lack: then that is to end, either way.

        `rest` is how fast a gap is to close, (C,), m/s.
        """
        length = math.sqrt(approach.dot(approach) + rest.dot(rest))
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
        """Whether it is more than round-off; see Braking.asks_less.

        It is to be twice as much: friction is to stop half the velocity at the start.
        """
        if by_friction <= 2 * WORK_ROUND_OFF * abs(f.item(self._strongest) * q.item(self._fastest)):
            return False
        self._strongest, self._fastest = int(np.abs(f).argmax()), int(np.abs(q).argmax())  # others may be now
        return by_friction > 2 * WORK_ROUND_OFF * abs(f.item(self._strongest) * q.item(self._fastest))

    def _solve(self, q: Array, n: Array | None, kept: KeptLaw) -> KeptLaw | None:
        """Sets forces by the kept law, and by what it makes of what they lack, and what they do.

        Args:
            q: (3C,) what they have to stop, m/s.
            n: normals (3, C) of what is round, else None.
            kept: the law as the last step left it.

        Returns:
            The law to go on with; None where there is more to look into.
        """
        if kept.inverse is None:
            return None
        length, is_steady = math.sqrt(q.dot(q)), not kept.lacked and isinstance(kept.lacking, float)
        if not (is_steady or self._turn is None):
            return None
        if kept is not self._law:
            self._law, self._inverse = kept, kept.inverse
            self._φ = (kept.forces + kept.lacking).ravel() - kept.inverse.dot(kept.q.ravel())
            if self._turn is not None:
                self._inverse, self._φ = self._turn @ kept.inverse @ self._turn.T, self._turn @ self._φ
        Jq = self._inverse.dot(q)
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
            f, before = f - self._excess().dot(off), error
            self._W.dot(f, self._moved)
            corrections += 1
        if corrections or not is_last:
            self._acts.dot(f, self._does)
        self._f, self._velocities = f, u
        if is_steady and not corrections:
            return kept  # it says the same of the next step
        if self._turn is not None:
            return None  # it is not as steady as that
        reached = f if corrections else projected
        if kept.lacked and not corrections:  # nearer than it has to be, as forces will be told from its differences
            reached = f - self._excess().dot(off)
        lacking = (reached - foreseen).reshape(3, -1) + kept.lacking
        lacking, lacked, calm = kept.foreseen(lacking, corrections > 0)
        is_negligible = False
        if not (corrections or lacked):
            size = math.sqrt(np.vdot(lacking, lacking)) * self._softest
            is_negligible = size <= NEGLIGIBLE * CONVERGENCE_TOLERANCE * largest(np.abs(q))
        at = q.reshape(3, -1).copy(), reached.reshape(3, -1), 0.0 if is_negligible else lacking
        now = KeptLaw(kept.statuses, kept.inverse, *at, lacked, calm, kept.worn(corrections))
        if kept.is_worn and self._friction:  # without friction there is none to be found anew
            now = self._linearised(now, kept, n)
        if now.inverse is not kept.inverse:
            return now
        self._law, self._φ = now, (now.forces + now.lacking).ravel() - Jq
        return now

    def _excess(self) -> Array:
        """By what forces are too large (3C, 3C), of how far they are from the cones, (3C,).

        With f off by δ, f - δ are in the cones; W is off less by W δ, and ρ⁻¹ δ more than the law has it, as
        FollowedLaw.corrected says: f - δ + J (ρ⁻¹ - W) δ.
        """
        if self._excess_of[0] is not self._inverse:
            J = self._inverse
            self._excess_of = J, np.eye(len(J)) - J * self._compliance + J @ self._W
        return self._excess_of[1]

    def _linearised(self, now: KeptLaw, kept: KeptLaw, n: Array | None) -> KeptLaw:
        """A kept law that is worn, linearised at its forces; the same where that has no inverse."""
        law = FollowedLaw(self._framed, now.q, self._friction, n)
        try:
            inverse = law.inverse(law.at(now.forces))
        except np.linalg.LinAlgError:
            return now._replace(wear=0)
        foreseen = kept.forces + inverse.dot((now.q - kept.q).ravel()).reshape(3, -1)
        lacking, lacked, calm = kept.foreseen(now.forces - foreseen, False)
        return now._replace(inverse=inverse, lacking=lacking, lacked=lacked, calm=calm, wear=0)
