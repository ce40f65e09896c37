"""Contact of a step in which all pairs do what they did in the step before: it takes no search.

As long as the same points meet the same obstacles, and each of them is open, sticks or slips as it did, the law is the
one that was linearised (`complementarity.KeptLaw`). All that is asked of pairs is then asked in a few operations, and
forces are found by products. They are looked at as those of a search are, to the same tolerance; where they do not
pass, there is a search.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.braking import WORK_ROUND_OFF
from fenics_rom.mechanics.complementarity import Delassus, FollowedLaw, Frames, KeptLaw, Solution, follow
from fenics_rom.mechanics.complementarity.solution import is_none, largest
from fenics_rom.mechanics.contact import ContactLaw
from fenics_rom.mechanics.contact_pairs import Asked, NormalLaw
from fenics_rom.mechanics.contact_search import ContactSearch

_ONES, _HALF = np.ones(3), np.array(0.5)


class PairsMotion(NamedTuple):
    """What all pairs of a point and an obstacle do in one step without contact, in axes that last (see Frames)."""

    frames: Frames
    normals: Array | None  # (3, O P); None where all are the first of the axes
    asked: NormalLaw  # of all pairs
    outwards: Array  # mid-step velocity along the normals, (O P,), m/s
    free: Array  # mid-step velocity less `sliding`, (3, O P), m/s
    sliding: Array | None  # half the velocity at the start, c_t and `across`, (3, O P), m/s; None where nothing slides
    across: Array | None  # along the normals of that, (O P,), m/s; None where it was left out

    @classmethod
    def of(cls, frames: Frames, free: Array, relative: Array, asked: Asked, slides: bool) -> "PairsMotion":
        """From mid-step velocities without contact and velocities at the start, (O P, 3), m/s.

        Args:
            frames: of all pairs.
            free, relative: these.
            asked: what the normal law says.
            slides: whether what sticks is to stop within the step.
        """
        n = frames.lasting_normals
        free, relative = frames.to_lasting_axes(free, relative)
        approach, outwards = (relative[0], free[0]) if n is None else (_ONES.dot(relative * n), _ONES.dot(free * n))
        if not slides:
            return cls(frames, n, asked(approach, outwards), outwards, free, None, None)
        sliding, across = _HALF * relative, None if n is None else _HALF * approach
        if n is None:
            sliding[0] = 0.0
        return cls(frames, n, asked(approach, outwards), outwards, free - sliding, sliding, across)

    def among(self, pairs: Array) -> "PairsMotion":
        """Of some pairs (C,), but for `outwards` and the level that is asked, which stay those of all."""
        (level, target, compliance), sliding, n = self.asked, self.sliding, self.normals
        asked = NormalLaw(level, target.take(pairs), compliance)
        frames, outwards, free = self.frames.of(pairs), self.outwards, self.free.take(pairs, axis=1)
        if sliding is not None:
            sliding = sliding.take(pairs, axis=1)
        if n is None:
            return PairsMotion(frames, None, asked, outwards, free, sliding, None)
        across, n = None if self.across is None else self.across.take(pairs), frames.lasting_normals
        if n is None:  # alike, other than those of all
            (free,) = frames.turned(free.T)
            free[0] = outwards.take(pairs)
            if sliding is not None:
                (sliding,) = frames.turned(sliding.T)
                sliding[0] = 0.0
            across = None
        return PairsMotion(frames, n, asked, outwards, free, sliding, across)


class LawToFollow(NamedTuple):
    """The law of those pairs that take part in a step, as an earlier step left it."""

    chosen: Array  # (O P,) which
    key: bytes  # the same
    kept: KeptLaw

    @classmethod
    def of(cls, search: ContactSearch, chosen: Array) -> "LawToFollow | None":
        """That of those that take part (O P,), by what earlier steps left; None where these tell nothing of them."""
        key = chosen.tobytes()
        kept = search.law_of(key)
        return None if kept is None or kept.inverse is None else cls(chosen, key, kept)


class Followed(NamedTuple):
    """What a step has that was followed."""

    key: bytes  # of which pairs take part
    active: Array  # (C,) these
    operator: Delassus  # theirs
    solution: Solution  # theirs, in axes that last
    forces: Array  # of all pairs, (O P, 3), N
    power: float | None  # Σ λ s, W; None without friction
    are_framed: bool = False  # whether what the solution has is in their frames
    missed: Array | None = None  # (O P,) other pairs, which forces on these bring too near; None: there are none


def follow_contact(
    law: ContactLaw,
    given: LawToFollow,
    motion: PairsMotion,
    operators: Callable[[Array, bytes], tuple[Array, Delassus]],
    moved: Callable[[Array], Array],
) -> Followed | None:
    """A step; None where some pair does something else than in the step before.

    Args:
        law: of contact.
        given: what an earlier step left.
        motion: what pairs do.
        operators: gives, of those that take part (O P,), and of their key, which they are (C,), and their operator.
        moved: gives the velocities (O P, 3), m/s, that forces of all pairs cause.
    """
    frames, level, outwards, (chosen, key, kept) = motion.frames, motion.asked.level, motion.outwards, given
    active, operator = operators(chosen, key)
    are_all = len(active) == len(chosen)
    own, n, (_, target, compliance), _, q, sliding, across = motion if are_all else motion.among(active)
    if compliance and n is not None:
        return None
    if n is None:
        q = q.copy()
        q[0] -= target
    else:
        q = q - (target if across is None else target - across) * n
    solution = follow(FollowedLaw(operator.lasting(own, compliance), q, law.friction, n), kept)
    if solution is None:
        return None
    f, u = solution[:2]
    power = None
    if law.friction:
        λ, closing = (f[0], u[0]) if n is None else (_ONES.dot(f * n), _ONES.dot(u * n))
        power = float(λ.dot(closing - compliance * λ if compliance else closing) + λ.dot(target))
        if sliding is not None:
            by_friction = f.ravel().dot(sliding.ravel())  # see Braking.asks_less
            if across is not None:
                by_friction -= λ.dot(across)
            if by_friction > 0 and by_friction > WORK_ROUND_OFF * largest(np.abs(f)) * largest(np.abs(q)):
                return None
    forces = own.from_lasting_axes(f)
    if not are_all:
        forces, among = np.zeros((len(chosen), 3)), forces
        forces[active] = among
        missed = (frames.along_normals(moved(forces)) + outwards < level) > chosen
        if not is_none(missed):
            return Followed(key, active, operator, solution, forces, power, missed=missed)
    return Followed(key, active, operator, solution, forces, power)
