"""A first look at contact forces, where all pairs are on flat ground and do what they did in the step before.

What `followed_contact` does with them is gathered here for one set of pairs, one linearised law and one operator: the
forces by the kept law, what the law itself makes of them, and whether it is the same, to the tolerance of a search. If
it is not, nothing is lost but the time.
"""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.complementarity import Delassus, Frames, KeptLaw, Solution
from fenics_rom.mechanics.complementarity.solution import CONVERGENCE_TOLERANCE, NEAR, is_none, largest
from fenics_rom.mechanics.contact_pairs import WORK_ROUND_OFF
from fenics_rom.mechanics.followed_contact import Followed, PairsMotion

_TINY = np.array(1e-300)


class SteadyPairs:
    """Pairs whose normals are alike, and what they are looked at with.

    Args:
        key: which of N pairs take part, as booleans.
        active: (C,) these.
        operator: theirs.
        frames: of all.
        friction: μ.
        inverse: of the kept law, (3C, 3C), N s/m.
        delassus: of all points, (3N, 3N), m/s/N.
    """

    def __init__(
        self,
        key: bytes,
        active: Array,
        operator: Delassus,
        frames: Frames,
        friction: float,
        inverse: Array,
        delassus: Array,
    ):
        self._of, self._key, self._chosen = (inverse, delassus, frames), key, np.frombuffer(key, dtype=bool)
        self._active, self._operator, self._friction = active, operator, friction
        self._are_all = len(active) == len(key)
        self._W, ρ, compliance, self._μ, self._zeros = operator.lasting(frames).law_arrays(friction)
        self._ρ, self._compliance = ρ.ravel(), compliance.ravel()
        self._among = (np.arange(3)[:, None] * len(key) + active).ravel()  # of (3, N)
        if not self._are_all:  # normal velocities of all follow those of these
            N, turn = len(key), frames.axes[0]
            answers = np.einsum("i,pijk->pjk", turn[:, 0], delassus.reshape(N, 3, N, 3)[:, :, active]) @ turn
            self._W = np.concatenate([self._W, answers.swapaxes(1, 2).reshape(N, -1)])

    def is_of(self, inverse: Array, delassus: Array, frames: Frames) -> bool:
        """Whether this is of a law with this inverse, and of this operator and these frames."""
        return self._of[0] is inverse and self._of[1] is delassus and self._of[2] == frames

    def look(self, kept: KeptLaw, motion: PairsMotion) -> Followed | None:
        """The step; None where the kept law does not lead to forces that fulfil the law."""
        level, target, _ = motion.asked
        inverse, _, frames = self._of
        if (motion.outwards < level).tobytes() != self._key:
            return None
        C, q, sliding = len(self._active), motion.free.take(self._among), motion.sliding
        if not self._are_all:
            target = target.take(self._active)
        q[:C] -= target
        change, speed = q - kept.q.ravel(), largest(np.abs(q))
        if kept.earlier and largest(np.abs(change)) > NEAR * speed:
            return None
        linear = inverse.dot(change)
        linear += kept.forces.ravel()
        f = linear + kept.flat_lacking
        moved = self._W.dot(f)
        u = moved[: 3 * C] + q
        z = self._ρ * u
        np.subtract(f, z, z)
        parts = z.reshape(3, C)
        if self._friction:
            length, cone = np.hypot(parts[1], parts[2]), self._μ * parts[0]
            np.maximum(cone, self._zeros, cone)
            np.maximum(length, cone, length)
            length += _TINY
            projected = parts * np.divide(cone, length, cone)
        else:
            projected = np.zeros(parts.shape)
        np.maximum(parts[0], self._zeros, projected[0])
        forces = projected.ravel()
        off = f - forces
        off *= self._compliance
        error = largest(np.abs(off))
        if not error <= CONVERGENCE_TOLERANCE * speed:
            return None
        power = None
        if self._friction:
            λ = projected[0]
            power = float(λ.dot(u[:C]) + λ.dot(target))
            if sliding is not None:
                by_friction = forces.dot(sliding.ravel() if self._are_all else sliding.take(self._among))
                if by_friction > 0 and by_friction > WORK_ROUND_OFF * largest(np.abs(forces)) * speed:
                    return None
        in_space = frames.in_space(projected)
        if not self._are_all:
            if not is_none((moved[3 * C :] + motion.outwards < level) > self._chosen):
                return None
            in_space, among = np.zeros((len(level), 3)), in_space
            in_space[self._active] = among
        now = kept.after_look(q.reshape(3, C), projected, (forces - linear).reshape(3, C))
        solution = Solution(projected, u.reshape(3, C), 0, error / speed, now)
        return Followed(self._key, self._active, self._operator, frames, solution, in_space, power)
