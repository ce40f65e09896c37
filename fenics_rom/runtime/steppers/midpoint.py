"""Passive midpoint integration (PMI) of one reduced model at one step size.

Kim, Lee et al., IJRR, doi 10.1177/0278364917731821; the paper's (2)-(4). With M = I, K = diag(γ), ω = √γ and the state
in energy coordinates e = ω q and r, so that (eᵀe + rᵀr)/2 is the stored energy:

    v̂ = A⁻¹ (G u + 2/h r - ω e),    A = 2/h + D + h/2 γ,
    e⁺ = e + h ω v̂,    r⁺ = 2 v̂ - r,

and E⁺ - E = h (G u)ᵀ v̂ - h v̂ᵀ D v̂ exactly, whatever h is. Without input the step is a contraction.

Two kernels take this step. In NumPy a step costs calls and memory read, not arithmetic:

    FusedMidpoint       [Φ Ψ] [e, r, u]                one call, 4 m² numbers
    StagedMidpoint      v̂, then e⁺ and r⁺ from it      seven calls and O(m) numbers; eight and m² where D is dense

Both write each next state beside the last, so that a step can be taken back, and allocate nothing while they step. What
the energy account needs of some steps stays where it is and is booked for all at once: so it adds a quarter to a step,
where booking each by itself would double it.
"""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.midpoint_map import compliance, matrices
from fenics_rom.runtime.steppers.kernel import Kernel

if TYPE_CHECKING:
    from collections.abc import Callable

    from fenics_rom.mechanics.contact import ObstacleMotion
    from fenics_rom.runtime.steppers.parted_adjoint import PartedAdjoint

LARGEST_FUSED_ORDER = {1: 75, 2: 90}  # order up to which one product is the faster, by the dimensions of the damping
PAGES = 64  # steps that are booked together
HELD = np.empty(0)  # displacement along the rigid motions of a body that has none


def fastest_kernel(
    model: ContactModel, ledger: EnergyLedger | None, rigid_displacement: Array = HELD
) -> "FusedMidpoint | StagedMidpoint":
    """The kernel for a model's size and damping; arguments as in _MidpointKernel."""
    kernel = FusedMidpoint if model.order <= LARGEST_FUSED_ORDER[model.damping.ndim] else StagedMidpoint
    return kernel(model, ledger, rigid_displacement)


class _MidpointKernel(Kernel):
    """What the kernels share: pages of states, one after the other, and the account of those that were left.

    Arguments as in BookedKernel; what the steps add to the rigid displacement is booked with the account.
    """

    holds_steps = True
    note_inputs: "Callable[[Array], None] | None" = None  # told inputs (n, p) of steps that are booked

    def __init__(self, model: ContactModel, ledger: EnergyLedger | None, rigid_displacement: Array = HELD):
        self._model, self._ledger, self._rigid_displacement, self.notes = model, ledger, rigid_displacement, {}
        self._states: list[Array]  # (2m,) each, views of the rows of
        self._rows: Array  # (PAGES + 1, 2m)
        self._inputs: Array  # (PAGES or more, p), of the steps from them on
        self._page = 0  # where the state is
        self._booked = 0  # pages before this one are in the account

    @property
    def state(self) -> Array:
        """[e, r] (2m,), ½|state|² is the stored energy; a view, which a later step overwrites."""
        return self._states[self._page]

    def rollback(self) -> None:
        """As in Kernel."""
        self._page -= 1

    def flush(self) -> None:
        """Books what the steps so far supplied and dissipated, and how far they carried the body."""
        if self._booked < self._page:
            self._book(*(self._works(slice(self._booked, self._page)) if self._ledger is not None else (HELD, HELD)))

    def _book(self, supplied: Array, dissipated: Array) -> None:
        """Books all that is owed, with the works of these steps, J."""
        if self.note_inputs is not None:
            self.note_inputs(self._inputs[self._booked : self._page])
        if self._ledger is not None:
            self._ledger.book(supplied=float(supplied.sum()), dissipated=float(dissipated.sum()))
        if len(self._rigid_displacement):
            m = self._model.order
            r = self._rows[self._booked : self._page + 1, m : m + len(self._rigid_displacement)]
            steps = self.h / 2 * (r[1:] + r[:-1])
            # A running sum: the same bits whenever it is read.
            self._rigid_displacement[:] = np.cumsum(np.vstack([self._rigid_displacement, steps]), axis=0)[-1]
        self._booked = self._page

    def reset_buffer(self) -> None:
        """As in Kernel: goes on from the first page."""
        self.flush()
        if self._page:
            self._states[0][:] = self.state
            self._page = self._booked = 0

    def passed(self) -> tuple[Array, Array, Array, Array]:
        """As in Kernel; they are booked."""
        supplied, dissipated = self._works(slice(0, self._page))
        if self._booked < self._page:
            self._book(supplied[self._booked :], dissipated[self._booked :])
        return self._rows[: self._page + 1], self._inputs[: self._page], supplied, dissipated

    def adjoint(self, u: Array) -> "PartedAdjoint":
        """As in Kernel."""
        from fenics_rom.runtime.steppers.held_part import HeldPart
        from fenics_rom.runtime.steppers.parted_adjoint import Ends, PartedAdjoint
        from fenics_rom.runtime.steppers.taken_step import linear_taken

        h, model, ω = self.h, self._model, self._model.safe_frequencies
        (e, r), (e_after, r_after) = self._rows[self._page - 1 : self._page + 1].reshape(2, 2, -1).copy()
        q, q_after, nowhere = e / ω, e_after / ω, np.empty((model.order, 0))
        law = linear_taken(model, h / 2, q, q_after, (r + r_after) / 2, None)
        part = HeldPart(h, 2 / h, law, model.inputs, None, 0.0, None, nowhere, None, None, r_after)
        return PartedAdjoint((part,), Ends(ω, q, q_after, None), False, rows_first=True)

    def _works(self, pages: slice) -> tuple[Array, Array]:
        """What was supplied and dissipated in each step from one of these pages on, J."""
        raise NotImplementedError


