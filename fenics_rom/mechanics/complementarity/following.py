"""Contact forces by the law as it was linearised in an earlier step, without a search.

Where normals turn with the points, all is along the axes of space, in which W stays the same, and
P(z) = z_n⁺ n + z_t min(1, μ z_n⁺/|z_t|) with z = f - ρ u is taken apart by the normals (see `frictional`); where all
normals are alike, in their frame. What the law was linearised to is kept as the matrix by which it multiplies
velocities. Steps with it are products, and each is looked at by the law itself.
"""

from contextlib import suppress
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.complementarity.delassus import FramedDelassus, Frames
from fenics_rom.mechanics.complementarity.frictional import look_at
from fenics_rom.mechanics.complementarity.linearised import linearised
from fenics_rom.mechanics.complementarity.solution import (
    CONVERGENCE_TOLERANCE,
    REGULAR_SHARE,
    STAGNATION_RESIDUAL,
    KeptLaw,
    Solution,
    largest,
    statuses_of,
)

_ONES = np.ones(3)
_MOST_STEPS = 6  # with a kept inverse, before Newton's method
_MOST_CORRECTIONS = 6  # by an inverse, in all steps: they take as long as to find it anew
_SLOWEST = 3e-3  # reduction of the error by such a step: where it is less, the inverse is found anew
_LOOKED_INTO = 1e-5  # error, as a share of the velocities, at which pairs may do something else
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
        framed: W in frames of these, if that is there.
    """

    def __init__(
        self,
        operator: FramedDelassus,
        q: Array,
        friction: float,
        normals: Array | None,
        framed: FramedDelassus | None = None,
    ):
        self._framed = framed
        self.operator, self.q, self.friction, self._normals = operator, q, friction, normals
        self._ρ, self._compliance = operator.scaled(REGULAR_SHARE)

    def at(self, f: Array) -> _Looked:
        """Looks at forces f (3, C)."""
        u = self.operator.moved(f)
        u += self.q
        if self._normals is None and not self.friction:
            z = f - self._ρ * u
            projected = np.zeros(f.shape)
            np.maximum(z[0], 0.0, projected[0])
            return _Looked(u, z, z[1], z[2], projected, largest(np.abs((f[0] - projected[0]) * self._compliance)))
        if self._normals is None:
            return _Looked(u, *look_at(f, u, self._ρ, self._compliance, self.friction))
        z = f - self._ρ * u
        pressure = _ONES.dot(z * self._normals)
        normal = pressure * self._normals
        across = z - normal
        length, cone = np.sqrt(_ONES.dot(across * across)), self.friction * pressure
        if not largest(length >= cone):  # all stick
            return _Looked(u, z, length, cone, z, largest(np.abs(u)))
        if pressure.item(pressure.argmin()) < 0.0:
            np.maximum(cone, 0.0, cone)
            normal = np.maximum(pressure, 0.0) * self._normals
        across *= cone / (np.maximum(length, cone) + 1e-300)
        across += normal
        return _Looked(u, z, length, cone, across, largest(np.abs((f - across) * self._compliance)))

    def corrected(self, f: Array, looked: _Looked, inverse: Array) -> Array:
        """Forces (3, C) by a linearised law, after f was looked at."""
        off = f - looked.projected  # by W off less than with f, and by ρ⁻¹ off more than the law has it
        moves = self._compliance * off - self.operator.moved(off)
        corrected: Array = looked.projected + inverse.dot(moves.ravel()).reshape(f.shape)
        return corrected

    def inverse(self, looked: _Looked) -> Array:
        """The law linearised there: the matrix (3C, 3C), N s/m, by which velocities are multiplied.

        Raises:
            LinAlgError: there is none, or no friction: then it tells which pairs push, and others do.
        """
        if not self.friction:
            raise np.linalg.LinAlgError
        framed, z = self.operator, looked.z
        if self._normals is not None:
            framed = self._framed or framed.operator.framed(Frames(self._normals.T.copy()))
            framed.are_kept = True
            (z,) = framed.frames.turned(z.T)
        there = linearised(framed, self.friction, self._compliance, z, looked.length, looked.cone)
        return framed.in_lasting_axes(there.inverse())


def follow(law: FollowedLaw, last: KeptLaw) -> Solution | None:
    """What steps with the inverse of a law that was linearised before lead to; None where they do not.

    What the first of them lacks is of second order in what has changed since the last time step; where motion is
    steady it lacks the same in the next, or what it lacked goes on as it did, with what alternates in steps.

    Args:
        law: of now.
        last: of the step before, if the same pairs took part.
    """
    q, kept = law.q, last.nearest(law.q)
    inverse, found = kept.inverse, None
    if inverse is None:
        return None
    linear = kept.forces + inverse.dot((q - kept.q).ravel()).reshape(q.shape)
    f, speed, before = linear + kept.lacking, largest(np.abs(q)), np.inf
    statuses = kept.statuses
    for step in range(_MOST_STEPS):
        looked = law.at(f)
        error = looked.error
        if error < before:
            found = looked
        if found is None:  # not a number
            return None
        if error <= CONVERGENCE_TOLERANCE * speed or before / 2 < found.error <= STAGNATION_RESIDUAL * speed:
            now = _to_keep(law, found, before, step, last, kept, statuses, inverse, linear)
            return Solution(found.projected, found.velocities, 0, found.error / speed, now)
        is_slow = not error < _SLOWEST * before
        if law.friction and (is_slow or error > _LOOKED_INTO * speed):
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
    law: FollowedLaw,
    found: _Looked,
    before: float,
    step: int,
    last: KeptLaw,
    kept: KeptLaw,
    statuses: bytes,
    inverse: Array,
    linear: Array,
) -> KeptLaw:
    """After forces were found in so many corrections, of which the last began with an error of `before`."""
    corrections, forces = kept.corrections + step, found.projected
    if corrections >= _MOST_CORRECTIONS and found.error > _SLOWEST * before:
        corrections = 0
        with suppress(np.linalg.LinAlgError):
            inverse = law.inverse(found)
    if inverse is not kept.inverse:
        linear = kept.forces + inverse.dot((law.q - kept.q).ravel()).reshape(forces.shape)
    lacking = kept.foreseen(forces - linear, step > 0 and inverse is kept.inverse)
    now = KeptLaw(statuses, inverse, law.q, forces, *lacking, corrections)
    if kept is not last or inverse is not kept.inverse:
        return now.after(last)
    return now._replace(earlier=last.earlier) if step else now  # where the last one does at once, it is enough
