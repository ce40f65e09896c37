"""What a step asks of what resists the shape of a body: a force f̂ with f̂·(q⁺ - q) = ΔΦ + heat, whatever v̂ is found.

Whoever takes the step knows f̂ as `pull + matrix v̂`, and nothing else of it. Of a law that is exact in one linear system
(small strains; strains that are carried along) that holds for every v̂, once it was told where the step is expected. Of
others it holds at the v̂ that was asked for last, and near it: Newton's method.
"""

from collections.abc import Mapping
from contextlib import AbstractContextManager
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.viscoelasticity import MaxwellBranches
from fenics_rom.runtime.steppers.adjoint import NONE


class ElasticLaw:
    """Of the coordinates q (m,) of a body, with its damping and the branches of a material that relaxes.

    Attributes:
        pull, matrix: (m,) and (m, m): f̂ = pull + matrix v̂ in the step that is open, N kg^-1/2.
        is_exact: whether that is so for every v̂ after `expect`; else at the last one of `at` or `renew`.
        velocity: v̂ (m,) of the step before, or r: where the iteration to the next one begins.
        tangent: that steps are expected with, (m, m), if the law is told where, and keeps it; empty: none.
        branches: how the material relaxes; None: it does not.
        round_off: of f̂ (m,), N kg^-1/2, however small the strains are.
        went_as_expected: whether the last step went as it was expected to.
        NOTES: names of what it notes of a run, numbers that begin at 0.
    """

    pull: Array
    matrix: Array
    is_exact: bool
    velocity: Array
    tangent: Array = NONE
    branches: MaxwellBranches | None = None
    round_off: Array = np.zeros(1)
    went_as_expected: bool = True
    NOTES: tuple[str, ...] = ()

    @property
    def stored(self) -> float:
        """Φ, and what branches store, J."""
        raise NotImplementedError

    @property
    def auxiliary(self) -> Array:
        """What is carried along beside q and r."""
        raise NotImplementedError

    def note(self, notes: dict[str, float]) -> None:
        """Notes how the last step went."""

    def note_all(self, notes: dict[str, float], noted: Array) -> None:
        """The same of steps in a row that loops took, which noted so (n, 2)."""

    def messages(self, notes: Mapping[str, float]) -> tuple[str, ...]:
        """What the user should know of a run with such notes."""
        return ()

    def keep_tangent(self, tangent: Array) -> None:
        """Has it from now on."""

    def set_time_step(self, h: float) -> None:
        """Makes the coefficients of steps of h s."""
        raise NotImplementedError

    def reset_buffer(self) -> None:
        """Forgets what it found ahead of steps, so that what follows is the same to the bit, whatever came before."""

    def resume(self, q: Array, r: Array, auxiliary: Array) -> None:
        """Goes on from a state that was put in, with what was saved beside it (empty: nothing was)."""
        raise NotImplementedError

    def rollback(self) -> None:
        """Takes the last step back."""
        raise NotImplementedError

    def open(self, q: Array, r: Array) -> None:
        """Begins a step from q and r (m,): f̂ is that at `velocity`, and the matrix near its tangent."""
        raise NotImplementedError

    def expect(self, v: Array) -> Array:  # here and below: of a law that is exact anyway
        """Takes v̂ to be near v (m,), a step of Newton's method from the velocity of the step before, or near that.

        What it takes v̂ to be near.
        """
        return v

    def at(self, v: Array) -> None:
        """Makes f̂ exact at v (m,)."""

    def renew(self, v: Array) -> None:
        """Makes its slope that at v, too."""

    def in_parts(self, parts: int) -> AbstractContextManager[None]:
        """Steps in here are parts of a time step, which `rollback`, and an error, take back as one."""
        raise NotImplementedError

    def close(self, v: Array, after: Array) -> float:
        """Ends the step with v̂ (m,), at q⁺ (m,) to round-off; what was dissipated, J."""
        raise NotImplementedError

    def start_back(self, q: Array, own: Array) -> tuple[Array, Array]:
        """What is owed to q and r (m,) where a state is put in, by what is carried along then: nothing unless told."""
        return 0.0 * q, 0.0 * q

    def adjoint(self) -> "LawAdjoint":
        """The last step, to go back through."""
        raise NotImplementedError


class LawOwed(NamedTuple):
    """What is owed to a step's motion by what a law carries along and stores after it, (m,) each."""

    end: Array  # q⁺
    start: Array  # q
    velocity: Array  # v̂
    kept: Any = None  # what the law wants to know of it later


class LawAdjoint(Protocol):
    """A step of a law, to go back through: f̂(v̂, q, what is carried along)."""

    @property
    def by_velocity(self) -> Array:
        """∂f̂/∂v̂ (m, m)."""

    @property
    def by_shape(self) -> Array:
        """∂f̂/∂q (m, m), of q at the start."""

    def after(self, carried: Array, energy: float) -> LawOwed:
        """What is owed to the motion, from derivatives with what is carried along after the step and stored then."""

    def before(self, y: Array, owed: LawOwed) -> tuple[Array, Array, Array]:
        """What is owed to what was carried along, besides to q (m,), and to v̂ as it was expected, if it was (m,).

        Where f̂ is owed -y (m,).
        """

    def with_velocity(self, carried: Array, v_: Array) -> Array:
        """Derivatives with what was carried along, where v̂ of the step before is owed more (m,), if that is carried."""

    def by_model(self, y: Array, owed: LawOwed) -> tuple[Array, Array]:
        """Derivatives with ω (m,) and D of the contact model; nothing where neither plays a part."""
