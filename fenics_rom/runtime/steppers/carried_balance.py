"""What a step of a carried body balances, see `carried_frame`: A r̂ = right, with f̂ in both.

It is one linear system where f̂ is exact as the shape's law gives it; else Newton's method.
"""

import math
from collections.abc import Callable
from functools import partial
from struct import Struct
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.frame_geometry import Push
from fenics_rom.mechanics.frame_motion import ZERO, Rotation, Vector, added, cross, dot
from fenics_rom.runtime.steppers.carried_base import Begun, Motion
from fenics_rom.runtime.steppers.differentiable_frame import DifferentiableFrame
from fenics_rom.runtime.steppers.expected_step import Expected
from fenics_rom.runtime.steppers.frame_state import Shape
from fenics_rom.runtime.steppers.frame_table import MOMENTS, TURNED
from fenics_rom.runtime.steppers.inertia import MOST_ITERATIONS, pairs

Wrench = tuple[Vector, Vector]
NO_TURN = 1e-18  # rad: by less coordinates are not coupled, as |G| <= 1 and |I2| <= 1 beside 2/h are below the last bit


class CarriedBalance(DifferentiableFrame):
    """Arguments and attributes as in FrameKernel."""

    def __init__(self, *args: Any, **named: Any):
        super().__init__(*args, **named)
        self.notes |= {"misfit": 0.0, "misfit of turn": 0.0}
        self._wrench: Wrench | Callable[[], Wrench] = (ZERO, ZERO)  # or how it is found, as not everyone asks
        self._wrench_before: Wrench | Callable[[], Wrench] = self._wrench
        self._sum = self._table[MOMENTS.start : TURNED.stop]  # what a step begins with is a sum of
        self._factors, self._coefficients = np.empty(len(self._sum)), np.empty(len(self._products))
        self._set_factors, self._set_coefficients = (
            partial(Struct(f"{len(numbers)}d").pack_into, numbers.data, 0)
            for numbers in (self._factors, self._coefficients)
        )
        self._inverse: Array | None = None
        self._A: Array | None = None  # the last one that couples all coordinates, and where
        self._coupled_at: tuple[float, ...] = ()
        self._taken: Begun | None = None
        self._free = np.empty(0)
        self._inside_of: tuple[Array, bytes, Array] | None = None  # A, points, and their answer in the frame's axes
        self._answered: tuple[tuple[Any, ...], Array] | None = None  # how the frame turns, and the same in the world's
        self._size = (sum(self._inertia0[:3]) / 2 / self._mass) ** 0.5
        self.resume(np.empty(0))

    def _motion_told(self, q: Array, R: Rotation, shape: Shape, moving: list[float]) -> Motion:
        """As in FrameKernel."""
        x, y, z, a, b, c, *momenta = moving
        i, j, k, u, v, w = momenta
        return Motion(q, shape, R, (x, y, z), (a, b, c), (i, j, k), (u, v, w))

    def _strained(self, step: Begun) -> Array:
        """r̂ (m,) of a step without contact whose A and right-hand side lack f̂, which are completed."""
        elastic = self.elastic
        assert elastic is not None
        v, self._inverse = elastic.velocity.copy(), None
        self._take_matrix(v)
        if not elastic.is_exact:
            self._completed(step, step.right - self._resists(v, v))
            return self._iterated(v)
        lack = step.A.dot(v) + self._matrix.dot(v) - step.right + self._resists(v, v)
        if self.contact is not None:  # what touched in the step before touches
            lack -= self.points.rows.dot(self.contact.forces.dot(step.turn.middle).ravel())
        if self._ahead is None or self._ahead[0] is not step.A or self._ahead[1] is not self._matrix:
            try:
                self._ahead = step.A, self._matrix, np.linalg.inv(step.A + self._matrix)
            except np.linalg.LinAlgError:
                self._ahead = step.A, self._matrix, np.zeros_like(step.A)
        v -= self._ahead[2].dot(lack)
        pressed = None if self.contact is None else self.contact.forces
        self.expectation = Expected(self._acting, step.forces, pressed, lack, self._ahead[2], v)
        v = elastic.expect(v)
        self._take_matrix(v)
        self._followed_at = v
        self._completed(step, step.right - self._resists(v, v))
        assert self._taken is not None
        return self._solved(self._taken.A, self._taken.right)

    def _completed(self, step: Begun, right: Array) -> None:
        self._bare, self._taken = step, step._replace(A=step.A + self._matrix, right=right)

    def _iterated(self, v: Array) -> Array:
        """The r̂ (m,) of the step by Newton's method from v, which is overwritten."""
        left = self.newton.solve(v, self._lack, self._slope, self.size, self.scale, self.round_off)
        if left:
            rest = f"after {MOST_ITERATIONS} iterations {left:.1e} of the velocities is left"
            raise StepError(
                f"no step of {self.h:g} s was found that bends the body as it does: "
                f"{rest if math.isfinite(left) else 'iterations diverge'}; a smaller dt, or less force, is the cure"
            )
        return v

    def _lack(self, v: Array) -> Array:
        """What the balance lacks at v (m,) without contact."""
        if self.elastic is not None and not self.elastic.is_exact:
            self._completed(self._bare, self._bare.right - self._resists(v, v))
        assert self._taken is not None
        lack: Array = self._taken.A.dot(v) - self._taken.right
        return lack

    def _slope(self, v: Array) -> Array:
        """A of v (m,)."""
        elastic = self.elastic
        assert elastic is not None
        elastic.renew(v)
        self._take_matrix(v)
        self._completed(self._bare, self._bare.right - self._resists(v, v))
        assert self._taken is not None
        return self._taken.A

    def act(self, z: Array) -> None:
        """As in FrameBody of mechanics.frame_contact."""
        assert self.found is not None
        step = self._taken if self.elastic is None else self._bare
        assert step is not None
        self._acting, self.reactions_found = self.found.acting(z), z
        forces = self._forces_as_expected()
        modal = self._loads.modal(forces, step.turn, self._constants)
        step = step._replace(forces=forces, modal=modal, right=step.right + modal - step.modal)
        self._forces = forces
        if self.elastic is None:
            self._taken = step
        elif self.elastic.is_exact:
            self._completed(step, step.right - self._resists(self._followed_at, self._followed_at))
        else:
            self._bare = step

    def _solved(self, A: Array, right: Array) -> Array:
        """A⁻¹ of a vector or columns."""
        if A.ndim == 2:
            solved: Array = np.linalg.solve(A, right)
            return solved
        return right / (A if right.ndim == 1 else A[:, None])

    def _equations(self, modal: Array, ω̂: Vector, v_end: Vector, ω_end: Vector) -> tuple[Array, Array]:
        """A and the right-hand side, without contact."""
        h, v, ω, (a, b, c) = self.h, self._now.v, self._now.ω, ω̂
        self._give(modal)
        α, β, γ = added(ω_end, -1.0, ω)
        xx, yy, zz, yz, xz, xy = pairs(ω, ω_end)
        (x, y, z), (i, j, k) = added(v_end, -1.0, v), added(cross(ω, v_end), 1.0, cross(ω_end, v))
        self._set_factors(
            *(-x / h - i / 2, -y / h - j / 2, -z / h - k / 2, xx, yy, zz, yz, xz, xy),  # c, S
            *(0.0, 0.0, 0.0, -1.0, -α / h, -β / h, -γ / h),  # b, f0, T
        )
        right = self._factors.dot(self._sum)
        if self._couples and h * (math.hypot(*ω) + math.hypot(*ω_end)) > NO_TURN:
            known = self._coupled_at
            self._coupled_at = -xx, -yy, -zz, -yz, -xz, -xy, 2 * a, 2 * b, 2 * c
            if self._coupled_at != known or self._A is None:
                self._set_coefficients(*self._coupled_at, 1.0)
                self._A = self._coefficients.dot(self._flat_products).reshape(len(modal), -1)
            return self._A, right
        return self._products[9] if self._is_dense else self._diagonal, right

    def corrected(self, x: Array, push: Push | None) -> Array:
        """Velocities of the step under contact forces that push."""
        step = self._taken
        assert step is not None
        if self.elastic is not None and not self.elastic.is_exact:
            lack = self._lack(x) if push is None else self._lack(x) - push.modal
            return x - self._inverse_slopes.dot(lack)
        corrected: Array = self._inverse_slopes.dot(step.right if push is None else step.right + push.modal)
        return corrected

    def renew(self, x: Array) -> None:
        """As in FrameBody of mechanics.frame_contact."""
        if self.elastic is not None and not self.elastic.is_exact:
            self.newton.keep(self._slope(x))

    def size(self, change: Array) -> float:
        """Of velocities, as √(2 J)."""
        return float(change.dot(change)) ** 0.5

    def scale(self, x: Array) -> float:
        """Of the velocities of the step at its start and at x, those of the base included."""
        v, ω = self._now.v, self._now.ω
        rigid = self._mass * (dot(v, v) + self._size**2 * dot(ω, ω))
        return self.size(x) + (float(self._r.dot(self._r)) + rigid) ** 0.5

    @property
    def _inverse_slopes(self) -> Array:
        """As in FrameKernel."""
        step = self._taken
        assert step is not None
        if self.elastic is not None and not self.elastic.is_exact:
            assert self.newton.inverse is not None
            return self.newton.inverse
        if self._inverse is None:
            self._inverse = np.linalg.inv(step.A) if step.A.ndim == 2 else np.diag(1 / step.A)
        return self._inverse
