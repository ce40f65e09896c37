"""Contact forces by the law as it was linearised in an earlier step, without a search.

Where normals turn with the points, all is along the axes of space, in which W stays the same, and P(z) with
z = f - ρ u (see `frictional`) is taken apart by the normals (`cones`); where all normals are alike, in their frame.
What the law was linearised to is kept as the matrix by which it multiplies velocities. Steps with it are products, and
each is looked at by the law itself.
"""

from contextlib import suppress
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.complementarity.cones import project
from fenics_rom.mechanics.complementarity.delassus import FramedDelassus, Frames
from fenics_rom.mechanics.complementarity.linearised import linearised
from fenics_rom.mechanics.complementarity.solution import (
    CONVERGENCE_TOLERANCE,
    STAGNATION_RESIDUAL,
    KeptLaw,
    Solution,
    largest,
    statuses_of,
)

_MOST_STEPS = 8  # with a kept inverse, before Newton's method
SLOWEST = 3e-2  # reduction of the error by such a step: where it is less, the inverse is found anew
LOOKED_INTO = 1e-5  # error, as a share of the velocities, at which pairs may do something else
_MOST_CHANGED = 2  # pairs that do, for which it pays to go on


class _Looked(NamedTuple):
    """What the law says at forces f."""

    velocities: Array  # u (3, C), m/s
    z: Array  # f - ρ u (3, C), N
    length: Array  # |z_t| (C,), N
    cone: Array  # μ z_n (C,), N; 0 where a pair is open
    projected: Array  # P(z) (3, C), N
    error: float  # how far f is from it by ρ, m/s


class FollowedLaw:
    """The conditions of C pairs as in `complementarity.solve`, in axes that last (see Frames).

    Args:
        operator: W of the pairs, regular, in axes that last.
        q: (3, C) velocities without contact, less the targets, m/s.
        friction: μ >= 0.
        normals: (3, C); None where all are the first of the axes.
    """

    def __init__(self, operator: FramedDelassus, q: Array, friction: float, normals: Array | None):
        self.operator, self.q, self.friction, self._normals = operator, q, friction, normals
        self._W, self._ρ, self._compliance, self._μ, self._zeros = operator.law_arrays(friction)

    def at(self, f: Array) -> _Looked:
        """Looks at forces f (3, C)."""
        u = self._W.dot(f.ravel()).reshape(f.shape)
        u += self.q
        z = self._ρ * u
        np.subtract(f, z, z)
        projected, length, cone = project(z, self._normals, self._μ, self._zeros)
        if projected is z:  # all stick
            return _Looked(u, z, length, cone, z, largest(np.abs(u)))
        return _Looked(u, z, length, cone, projected, largest(np.abs((f - projected) * self._compliance)))

    def corrected(self, f: Array, looked: _Looked, inverse: Array) -> Array:
        """Forces (3, C) by a linearised law, after f was looked at."""
        off = f - looked.projected  # by W off less than with f, and by ρ⁻¹ off more than the law has it
        moves = self._compliance * off
        moves -= self._W.dot(off.ravel()).reshape(f.shape)
        corrected: Array = inverse.dot(moves.ravel()).reshape(f.shape)
        corrected += looked.projected
        return corrected

    def inverse(self, looked: _Looked) -> Array:
        """The law linearised there: the matrix (3C, 3C), N s/m, by which velocities are multiplied.

        Raises:
            LinAlgError: there is none, or no friction: then it tells which pairs push, and others do.
        """
        if not self.friction:
            raise np.linalg.LinAlgError
        compliance, z, length, cone = self._compliance[0], looked.z, looked.length, looked.cone
        if self._normals is None:
            return linearised(self.operator, self.friction, compliance, z, length, cone).inverse()
        framed = FramedDelassus(self.operator.operator, Frames(np.ascontiguousarray(self._normals.T)), 0.0)
        (z,) = framed.frames.turned(z.T)
        return framed.in_lasting_axes(linearised(framed, self.friction, compliance, z, length, cone).inverse())


def follow(law: FollowedLaw, kept: KeptLaw) -> Solution | None:
    """What steps with the inverse of a law that was linearised before lead to; None where they do not.

    What the first of them lacks is of second order in what has changed since the last time step; where motion is
    steady it lacks the same in the next, or what it lacked goes on as it did, with what alternates in steps.

    Args:
        law: of now.
        kept: of the step before, if the same pairs took part.
    """
    q, speed, before = law.q, largest(np.abs(law.q)), np.inf
    inverse, found = kept.inverse, None
    if inverse is None or speed == 0:
        return None
    linear = inverse.dot((q - kept.q).ravel()).reshape(q.shape)
    linear += kept.forces
    f = linear + kept.lacking
    statuses = kept.statuses
    for step in range(_MOST_STEPS):
        looked = law.at(f)
        error = looked.error
        if error < before:
            found = looked
        if found is None:  # not a number
            return None
        if error <= CONVERGENCE_TOLERANCE * speed or before / 2 < found.error <= STAGNATION_RESIDUAL * speed:
            now = _to_keep(law, found, step, kept, statuses, inverse, linear)
            return Solution(found.projected, found.velocities, 0, found.error / speed, now)
        is_slow = not error < SLOWEST * before
        if law.friction and (is_slow or error > LOOKED_INTO * speed):
            others = statuses_of(looked.length, looked.cone)
            if others != statuses:
                if statuses != kept.statuses or _changed(others, statuses) > _MOST_CHANGED:
                    return None
                is_slow, statuses = True, others
        if is_slow:
            try:
                inverse = law.inverse(looked)
            except np.linalg.LinAlgError:
                return None
        before = error
        f = law.corrected(f, looked, inverse)
    return None


def _changed(statuses: bytes, others: bytes) -> int:
    """How many pairs do something else."""
    differ = np.frombuffer(statuses, dtype=bool) != np.frombuffer(others, dtype=bool)
    return int(np.count_nonzero(differ.reshape(2, -1).any(axis=0)))


def _to_keep(
    law: FollowedLaw, found: _Looked, step: int, kept: KeptLaw, statuses: bytes, inverse: Array, linear: Array
) -> KeptLaw:
    """After forces were found in so many corrections."""
    wear, forces = kept.worn(step), found.projected
    if kept.is_worn:
        wear = 0
        with suppress(np.linalg.LinAlgError):
            inverse = law.inverse(found)
    if inverse is not kept.inverse:
        linear = kept.forces + inverse.dot((law.q - kept.q).ravel()).reshape(forces.shape)
    lacking = kept.foreseen(forces - linear, step > 0 and inverse is kept.inverse)
    return KeptLaw(statuses, inverse, law.q, forces, *lacking, wear)