class FusedMidpoint(_MidpointKernel):
    """The whole step as one matrix, and its account as another. Arguments and attributes as in _MidpointKernel."""

    def __init__(self, model: ContactModel, ledger: EnergyLedger | None, rigid_displacement: Array = HELD):
        super().__init__(model, ledger, rigid_displacement)
        self._m, p = model.inputs.shape
        self._pages = np.zeros((PAGES + 1, 2 * self._m + p))  # [e, r, u]: what a product reads
        self._reads = list(self._pages)
        self._rows = self._pages[:, : 2 * self._m]
        self._inputs = self._pages[:, 2 * self._m :]
        self._states = list(self._rows)
        self._slots: list[Any] = [page[2 * self._m :].data for page in self._pages]  # to write u: twice as fast

    def set_time_step(self, h: float) -> None:
        """As in Kernel."""
        self.flush()
        # The method: np.dot first looks for overrides, which takes as long as the product.
        step, account = matrices(self._model, h)
        self._step, self._account = step.dot, account.T
        self.h = h

    def step(self, u: Array, obstacles: "ObstacleMotion | None" = None) -> float:
        """As in Kernel."""
        page = self._page
        if page == PAGES:
            self.reset_buffer()
            page = 0
        self._slots[page][:] = u
        state = self._states[page + 1]
        self._step(self._reads[page], state)
        self._page = page + 1
        return state.dot(state)

    def _works(self, pages: slice) -> tuple[Array, Array]:
        rows = self._pages[pages] @ self._account
        return _inner(rows[:, self._m :], self._pages[pages, 2 * self._m :]), _inner(rows[:, : self._m])


class _Halves(NamedTuple):
    """A state, and its parts."""

    both: Array  # (2, m)
    e: Array
    r: Array


class StagedMidpoint(_MidpointKernel):
    """The step as the paper writes it: v̂, and the state from it. Arguments and attributes as in _MidpointKernel."""

    def __init__(self, model: ContactModel, ledger: EnergyLedger | None, rigid_displacement: Array = HELD):
        super().__init__(model, ledger, rigid_displacement)
        m, p = model.inputs.shape
        pages = np.zeros((PAGES + 1, 2, m))
        self._halves = [_Halves(page, page[0], page[1]) for page in pages]
        self._rows = pages.reshape(PAGES + 1, -1)
        self._states = list(self._rows)
        self._terms = np.zeros((2, m))  # of the right-hand side: elastic, inertial
        self._elastic, self._inertial = self._terms
        self._inputs, self._velocities, self._rights = (np.zeros((PAGES, size)) for size in (p, m, m))  # u, 2 v̂
        self._slots: list[Any] = [row.data for row in self._inputs]
        self._v, self._right = list(self._velocities), list(self._rights)

    def set_time_step(self, h: float) -> None:
        """As in Kernel."""
        self.flush()
        model, ω = self._model, np.sqrt(self._model.eigenvalues)
        a, Ra = compliance(model, h)
        kept, forced = np.stack([-ω, np.full(model.order, 2 / h)]), model.inputs
        dense = a.ndim == 2
        self._spread: Any = (2 * a).dot if dense else None
        self._drain = 2 * Ra.T if dense else None
        self._kept = kept if dense else 2 * a * kept
        self._push = (forced.copy() if dense else 2 * a[:, None] * forced).dot
        self._travel = h / 2 * ω
        self.h = h

    def step(self, u: Array, obstacles: "ObstacleMotion | None" = None) -> float:
        """As in Kernel."""
        page = self._page
        if page == PAGES:
            self.reset_buffer()
            page = 0
        self._slots[page][:] = u
        v = self._v[page]
        right = v if self._spread is None else self._right[page]
        both, e, r = self._halves[page]
        _, next_e, next_r = self._halves[page + 1]
        self._page = page + 1
        self._push(u, right)
        np.multiply(self._kept, both, self._terms)
        np.add(right, self._elastic, right)
        np.add(right, self._inertial, right)
        if self._spread is not None:
            self._spread(right, v)
        np.multiply(self._travel, v, next_e)
        np.add(next_e, e, next_e)
        np.subtract(v, r, next_r)
        state = self._states[page + 1]
        return state.dot(state)

    def _works(self, pages: slice) -> tuple[Array, Array]:
        v = self._velocities[pages]
        drawn = self._model.damping_root * v if self._drain is None else self._rights[pages] @ self._drain
        supplied = _inner(v @ self._model.inputs, self._inputs[pages])
        return self.h / 2 * supplied, self.h / 4 * _inner(drawn)


def _inner(rows: Array, others: Array | None = None) -> Array:
    """Of each row, Σ of the products of its entries, or of their squares."""
    return np.einsum("ij,ij->i", rows, rows if others is None else others)
