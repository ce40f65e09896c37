"""A body that is made of parts: what resists its shape, what follows it, and what is found in a step."""

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.runtime.steppers.adjoint import StateAdjoint
from fenics_rom.runtime.steppers.body_parts import BodyParts
from fenics_rom.runtime.steppers.kernel import BookedKernel

if TYPE_CHECKING:
    from fenics_rom.runtime.steppers.acts.found_forces import FoundInStep
    from fenics_rom.runtime.steppers.contact_interface import ContactInterface
    from fenics_rom.runtime.steppers.residual_motion import ResidualMotion


class PartedKernel(BookedKernel):
    """Arguments as in BookedKernel.

    Args:
        parts: what the body is made of.

    Attributes:
        elastic: what resists the shape; None: small strains of a material that does not relax.
        found: what is to be found in the step that is open; None where nothing is.
        reactions_found: (n,) forces that were found so far in this step.
    """

    rows_first = False

    def __init__(
        self,
        model: ContactModel,
        ledger: EnergyLedger | None,
        interface: "ContactInterface | None",
        residual: "ResidualMotion | None",
        parts: BodyParts,
    ):
        super().__init__(model, ledger, np.empty(0), interface, residual=residual)
        self.elastic, self._following, self._found, self._extent = parts
        self.branches = None if self.elastic is None else self.elastic.branches
        self.found: FoundInStep | None = None
        if self._found is not None:
            self.reactions = self._reactions_before = np.zeros(len(self._found.actuators.columns))
        self._acting, self.reactions_found = np.empty(0), np.empty(0)  # input of the step, and what is found of it
        self._start, self._matrix = np.empty(0), np.empty((0, 0))  # q of the step, and the slope of f̂ that is kept
        self._followed_at = np.empty(0)  # v̂ (m,) in the middle of which loads that follow are expected to act

    @property
    def _notes_of_parts(self) -> dict[str, float]:
        """Of a run that begins."""
        names = () if self.elastic is None else self.elastic.NOTES
        return dict.fromkeys((*names, *(() if self._extent is None else self._extent.notes)), 0.0)

    @property
    def model(self) -> ContactModel:
        """Of the contact mode."""
        return self._model

    @property
    def auxiliary(self) -> Array:
        """As in Kernel."""
        of_residual = super().auxiliary
        return of_residual if self.elastic is None else np.concatenate([self.elastic.auxiliary, of_residual])

    def resume(self, auxiliary: Array) -> None:
        """As in Kernel."""
        if self.elastic is None:
            super().resume(auxiliary)
            return
        own = len(self.elastic.auxiliary)
        super().resume(auxiliary[own:])
        self.elastic.resume(self._coordinates(), self._r, auxiliary[:own])

    @property
    def passed_rate(self) -> Array:
        """v̂ (m,) of the last step."""
        rate: Array = (self._r + self._state_before[len(self._r) :]) / 2
        return rate

    def _go_to_start_of(self, other: "PartedKernel", P: Array) -> None:
        """To where another body, of shapes P (m, any) among those of this one, began its last step."""
        self.set_time_step(other.h)
        e, r = other._state_before.reshape(2, -1)
        self.state[:] = np.concatenate([self._ω * (P @ (e * other._inverse_ω)), P @ r])
        self.contact, self.reactions, carried = None, other._reactions_before, [np.empty(0)]
        if other.branches is not None:
            carried.append((other.branches.before[:, 0] * other._inverse_ω @ P.T * self._ω).ravel())
        if other.residual is not None:
            carried.append(other.residual.carried_before.ravel())
        self.resume(np.concatenate(carried))

    def start_pulled_back(self, q: Array, r: Array, after: StateAdjoint) -> tuple[Array, Array]:
        """As in Kernel."""
        by_q, by_r = super().start_pulled_back(q, r, after)
        if self.elastic is None:
            return by_q, by_r
        of_law = self.elastic.start_back(q, after.auxiliary)
        return by_q + of_law[0], by_r + of_law[1]

    def rollback(self) -> None:
        """As in Kernel."""
        super().rollback()
        if self.elastic is not None:
            self.elastic.rollback()

    def reset_buffer(self) -> None:
        """As in Kernel."""
        super().reset_buffer()
        if self.elastic is not None:
            self.elastic.reset_buffer()

    def _twice_within(self) -> float:
        """Twice what is stored in the shape and its rate, but for the residual part, J."""
        if self.elastic is None:
            return float(self.state.dot(self.state))
        return float(self._r.dot(self._r)) + 2 * self.elastic.stored

    def _begin(self, u: Array) -> None:
        """Begins a step under u (p,), with the forces that were found in the step before."""
        self._acting = u
        if self._found is not None:
            self.found = self._found.begin(u, self._coordinates(), self._r, self.h)
            self._acting, self.reactions_found = self.found.acting(self.reactions), self.reactions
        if self.elastic is not None:
            self._start = self._coordinates().copy()
            self.elastic.open(self._start, self._r)

    def _resists(self, v: Array, at: Array) -> Array:
        """What of f̂ is not `_matrix` v̂, less the loads that follow a body that goes with `at` (m,); exact at v (m,)."""
        elastic = self.elastic
        assert elastic is not None
        elastic.at(v)
        pull = elastic.pull if elastic.is_exact else elastic.pull + (elastic.matrix - self._matrix).dot(v)
        if self._following is None:
            return pull
        return pull - self._following.force(self._acting, self._start + self.h / 2 * at)

    def _take_matrix(self, v: Array) -> None:
        """Has the slope of f̂ at v (m,) from now on, with that of the loads that follow where these are of v, too."""
        elastic = self.elastic
        assert elastic is not None
        self._matrix = elastic.matrix
        if self._following is not None and not elastic.is_exact:
            half = self.h / 2
            self._matrix = self._matrix - half * self._following.slope(self._acting, self._start + half * v)

    def _middle_of(self, v: Array) -> Array:
        """q (m,) in the middle of a step with v (m,), as loads that follow have it."""
        if self.elastic is None:
            return self._coordinates()
        return self._start + self.h / 2 * (self._followed_at if self.elastic.is_exact else v)

    def _followed_power(self, v: Array) -> float:
        """Of the loads that follow the body, at v (m,), W."""
        if self._following is None:
            return 0.0
        return float(self._following.force(self._acting, self._middle_of(v)).dot(v))

    def _rubbed(self, v: Array) -> float:
        """Power of the forces at guides, at v (m,), W."""
        if self._found is None or not self._found.actuators.guides:
            return 0.0
        _, rubbed = self._found.actuators.parts(self._found.columns(self._middle_of(v)), self.reactions_found)
        return float(rubbed.dot(v))

    def _heat(self, v: Array, after: Array) -> float:
        """Ends the step of what resists the shape, with v (m,) to q⁺ (m,); what it dissipates, J."""
        if self.elastic is None:
            return self.h * float(v.dot(self._damped(v)))
        return self.elastic.close(v, after)

    def _damped(self, r: Array) -> Array:
        """D r (m,)."""
        D = self._model.damping
        damped: Array = D * r if D.ndim == 1 else D.dot(r)
        return damped

    @property
    def beyond_training(self) -> bool:
        """As in Kernel."""
        return self._extent is not None and bool(self._extent.messages(self.notes))

    @property
    def messages(self) -> tuple[str, ...]:
        """As in Kernel."""
        told = () if self._extent is None else self._extent.messages(self.notes)
        return told if self.elastic is None else (*told, *self.elastic.messages(self.notes))

    def rates(self, x: Array) -> tuple[Array, Array]:
        """ω̂ (3,) in the frame's axes and r̂ (m,) of the velocities x that a step solves for."""
        raise NotImplementedError

    def no_progress(self, scale: float) -> float:
        """As in FrameBody of mechanics.frame_contact: more where forces are differences of energies of points."""
        is_exact = self.elastic is None or self.elastic.is_exact
        return 1e-12 * scale if is_exact else max(1e-11 * scale, self.round_off)

    @property
    def round_off(self) -> float:
        """Of velocities in a step, √(2 J), by that of forces."""
        if self.elastic is None or self.elastic.is_exact:
            return 0.0
        moved = self.elastic.round_off / (2 / self.h + self.h / 2 * self._model.eigenvalues)
        return math.sqrt(moved.dot(moved))

    def found_at(self, x: Array) -> tuple[Array, Array, Array, Array | None]:
        """As in ActuatedBody of mechanics.frame_contact."""
        assert self._found is not None
        r̂ = self.rates(x)[1]
        q = self._middle_of(r̂)
        columns = self._found.columns(q)
        spread = self._spread_columns(columns)
        return columns.T.dot(r̂), columns.T.dot(spread[-len(columns) :]), spread, self._found.angles(q)

    def held_back(self, x: Array, spread: Array) -> Array:
        """What of `spread`, by which x changes with other forces, the forces that are found near x take back."""
        assert self._found is not None
        assert self.found is not None
        columns = self._found.columns(self._middle_of(self.rates(x)[1]))
        _, by_z, of_z, angles = self.found_at(x)
        held = self._found.actuators.within(self.found.inputs, self.reactions_found, angles)
        rates = columns[:, held].T.dot(spread[-len(columns) :])
        back: Array = of_z[:, held].dot(np.linalg.pinv(by_z[np.ix_(held, held)]).dot(rates))
        return back

    def _spread_columns(self, columns: Array) -> Array:
        """What x changes by per force on the coordinates, of columns (m, n) of these."""
        raise NotImplementedError
