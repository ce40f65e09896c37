"""Forces of a step by compiled loops, where numba is; those that these do not find are `find_forces`'."""

from collections.abc import Sequence

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import or_numpy
from fenics_rom.mechanics.braking import SWINGS, swung_with
from fenics_rom.mechanics.compiled.contact_law import OTHERWISE, Law, pairs_from
from fenics_rom.runtime.steppers.compiled_step import inverse_of
from fenics_rom.world.compiled.forces import Contacts, find_forces
from fenics_rom.world.compiled.rigid_bodies import RigidBodies
from fenics_rom.world.contact_step import Found, Pairs, Part, add_operator
from fenics_rom.world.rigid import Rigid

_UNKNOWN = np.empty((0, 0))  # inverse of an operator
LONGEST_PAUSE = 64  # steps, in which what loops did not find again and again is not asked of them


class CompiledForces:
    """Of bodies that touch at the same points as long as this is used, without joints.

    Args:
        parts: theirs.
        friction: of the C contacts.
    """

    def __init__(self, parts: Sequence[Part], friction: Array):
        C = len(friction)
        self._rigid = [part for part in parts if isinstance(part.body, Rigid)]
        self._others = [part for part in parts if not isinstance(part.body, Rigid)]
        self._ends, self._yields = np.full((C, 2), -1), np.zeros(C, dtype=bool)
        for number, part in enumerate(self._rigid):
            self._ends[part.pairs, (part.signs[:, 0] < 0).astype(int)] = number
        for part in self._others:
            self._yields[part.pairs] |= part.body.yields
        self._bodies = [part.body for part in self._rigid if isinstance(part.body, Rigid)]
        self._mass = np.array([body.mass for body in self._bodies])
        self._inertia = np.array([body.inertia for body in self._bodies]).reshape(-1, 3, 3)
        self._inverse: Array | None = None  # of the operator; None where it was another one in the step before
        self._of_parts, self._operator = list[Array | None](), np.zeros((3 * C, 3 * C))
        self._friction, self._most = friction, float(friction.max(initial=0.0))
        self._pause = self._waits = 0

    @or_numpy
    def find(self, pairs: Pairs, h: float, start: Array) -> Found | None:
        """Forces of a step of h s that the bodies have begun, who know them then; None where loops do not find them."""
        if self._waits:
            self._waits -= 1
            return None
        begun = self._begin(pairs)
        if begun is None:
            return None
        free, speed, swung = *begun, np.zeros(len(start), dtype=np.int64) if pairs.swung is None else pairs.swung
        asked = pairs.restitution, pairs.are_rigid, pairs.yield_at_once, pairs.out
        contacts = Contacts(
            self._ends, pairs.places, pairs.before, pairs.normals, pairs.gaps, *asked, self._yields, swung
        )
        law, found = Law(h, 0.0, self._most, 0.0, 0.0, False, SWINGS), pairs_from(start, self._friction)
        B = len(self._bodies)
        rotation, motion = np.empty((2, B, 3, 3))
        bodies = RigidBodies(self._mass, self._inertia, rotation, motion, np.empty((B, 2, 3)))
        for b, body in enumerate(self._bodies):
            bodies.rotation[b], bodies.motion[b], bodies.loads[b] = body.begun
        inverse = _UNKNOWN if self._inverse is None else self._inverse
        tries, u = np.empty((B, 4, 3)), np.empty(free.shape)
        status, sweeps = find_forces(law, contacts, bodies, free, self._operator, inverse, speed, found, tries, u)
        if status == OTHERWISE:
            self._pause = min(2 * self._pause + 1, LONGEST_PAUSE)
            self._waits = self._pause
            return None
        self._pause = 0
        for body, of_body in zip(self._bodies, tries, strict=True):
            body.accept(*of_body)
        for part in self._others:
            part.body.accept_forces(part.points, pairs.places[part.rows], part.signs * found.forces[part.rows])
        return Found(found.forces, u, sweeps, 0.0, swung_with(found.helped, swung) if found.helped.any() else None)

    def _begin(self, pairs: Pairs) -> tuple[Array, float] | None:
        """Velocities of pairs without forces by all but rigid bodies that move freely, and the fastest, m/s.

        None where one of these bodies answers forces in no known way.
        """
        free, speed, of_parts = np.zeros(pairs.places.shape), 0.0, list[Array | None]()
        for part in self._others:
            known = part.body.known_answer(part.points, pairs.places[part.rows])
            if known is None:
                return None
            velocities, operator = known
            free[part.rows] += part.signs * velocities
            speed = max(speed, float(np.abs(velocities).max(initial=0.0)))
            of_parts.append(operator)
        if any(now is not then for now, then in zip(of_parts, self._of_parts or [None], strict=False)):
            self._inverse, self._operator = None, np.zeros(self._operator.shape)
            for part, operator in zip(self._others, of_parts, strict=True):
                if operator is not None and len(part.pairs):
                    add_operator(self._operator, part, operator)
        elif self._inverse is None:
            self._inverse = inverse_of(self._operator) if self._yields.all() else _UNKNOWN
        self._of_parts = of_parts
        return free, speed


def compiled_forces(pairs: Pairs) -> CompiledForces | None:
    """What finds the forces of such pairs; None where there are joints among them, or nothing."""
    if not len(pairs.gaps) or len(pairs.places) > len(pairs.gaps):
        return None
    return CompiledForces(pairs.parts, pairs.friction)
