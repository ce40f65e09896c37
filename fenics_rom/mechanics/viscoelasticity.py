"""A generalised Maxwell solid: beside the elastic forces K x, branches of a spring g K in line with a dashpot g τ K.

The strain w of a branch's spring follows that of the body and relaxes; it pulls with g K w, stores ½ g wᵀKw, and its
dashpot dissipates g/τ wᵀKw per second (Prony series; Simo & Hughes, Computational Inelasticity, 1998, chapter 10):

    K (x + Σ_k g_k w_k),    w_k' = x' - w_k/τ_k,    relaxation 1 + Σ_k g_k e^(-t/τ_k) of the relaxed stiffness.

In a step of h with the mid-step velocity v̂, at θ = max(½, 1 - τ/h),

    ŵ = (1 - θ) w + θ w⁺ = (w + θ h v̂)/(1 + θ h/τ),    w⁺ = w + h (v̂ - ŵ/τ),
    ½ g wᵀKw  grows by  h g ŵᵀK v̂ - h g/τ ŵᵀKŵ - g (θ - ½) (w⁺ - w)ᵀK (w⁺ - w),

so that it is passive at any h, and of order 2 up to h = 2 τ. Beyond that the midpoint rule, θ = ½, would let what is
left of w alternate without end; here it is gone after the step.

Of a body that deforms largely x is the Green strain of its points, K their moduli of small strains, and the forces are
second Piola-Kirchhoff stresses: a rotation does not strain branches, and all of the above holds.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array


@dataclass(frozen=True)
class PronySeries:
    """How a material relaxes: stiffness g of each branch, as a share of the relaxed stiffness, and its time τ, s."""

    ratios: tuple[float, ...]
    times: tuple[float, ...]

    def modulus(self, ω: float | Array) -> complex | Array:
        """Of forced vibration at ω, rad/s, as a multiple of the relaxed one: 1 + Σ g iωτ/(1 + iωτ)."""
        branches = (g * 1j * ω * τ / (1 + 1j * ω * τ) for g, τ in zip(self.ratios, self.times, strict=True))
        return sum(branches, 1.0 + 0.0j)

    def stiffening_time(self, h: float) -> float:
        """Σ g θ h/(1 + θ h/τ), s: in a step of h s branches resist v̂ by so much times K, beside the body's h/2."""
        return _Step.of(self, h).stiffening_time

    def coefficients(self, h: float) -> tuple[Array, Array, Array]:
        """Of a step of h s, (N,) each: what pulls in it of w, and what there is after it of w and of v̂ (s)."""
        step = _Step.of(self, h)
        return step.pull.ravel(), step.decay.ravel(), step.gain.ravel()


class _Step(NamedTuple):
    """Coefficients of a step, (N, 1, 1) each."""

    pull: Array  # g/(1 + θ h/τ): of w in the force
    kept: Array  # of w in ŵ
    moved: Array  # of v̂ in ŵ, s
    decay: Array  # of w in w⁺
    gain: Array  # of v̂ in w⁺, s
    viscous: Array  # h g/τ: of ŵᵀKŵ in what is dissipated
    numerical: Array  # g (θ - ½): of (w⁺ - w)ᵀK (w⁺ - w)
    stiffening_time: float

    @classmethod
    def of(cls, series: PronySeries, h: float) -> "_Step":
        g, τ = (np.array(values)[:, None, None] for values in (series.ratios, series.times))
        late = np.minimum(h / (2 * τ), 1.0)  # (1 - θ) h/τ, without the cancellation of 1 - θ
        whole = 1 + h / τ - late
        moved = (h - late * τ) / whole
        of_change = g * np.maximum(0.5 - τ / h, 0.0)
        return cls(
            g / whole, 1 / whole, moved, (1 - late) / whole, h / whole, h * g / τ, of_change, float((g * moved).sum())
        )


