"""Equivalent forms of one midpoint step of one contact mode, and which of them is the fastest.

In NumPy a step costs calls and memory read, not arithmetic:

    OneProduct       [Φ Ψ] [e, r, u]                one call, 4 m² numbers
    VelocityFirst    v̂, then e⁺ and r⁺ from it      seven calls and O(m) numbers; eight and m² where D is dense

All hold the state in energy coordinates, write each next state beside the last, so that a step can be taken back, and
allocate nothing while they step.
"""

import math
from typing import NamedTuple

import numpy as np

from fenics_rom.rom import Mode
from fenics_rom.runtime.midpoint import account, compliance, damping_root, transition

Array = np.ndarray

LARGEST_PRODUCT = {1: 75, 2: 90}  # order up to which one product is the faster, by the dimensions of the damping


def fastest(mode: Mode) -> "OneProduct | VelocityFirst":
    """The form for a model's size and damping."""
    return OneProduct(mode) if mode.order <= LARGEST_PRODUCT[mode.damping.ndim] else VelocityFirst(mode)


class _Page(NamedTuple):
    """One buffer [e, r, u]: the state is written, and all of it is read by the next product."""

    state: Array
    u: Array
    read: Array


def _page(m: int, p: int) -> _Page:
    page = np.zeros(2 * m + p)
    return _Page(page[: 2 * m], page[2 * m :], page)


class OneProduct:
    """The whole step as one matrix, and its account as another.

    Args:
        mode: the reduced model.

    Attributes:
        h: time step, s; 0 before the first `retime`.
    """

    def __init__(self, mode: Mode):
        self._mode, self.h = mode, 0.0
        m, p = mode.inputs.shape
        self._now, self._next = _page(m, p), _page(m, p)
        self._account = np.zeros(m + p)  # √h R v̂ and h Gᵀ v̂
        self._heat, self._power = self._account[:m], self._account[m:]

    @property
    def state(self) -> Array:
        """[e, r] (2m,), ½|state|² is the stored energy; a view, which a later step overwrites."""
        return self._now.state

    def retime(self, h: float) -> None:
        """Makes the coefficients for another time step, s."""
        # The methods: np.dot first looks for overrides, which takes as long as the product.
        self._step = transition(self._mode, h).dot
        self._booking = account(self._mode, h).dot
        self.h = h

    def advance(self, u: Array) -> float:
        """Takes a step under u (p,), N, and returns twice the stored energy, J, which may be anything but finite."""
        now, after = self._now, self._next
        now.u[:] = u
        self._step(now.read, after.state)
        self._now, self._next = after, now
        state = after.state
        return state.dot(state)

    def undo(self) -> None:
        """Takes the last step back."""
        self._now, self._next = self._next, self._now

    def work(self, u: Array) -> tuple[float, float]:
        """What u supplied and the damping dissipated in the last step, J."""
        self._booking(self._next.read, self._account)
        return float(u.dot(self._power)), float(self._heat.dot(self._heat))


class _Halves(NamedTuple):
    """A state, and its parts."""

    both: Array  # (2, m)
    e: Array
    r: Array
    state: Array  # (2m,)


def _halves(m: int) -> _Halves:
    both = np.zeros((2, m))
    return _Halves(both, both[0], both[1], both.reshape(-1))


class VelocityFirst:
    """The step as the paper writes it: v̂, and the state from it.

    Args:
        mode: the reduced model.

    Attributes:
        h: time step, s; 0 before the first `retime`.
    """

    def __init__(self, mode: Mode):
        self._mode, self.h = mode, 0.0
        m, p = mode.inputs.shape
        self._now, self._next = _halves(m), _halves(m)
        self._terms = _halves(m)  # of the right-hand side: elastic, inertial
        self._v, self._right, self._heat = np.zeros((3, m))  # _v is 2 v̂
        self._power = np.empty(p)
        self._R = damping_root(mode)

    @property
    def state(self) -> Array:
        """[e, r] (2m,), ½|state|² is the stored energy; a view, which a later step overwrites."""
        return self._now.state

    def retime(self, h: float) -> None:
        """Makes the coefficients for another time step, s."""
        mode, ω = self._mode, np.sqrt(self._mode.eigenvalues)
        a = compliance(mode, h)
        kept, forced = np.stack([-ω, np.full(mode.order, 2 / h)]), mode.inputs
        self._spread = None if a.ndim == 1 else (2 * a).dot
        self._kept = 2 * a * kept if a.ndim == 1 else kept
        self._push = (2 * a[:, None] * forced if a.ndim == 1 else forced.copy()).dot
        self._travel = h / 2 * ω
        self.h = h

    def advance(self, u: Array) -> float:
        """Takes a step under u (p,), N, and returns twice the stored energy, J, which may be anything but finite."""
        both, e, r, _ = now = self._now
        _, next_e, next_r, state = after = self._next
        terms, elastic, inertial, _ = self._terms
        v = self._v
        right = v if self._spread is None else self._right
        self._now, self._next = after, now
        if not math.isfinite(u.dot(u)):  # in ufuncs, unlike in products, what is not finite would warn
            return math.nan
        self._push(u, right)
        np.multiply(self._kept, both, terms)
        np.add(right, elastic, right)
        np.add(right, inertial, right)
        if self._spread is not None:
            self._spread(right, v)
        np.multiply(self._travel, v, next_e)
        np.add(next_e, e, next_e)
        np.subtract(v, r, next_r)
        return state.dot(state)

    def undo(self) -> None:
        """Takes the last step back."""
        self._now, self._next = self._next, self._now

    def work(self, u: Array) -> tuple[float, float]:
        """What u supplied and the damping dissipated in the last step, J."""
        v, heat = self._v, self._heat
        if self._R.ndim == 1:
            np.multiply(self._R, v, heat)
        else:
            np.dot(self._R, v, heat)
        np.dot(v, self._mode.inputs, self._power)
        return self.h / 2 * float(u.dot(self._power)), self.h / 4 * float(heat.dot(heat))
