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

from fenics_rom.mechanics.complementarity import Delassus, FollowedLaw, Frames, Solution, follow
from fenics_rom.mechanics.complementarity.solution import largest
from fenics_rom.mechanics.contact import ContactLaw, ContactSearch
from fenics_rom.mechanics.contact_pairs import WORK_ROUND_OFF, Asked

_ONES = np.ones(3)


class Followed(NamedTuple):
    """What a step has that was followed."""

    key: bytes  # of which pairs take part
    active: Array  # (C,) these
    operator: Delassus  # theirs
    frames: Frames  # theirs
    solution: Solution  # theirs, in axes that last
    forces: Array  # of all pairs, (O P, 3), N
    power: float | None  # Σ λ s, W; None without friction


def follow_contact(
    law: ContactLaw,
    search: ContactSearch,
    free: Array,
    relative: Array,
    frames: Frames,
    asked: Asked,
    slides: bool,
    operators: Callable[[Array, bytes], tuple[Array, Delassus]],
    moved: Callable[[Array], Array],
) -> Followed | None:
    """A step; None where some pair does something else than in the step before.

    Args:
        law: of contact.
        search: what the step before left.
        free: relative mid-step velocity of all pairs without contact, (O P, 3), m/s.
        relative: relative velocity at the start of the step, (O P, 3), m/s.
        frames: of all pairs.
        asked: what the normal law says, from n·relative (O P,).
        slides: whether what sticks is to stop within the step.
        operators: gives, of those that take part (O P,), and of their key, which they are (C,), and their operator.
        moved: gives the velocities (O P, 3), m/s, that forces of all pairs cause.
    """
    free, relative = frames.to_lasting_axes(free, relative)
    n = frames.lasting_normals
    approach, outwards = (relative[0], free[0]) if n is None else (_ONES.dot(relative * n), _ONES.dot(free * n))
    level, target, compliance = asked(approach)
    chosen = outwards < level
    key = chosen.tobytes()
    kept = search.law_of(key)
    if kept is None or not kept.has_inverse:
        return None
    active, operator = operators(chosen, key)
    own, are_all = frames, len(active) == len(chosen)
    if not are_all:
        own, target, approach = frames.of(active), target.take(active), approach.take(active)
        free, relative = free.take(active, axis=1), relative.take(active, axis=1)
        if n is not None:
            n = own.lasting_normals
            if n is None:
                free, relative = own.turned(free.T, relative.T)
    if compliance and n is not None:
        return None
    targets = relative * 0.5 if slides else np.zeros(relative.shape)  # c n and c_t
    if n is None:
        targets[0] = target
    else:
        targets += (target - 0.5 * approach if slides else target) * n
    q = free - targets
    solution = follow(FollowedLaw(operator.lasting(own, compliance), q, law.friction, n), kept)
    if solution is None:
        return None
    f, u = solution[:2]
    power = None
    if law.friction:
        λ, closing = (f[0], u[0]) if n is None else (_ONES.dot(f * n), _ONES.dot(u * n))
        closing = closing + target
        power = float(λ.dot(closing - compliance * λ if compliance else closing))
        by_friction = f.ravel().dot(targets.ravel()) - λ.dot(target)  # see contact_pairs.helping_pairs
        if by_friction > 0 and by_friction > WORK_ROUND_OFF * largest(np.abs(f)) * largest(np.abs(q)):
            return None
    forces = own.from_lasting_axes(f)
    if not are_all:
        forces, among = np.zeros((len(chosen), 3)), forces
        forces[active] = among
        if largest((frames.along_normals(moved(forces)) + outwards < level) > chosen):
            return None  # one is missed
    return Followed(key, active, operator, own, solution, forces, power)
