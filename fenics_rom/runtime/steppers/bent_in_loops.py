"""What a body in a moving frame carries along that deforms largely, as compiled steps have it, and as NumPy has it."""

from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.contact import ContactSolution
from fenics_rom.rom.deformation import ReducedDeformation
from fenics_rom.runtime.compiled.bent_frame import IS_INVERSE_KNOWN, LACKED, WHOLE, Bending, Rims
from fenics_rom.runtime.compiled.carried_strains import AHEAD, GAP, HAS_TANGENT, MADE_TANGENT, strains_in
from fenics_rom.runtime.steppers.acts.following import FollowingLoads
from fenics_rom.runtime.steppers.adjoint import NONE
from fenics_rom.runtime.steppers.compiled_deformation import (
    branches_of,
    following_of,
    handed_on,
    law_of,
    memory_of,
    take_on,
)
from fenics_rom.runtime.steppers.deformation_maps import Carried
from fenics_rom.runtime.steppers.elastic.carried_strains import StrainsCarried

Ahead = tuple[Array, ...]  # T, and the inverse slopes that go with it: of a free body, and of its shape


class BentInLoops:
    """Of steps of h s.

    Args:
        body: its points.
        law: what resists its shape.
        loads: what follows it.
        origin: of the frame (3,), m.
        points: how many obstacles can touch.
        carried: by a base.
        h: s.

    Attributes:
        arrays: what compiled steps take.
        pressed_before: contact forces (P, 3) before the last step, N; None: there were none.
    """

    def __init__(
        self,
        body: ReducedDeformation,
        law: StrainsCarried,
        loads: FollowingLoads | None,
        origin: Array,
        points: int,
        carried: bool,
        h: float,
    ):
        m, memory = body.order, memory_of(body.order, branches_of(law))
        self._law, self._h, self._strains = law, h, strains_in(memory)
        free = 0 if carried else 3 + m
        self.arrays = Bending(
            law_of(body, law, h),
            following_of(loads, m, []),
            _rims_of(loads, m, origin),
            memory,
            np.zeros((4, m)),
            np.zeros(1),
            np.zeros((m, m)),
            np.zeros((free, free)),
            np.zeros(free),
            np.zeros((points, 3)),
            np.zeros(m),
            np.zeros_like(memory.carried),
            np.zeros_like(memory.numbers),
            np.zeros_like(memory.relaxed),
            np.zeros(9),
        )
        self._carried: Carried | None = None  # that loops go on from,
        self._tangent = NONE  # this,
        self._contact: ContactSolution | None = None  # and this
        self.pressed_before: Array | None = None

    def forget(self) -> None:
        """What is known ahead of a step."""
        self._carried, self._tangent, self.arrays.kept[IS_INVERSE_KNOWN] = None, NONE, 0.0

    def begin(self, contact: ContactSolution | None, ahead: Ahead | None) -> None:
        """Has a step go on from what the law carries along, and from contact in the last one.

        `ahead`: what NumPy knows with T; None: nothing, or it is that of loops.
        """
        law, arrays = self._law, self.arrays
        if not (law.carried is self._carried and law.tangent is self._tangent):
            take_on(self._strains, law, law.tangent)
            self._carried, self._tangent, arrays.kept[IS_INVERSE_KNOWN] = law.carried, law.tangent, 0.0
            if len(self._tangent):
                self._strains.tangent.ravel()[:: len(self._tangent) + 1] += 2 / self._h
            if ahead is not None and ahead[0] is self._tangent and len(arrays.slopes):
                arrays.slopes[:], arrays.inverse[:], arrays.kept[IS_INVERSE_KNOWN] = ahead[1], ahead[2], 1.0
        self.pressed_before = None if contact is None else contact.forces
        if contact is not self._contact:
            self.press(contact)

    def press(self, contact: ContactSolution | None) -> None:
        """Has the next step begin with contact in the last one."""
        self._contact, self.arrays.pressed[:] = contact, 0.0 if contact is None else contact.forces

    @property
    def inverse_tangent(self) -> Array:
        """T⁻¹ (m, m), with its inertia, of a body whose frame stands still; empty: T is to be made."""
        return self.arrays.inverse.copy() if len(self._tangent) else NONE

    def hand_on(self, q: Array, contact: ContactSolution | None) -> Ahead | None:
        """Has the law know what a step to q (m,) carries along; T of a free body with inverse slopes, if it has one."""
        strains, arrays, numbers = self._strains, self.arrays, self._strains.numbers
        self._carried, self._contact = handed_on(strains.velocity, strains.carried, numbers), contact
        has_tangent = bool(numbers.item(HAS_TANGENT))
        self._law.took(q, self._carried, strains.relaxed, (2 * numbers.item(AHEAD), numbers.item(GAP)), has_tangent)
        if not has_tangent:
            self._tangent = NONE
        elif numbers.item(MADE_TANGENT) or not len(self._tangent):
            self._tangent = self._without_inertia(strains.tangent)
        self._law.tell(strains.expected.copy(), self._without_inertia(strains.matrix))
        self._law.keep_tangent(self._tangent)
        if not (has_tangent and len(arrays.slopes)):
            return None
        return self._tangent, arrays.slopes.copy(), arrays.inverse.copy()

    def expected(self) -> tuple[Array, Array, Array, Array]:
        """How the last step was: what the balance lacked, by which T, v̂ that came of it, and velocities it was from."""
        arrays = self.arrays
        of_step = arrays.vectors[LACKED], arrays.inverse, arrays.vectors[WHOLE], arrays.guide
        lacked, T, whole, guide = (each.copy() for each in of_step)
        return lacked, T, whole, guide

    @property
    def velocity_before(self) -> Array:
        """v̂ (m,) that the last step began with."""
        return self.arrays.velocity_before

    @property
    def felt(self) -> tuple[Any, ...]:
        """Acceleration, angular acceleration and spin in the last step; None of what strains nothing."""
        return self.motions(self.arrays.felt)

    def motions(self, felt: Array) -> tuple[Any, ...]:
        """The same of nine numbers."""
        a, α, spin = map(tuple, felt.reshape(3, 3).tolist())
        return (None, None, spin) if len(self.arrays.guide) else (a, α, spin)

    def _without_inertia(self, matrix: Array) -> Array:
        bare = matrix.copy()
        bare.ravel()[:: len(bare) + 1] -= 2 / self._h
        return bare


def _rims_of(loads: FollowingLoads | None, m: int, origin: Array) -> Rims:
    """Edges of open surfaces under pressure, as arrays."""
    rims = [] if loads is None else loads.rims
    columns, starts = np.array([column for column, _ in rims], dtype=np.int64), [len(rim.points) for _, rim in rims]
    at_rest = [np.stack([rim.points - origin, rim.pieces]) for _, rim in rims]
    shapes = [np.stack([rim.shapes, rim.piece_shapes]).reshape(2, -1, 3, m) for _, rim in rims]
    return Rims(
        columns,
        np.cumsum([0, *starts]),
        np.concatenate([np.empty((2, 0, 3)), *at_rest], axis=1),
        np.concatenate([np.empty((2, 0, 3, m)), *shapes], axis=1).transpose(3, 0, 1, 2).copy(),
    )
