"""What a search for contact forces begins with: all that a solver keeps of the steps before.

Apart from `contact`, so that bodies that nothing touches start without what finds forces.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.complementarity import Frames, KeptLaw
from fenics_rom.mechanics.contact import ContactResidual, HeldBack

MANY = 64  # points that are near
_MOST_SETS = 3  # of pairs that took part, of which laws are kept: points that slide on what is round hop


PUSHING = 1e-9  # of the largest force: what is less may be round-off, which is another with each CPU


def pushing(forces: Array) -> Array:
    """Which sizes of forces (P, ...) are those of pairs that push, beside the largest of all pairs, (1, ...)."""
    return forces > PUSHING * forces.max(axis=0)


def near_points(gaps: Array, reach: float, forces: Array) -> Array:
    """Points that need forces in a step, or would if they went twice as fast; none where no point needs any.

    Of many these are the nearest ones, and those that were pushed before: others may need forces, too.

    Args:
        gaps: of points (P,), m.
        reach: with which a point may need forces at most, m.
        forces: of pairs in the step before (N, 3), obstacle after obstacle.
    """
    if gaps.min() > reach:
        return np.empty(0, dtype=int)
    near = np.flatnonzero(gaps <= 2 * reach)
    if len(near) <= MANY:
        return near
    pushed = forces.any(axis=1).nonzero()[0] % len(gaps)
    return np.union1d(near[np.argpartition(gaps[near], MANY)[:MANY]], pushed)


class TangentPlanes(NamedTuple):
    """Of a round obstacle at points (P,) that hardly move: to round-off it is as flat."""

    places: Array  # of the points, (P, 3), m, as seen from where the obstacle was at rest
    gaps: Array  # there, (P,), m
    frames: Frames  # along the normals there


class FaceSlots(NamedTuple):
    """Which pairs were those of obstacles and faces of a body, of O obstacles with P pairs each."""

    keys: Array  # (O, P) of what met what, as of `body_faces.Places`; -1 of none so far
    at: Array  # (O, P, 3) where, m


class ContactSearch(NamedTuple):
    """What a search for contact forces begins with: all that a solver keeps of the past; not to be changed."""

    forces: Array  # the last ones of all pairs (O P, 3), obstacle after obstacle, N
    residual: ContactResidual = ContactResidual()
    laws: tuple[tuple[bytes, KeptLaw], ...] = ()  # of those pairs that took part then, and of others before them
    frames: Frames | None = None  # of all pairs then
    is_steady: bool = False  # whether that step took no search
    unturned: int = 0  # number of steps before it that took none, either, had these frames and left no planes
    planes: TangentPlanes | None = None  # where points have not moved since they were taken
    swung: Array | None = None  # (O P,) in how many steps in a row friction did not stop pairs; None: in none
    known_to_push: Array | None = None  # (O P,) which pairs pushed, where `forces` do not tell
    slots: FaceSlots | None = None  # of a body that obstacles meet at its faces; None: nothing did
    held: HeldBack = HeldBack()  # steps in which points were held before obstacles

    @property
    def pushed(self) -> Array:
        """Which pairs (O P,) pushed one another in the last step."""
        return pushing(np.abs(self.forces).max(axis=1)) if self.known_to_push is None else self.known_to_push

    @property
    def forces_before(self) -> Array:
        """Forces (O P, 3) of the last step, N; where these do not tell who pushed, 1 N of those that did."""
        known = self.known_to_push
        return self.forces if known is None else np.repeat(known[:, None].astype(float), 3, axis=1)

    @property
    def messages(self) -> tuple[str, ...]:
        """What the user should know of the run so far; empty ones say nothing."""
        return self.residual.message, self.held.message

    def law_of(self, key: bytes) -> KeptLaw | None:
        """The law of those pairs of which the key tells that they take part, as booleans."""
        for known, law in self.laws:
            if known == key:
                return law
        return None

    def frames_along(self, normals: Array) -> Frames:
        """Of all pairs, (O P, 3): those of then, where the normals are the same."""
        return Frames(normals) if self.frames is None or not self.frames.are_along(normals) else self.frames

    def beside(self, key: bytes, law: KeptLaw | None) -> "ContactSearch":
        """The same with the law of those pairs that were followed first, whose forces bring others too near."""
        return self._replace(laws=self.with_law(key, law))

    def with_law(self, key: bytes, law: KeptLaw | None) -> tuple[tuple[bytes, KeptLaw], ...]:
        """`laws`, with that of pairs that have taken part now, and of other sets: of points that hardly touch."""
        if law is not None and self.laws and self.laws[0][0] == key:
            if self.laws[0][1] is law:
                return self.laws
            return (key, law), *self.laws[1:]
        others = [known for known in self.laws if known[0] != key]
        return (*([] if law is None else [(key, law)]), *others[: _MOST_SETS - 1])
