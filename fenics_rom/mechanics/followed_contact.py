"""Contact of a step in which all pairs do what they did in the step before: it takes no search.

As long as the same points meet one obstacle at rest, and each of them is open, sticks or slips as it did, the law is
the one that was linearised (`complementarity.KeptLaw`). All that is asked of pairs is then asked in a few operations,
and forces are found by products. They are looked at as those of a search are, to the same tolerance; where they do not
pass, there is a search.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.complementarity import Delassus, Frames, Solution, follow
from fenics_rom.mechanics.complementarity.solution import largest
from fenics_rom.mechanics.contact import ContactLaw, ContactSearch, PointMotion
from fenics_rom.mechanics.contact_pairs import WORK_ROUND_OFF


class Followed(NamedTuple):
    """What a step has that was followed."""

    key: bytes  # of which pairs take part
    active: Array  # (C,) these
    operator: Delassus  # theirs
    solution: Solution  # theirs
    forces: Array  # of all pairs, (P, 3), N
    power: float | None  # Σ λ s, W; None without friction


class FollowedContact:
    """Steps of dt, s, of P points that meet an obstacle at rest by the rigid law."""

    def __init__(self, law: ContactLaw, P: int, dt: float):
        self.dt, self._μ, e = dt, law.friction, law.restitution
        # Arrays, as numbers would be made such in every step.
        self._rate, self._half, self._share = (np.full(P, x) for x in (-1 / dt, (1 - e) / 2, 1 / (2 - e)))
        self._halves, self._zeros = np.full((3, P), 0.5 if self._μ else 0.0), np.zeros(P)

    def step(
        self,
        points: PointMotion,
        gaps: Array,
        gap: float,
        frames: Frames,
        are_kept: bool,
        search: ContactSearch,
        operators: Callable[[Array, bytes], tuple[Array, Delassus]],
        delassus: Array,
    ) -> Followed | None:
        """A step; None where some pair does something else than in the step before.

        Args:
            points: what the contact points do, and would do without contact.
            gaps: (P,), m; `gap` is the smallest.
            frames: of the pairs; `are_kept`: those of the step before.
            search: what that left.
            operators: gives, of those that take part (P,), and of their key, which they are (C,), and their operator.
            delassus: W (3P, 3P) of all points, m/s/N.
        """
        free, relative = frames.turned(points.free_velocity, points.velocity)
        closing, half = gaps * self._rate, relative[0] * self._half
        level = np.maximum(closing, (closing + half) * self._share)  # all as in contact_pairs.normal_law
        chosen = free[0] < level
        key = chosen.tobytes()
        kept = search.law_of(key)
        if kept is None or not kept.has_inverse:
            return None
        if gap < 0.0:
            np.maximum(half, closing - np.abs(relative[0]), half)
        targets, (active, operator) = relative * self._halves, operators(chosen, key)
        np.minimum(half, self._zeros, targets[0])
        q, own, are_all = free - targets, frames, len(active) == len(gaps)
        if not are_all:
            own, q, targets = frames.of(active), q.take(active, axis=1), targets.take(active, axis=1)
        solution = follow(operator.framed(own, are_kept=are_kept), q, self._μ, kept)
        if solution is None:
            return None
        f, u = solution[:2]
        by_friction = f[1:].ravel().dot(targets[1:].ravel())  # see contact_pairs.helping_pairs
        if by_friction > 0 and by_friction > WORK_ROUND_OFF * largest(np.abs(f)) * largest(np.abs(q)):
            return None
        forces = own.in_space(f)
        if not are_all:
            forces, among = np.zeros((len(gaps), 3)), forces
            forces[active] = among
            (moved,) = frames.turned(delassus.dot(forces.ravel()).reshape(-1, 3))
            if largest((moved[0] + free[0] < level) > chosen):
                return None  # one is missed
        power = float(f[0].dot(u[0] + targets[0])) if self._μ else None
        return Followed(key, active, operator, solution, forces, power)