class MaxwellBranches:
    """The branches of a body, and what they do in a step.

    Args:
        series: of the material.
        rows: 2, the strain w and its force K w; or 1, where they are the same in the coordinates that are used.
        size: n of each.
        total: sums what the ranks have; None: there is one.
        share: of one row, P (n, n) with the force P w, symmetric; None: it is w.

    Attributes:
        state: (N, rows, n), of each branch; a step replaces it.
        before: the state before the last step.
        stiffening_time: in a step, s; see PronySeries.
    """

    def __init__(
        self,
        series: PronySeries,
        rows: int,
        size: int,
        total: Callable[[float], Any] | None = None,
        share: Array | None = None,
    ):
        self._series, self._total, self.share = series, total, share
        self.state = self.before = np.zeros((len(series.ratios), rows, size))
        self.stiffening_time = self._h = 0.0

    def set_time_step(self, h: float) -> None:
        """Makes the coefficients of a step of h s."""
        if h != self._h:
            self._h, self._step = h, _Step.of(self._series, h)
            self.stiffening_time = self._step.stiffening_time

    @property
    def pull(self) -> Array:
        """What the strains at the start add in a step, Σ g w/(1 + θ h/τ), and its force, (rows, n)."""
        pull: Array = (self._step.pull * self.state).sum(axis=0)
        return pull if self.share is None else pull @ self.share

    @property
    def stored(self) -> float:
        """½ Σ g wᵀKw, J."""
        return self._sum_squares(np.array(self._series.ratios)[:, None, None] / 2, self.state)

    @np.errstate(over="ignore", invalid="ignore")  # the caller looks at what comes out
    def step(self, rate: Array) -> float:
        """Takes a step at a mid-step velocity and its force, (rows, n), and returns what is dissipated, J."""
        c, before = self._step, self.state
        self.remember()
        self.state = c.decay * before + c.gain * rate
        heat = self._sum_squares(c.viscous, c.kept * before + c.moved * rate)
        return heat + self._sum_squares(c.numerical, self.state - before) if c.numerical.any() else heat

    @property
    def coefficients(self) -> tuple[tuple[Array, Array, Array], Array]:
        """As of PronySeries, in the steps that are taken, (N,) each, and the stiffness ratios g."""
        c = self._step
        return (c.pull.ravel(), c.decay.ravel(), c.gain.ravel()), np.array(self._series.ratios)

    @property
    def numbers(self) -> Array:
        """All coefficients of the steps that are taken, and the stiffness ratios g, in rows (8, N)."""
        return np.stack([*(part.ravel() for part in self._step[:7]), np.array(self._series.ratios)])

    def took(self, state: Array) -> None:
        """Takes note of a step that led to a state."""
        self.before, self.state = self.state, state

    def adjoint(self) -> "BranchesAdjoint":
        """The last step, to go back through."""
        return BranchesAdjoint(self._series, self._step, self.before, self.state, self.share)

    def growth(self, gap: Array) -> tuple[float, float]:
        """a and b, J, of s a + ½ s² b that `stored` grows by where strains, and their forces, do by s gap (rows, n)."""
        g = np.array(self._series.ratios)[:, None]
        return float((g * self.state[:, -1] * gap[0]).sum()), float(g.sum() * gap[0].dot(gap[-1]))

    def move(self, gap: Array) -> None:
        """Lets all strains and their forces grow by a gap (rows, n)."""
        self.state = self.state + gap

    @contextmanager
    def in_parts(self, parts: int) -> Iterator[None]:
        """Steps in here are parts of a time step, which `rollback`, and an error, take back as one."""
        h, before = self._h, self.state
        self.set_time_step(h / parts)
        try:
            yield
        except BaseException:
            self.state = before
            raise
        finally:
            self.set_time_step(h)
            self.before = before

    def remember(self) -> None:
        """Notes the state before a step."""
        self.before = self.state

    def rollback(self) -> None:
        """Takes the last step back."""
        self.state = self.before

    def resume(self, state: Array) -> None:
        """Goes on from strains that were saved, of any shape; from relaxed branches, where there are none."""
        self.state = state.reshape(self.state.shape).copy() if state.size else np.zeros_like(self.state)

    def _sum_squares(self, weights: Array, strains: Array) -> float:
        """Σ of wᵀKw with weights (N, 1, 1)."""
        with np.errstate(over="ignore"):
            forces = strains[:, -1] if self.share is None else strains[:, -1] @ self.share
            square = float((weights[:, 0] * strains[:, 0] * forces).sum())
        return square if self._total is None else float(self._total(square))


