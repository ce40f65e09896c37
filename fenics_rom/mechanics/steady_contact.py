"""A first look at contact forces, where all pairs do at one obstacle what they did in the step before.

What `followed_contact` does with them is gathered here for one set of pairs, one linearised law and one operator: the
forces by the kept law, what the law itself makes of them, and whether it is the same, to the tolerance of a search. If
it is not, nothing is lost but the time.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.complementarity import Delassus, Frames, KeptLaw, Solution
from fenics_rom.mechanics.complementarity.following import SLOWEST
from fenics_rom.mechanics.complementarity.solution import CONVERGENCE_TOLERANCE, is_none, largest
from fenics_rom.mechanics.contact_pairs import WORK_ROUND_OFF
from fenics_rom.mechanics.followed_contact import Followed, PairsMotion

_ONES, _TINY = np.ones(3), np.array(1e-300)
_MOST_CORRECTIONS = 6  # where it takes more, there is a change that is to be looked into


class _Solved(NamedTuple):
    """Forces that fulfil the law."""

    forces: Array  # (3, C), N
    pressure: Array  # their normal parts (C,), N
    moved: Array  # of all pairs, if not all take part, the velocities by them, (N,) along normals or (3N,), m/s
    solution: Solution


class SteadyPairs:
    """Pairs that take part, and what they are looked at with, in axes that last (see Frames).

    Args:
        key: which of N pairs take part, as booleans.
        active: (C,) these.
        operator: theirs.
        frames: of all.
        friction: μ.
        delassus: of all points, (3N, 3N), m/s/N.
    """

    def __init__(self, key: bytes, active: Array, operator: Delassus, frames: Frames, friction: float, delassus: Array):
        self._of, self._key, self._chosen = (delassus, frames), key, np.frombuffer(key, dtype=bool)
        self._active, self._operator, self._friction = active, operator, friction
        self._are_all, self._fastest, N = len(active) == len(key), 0, len(key)  # of q the fastest part, or so
        self._W, ρ, compliance, self._μ, self._zeros = operator.lasting(frames).law_arrays(friction)
        self._ρ, self._compliance = ρ.ravel(), compliance.ravel()
        self._among = (np.arange(3)[:, None] * N + active).ravel()  # of (3, N)
        if not self._are_all:  # velocities of all follow those of these: along the normals, where these are alike
            answers = delassus.reshape(N, 3, N, 3)[:, :, active].transpose(1, 0, 3, 2)
            if frames.are_alike:
                turn = frames.axes[0]
                answers = np.einsum("ij,jnkc,kl->inlc", turn[:, :1].T, answers, turn, optimize=True)
            self._W = np.concatenate([self._W, answers.reshape(-1, 3 * len(active))])

    def is_of(self, delassus: Array, frames: Frames) -> bool:
        """Whether this is of this operator, and of the axes of these frames."""
        own, known = self._of
        return own is delassus and (known is frames or (known == frames if frames.are_alike else not known.are_alike))

    def look(self, kept: KeptLaw, motion: PairsMotion) -> tuple[bool, Followed | None]:
        """Whether the kept law leads to forces that fulfil the law, and the step.

        No step where there are none, or where friction would do work on the body or another pair take part.
        """
        frames, n, (level, target, _), outwards, free, sliding, across = motion
        C, q, n_of_all = len(self._active), free.take(self._among), n
        if not self._are_all:
            target, sliding = target.take(self._active), None if sliding is None else sliding.take(self._among)
            n = None if n is None else n.take(self._among).reshape(3, C)
            across = None if across is None else across.take(self._active)
        if n is None:
            q[:C] -= target
        elif _are_alike(n):
            return False, None
        else:
            q -= ((target if across is None else target - across) * n).ravel()
        found = self._solve(q, n, kept)
        if found is None:
            return False, None
        projected, pressure, moved, solution = found
        power = None
        if self._friction:
            power = float(pressure.dot(target))  # pairs that push have their target
            if sliding is not None:
                by_friction = projected.ravel().dot(sliding.ravel())  # see contact_pairs.helping_pairs
                if across is not None:
                    by_friction -= pressure.dot(across)
                if by_friction > 0 and by_friction > WORK_ROUND_OFF * largest(np.abs(projected)) * largest(np.abs(q)):
                    return True, None
        forces = frames.from_lasting_axes(projected)
        if not self._are_all:
            away = moved if n_of_all is None else _ONES.dot(moved.reshape(3, -1) * n_of_all)
            if not is_none((away + outwards < level) > self._chosen):
                return True, None
            forces, among = np.zeros((len(level), 3)), forces
            forces[self._active] = among
        return True, Followed(self._key, self._active, self._operator, solution, forces, power)

    def _solve(self, q: Array, n: Array | None, last: KeptLaw) -> "_Solved | None":
        """Forces by the kept law, and by what it makes of what they lack; None where there is more to look into.

        Args:
            q: (3C,) velocities without contact, less the targets, m/s.
            n: normals (3, C) of what is round, else None.
            last: the law as the last step left it.
        """
        C, corrections, speed = len(self._active), 0, abs(q.item(self._fastest))
        kept = last.nearest(q.reshape(3, C), largest(np.abs(q))) if last.earlier else last
        inverse, before = kept.inverse, np.inf
        if inverse is None or kept.is_worn:
            return None
        change, lacking = q - kept.q.ravel(), kept.lacking
        linear = inverse.dot(change)
        linear += kept.forces.ravel()
        f = linear + lacking.ravel() if isinstance(lacking, np.ndarray) else linear
        while True:
            moved = self._W.dot(f)
            u = moved[: 3 * C] + q
            z = self._ρ * u
            np.subtract(f, z, z)
            projected, pressure = self._projected(z.reshape(3, C), n)
            forces = projected.ravel()
            off = f - forces
            moves = self._compliance * off
            error = largest(np.abs(moves))
            if error <= CONVERGENCE_TOLERANCE * speed:
                break
            if not corrections:  # another may be the fastest now
                self._fastest = int(np.abs(q).argmax())
                speed = before = abs(q.item(self._fastest))
                if error <= CONVERGENCE_TOLERANCE * speed:
                    break
            if corrections == _MOST_CORRECTIONS or not error < SLOWEST * before:
                return None
            moves -= self._W[: 3 * C].dot(off)  # as FollowedLaw.corrected
            f, before = inverse.dot(moves), error
            f += forces
            corrections += 1
        lacked, q = (forces - linear).reshape(3, C), q.reshape(3, C)
        foreseen, wear = kept.foreseen(lacked, corrections > 0), kept.wear + max(corrections - 1, 0) ** 3
        now = KeptLaw(kept.statuses, inverse, q, projected, *foreseen, wear, last.earlier if corrections else ())
        if kept is not last:
            now = now.after(last)
        solution = Solution(projected, u.reshape(3, C), 0, error / speed, now)
        return _Solved(projected, pressure, moved[3 * C :], solution)

    def _projected(self, z: Array, n: Array | None) -> tuple[Array, Array]:
        """P(z) (3, C) and its normal parts (C,), N; see `complementarity.following`. z is overwritten."""
        if n is None:
            pressure, across = z[0], z
        else:
            pressure = _ONES.dot(z * n)
            across = z
            across -= pressure * n
        λ = np.maximum(pressure, self._zeros)
        if not self._friction:
            across = np.zeros(z.shape)
        else:
            length = np.hypot(z[1], z[2]) if n is None else np.sqrt(_ONES.dot(across * across))
            cone = self._μ * λ
            np.maximum(length, cone, length)
            length += _TINY
            across = across * np.divide(cone, length, cone)
        if n is None:
            across[0] = λ
        else:
            across += λ * n
        return across, λ


def _are_alike(n: Array) -> bool:
    """Whether the first and the last of some normals (3, C) are: if all are, another frame is theirs."""
    C = n.shape[1]
    return all(n.item(C * i) == n.item(C * (i + 1) - 1) for i in range(3))