class BranchesAdjoint(NamedTuple):
    """A step of branches, to go back through; ∂J/∂x is written x_."""

    series: PronySeries
    step: _Step
    before: Array  # (N, rows, n)
    state: Array  # after it
    share: Array | None  # as of MaxwellBranches

    @property
    def stiffening_time(self) -> float:
        """See PronySeries, s."""
        return self.step.stiffening_time

    @property
    def pull(self) -> Array:
        """As of MaxwellBranches, in the step."""
        return self._shared((self.step.pull * self.before).sum(axis=0))

    def _shared(self, strains: Array) -> Array:
        return strains if self.share is None else strains @ self.share

    def along_frequencies(self, ω: Array, y: Array, energy: float) -> Array:
        """With ω (m,) of the body, from those with its forces, less y (m,), and with what is stored; one row.

        Where branches have a share of γ, the rest S of it stays: ω P = ω - S/ω.
        """
        w: Array = (self.step.pull * self.before).sum(axis=0)[0]
        if self.share is None:
            return -y * w
        S = ω[:, None] * (np.eye(len(ω)) - self.share) * ω
        along: Array = -y * w - (S @ y) * w / ω**2
        for g, (own,) in zip(self.series.ratios, self.state, strict=True):
            along += energy * g * (S @ (own / ω)) * own / ω**2
        return along

    def after(self, w_: Array, energy: float) -> tuple[Array, Array]:
        """Those with the state before, as it lasts, and with the rate in the step (rows, n), from those after it.

        `energy`: that with what is stored.
        """
        w_ = self.owed(w_, energy)
        return self.step.decay * w_, (self.step.gain * w_).sum(axis=0)

    @property
    def ratios(self) -> Array:
        """g of each branch."""
        return np.array(self.series.ratios)

    def owed(self, w_: Array, energy: float) -> Array:
        """Those with the state after the step, also by what is stored."""
        g = self.ratios[:, None, None]
        of_energy = g * self._shared(self.state) if self.state.shape[1] == 1 else g / 2 * self.state[:, ::-1]
        owed: Array = w_.reshape(self.state.shape) + energy * of_energy
        return owed

    def stepped(self, rate: Array) -> tuple[Array, float]:
        """The state after a step at a rate (2, n) before anything moves it, and what the step dissipates, J."""
        c = self.step
        state, within = c.decay * self.before + c.gain * rate, c.kept * self.before + c.moved * rate
        change = state - self.before
        heat = (c.viscous[:, 0] * within[:, 0] * within[:, 1]).sum() + (
            c.numerical[:, 0] * change[:, 0] * change[:, 1]
        ).sum()
        return state, float(heat)

    def back(self, w_: Array, heat_: float, rate: Array) -> tuple[Array, Array]:
        """Those with the state before, and with the rate, from those with `stepped`."""
        c = self.step
        within = c.kept * self.before + c.moved * rate
        change = (c.decay - 1) * self.before + c.gain * rate
        within_, change_ = heat_ * c.viscous * within[:, ::-1], heat_ * c.numerical * change[:, ::-1]
        w_ = w_ + change_
        before = c.decay * w_ - change_ + c.kept * within_
        return before, (c.gain * w_ + c.moved * within_).sum(axis=0)

    def pulled_back(self, pull_: Array) -> Array:
        """Those with the state before from those with what it pulls with, (rows, n)."""
        back: Array = self.step.pull * self._shared(pull_)
        return back
