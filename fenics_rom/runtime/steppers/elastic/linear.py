"""Small strains of a material that relaxes: γ (q + h/2 v̂) + D v̂, and the branches beside it.

Branches (mechanics/viscoelasticity.py) have energy coordinates ω w, too. In a step they pull with -ω Σ g (ω w)/(1 + θ
h/τ) and add their stiffening time to h/2: modes that are apart stay so.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.viscoelasticity import BranchesAdjoint, MaxwellBranches
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.runtime.steppers.adjoint import NONE, spread
from fenics_rom.runtime.steppers.elastic.law import ElasticLaw, LawOwed


class RelaxingLinear(ElasticLaw):
    """As in ElasticLaw, of a contact model.

    Args:
        model: of strains, without rigid motions.
        branches: how the material relaxes, in energy coordinates.
    """

    is_exact = True

    def __init__(self, model: ContactModel, branches: MaxwellBranches):
        self._model, self.branches, self._relaxing = model, branches, branches
        self._ω: Array = np.sqrt(model.eigenvalues)
        self._D = model.damping if model.damping.ndim == 2 else np.diag(model.damping)
        self.velocity = self.pull = np.zeros(model.order)
        self._q = self._q_before = self.pull
        self.matrix = np.empty((0, 0))

    @property
    def stored(self) -> float:
        """As in ElasticLaw."""
        e = self._ω * self._q
        return float(e.dot(e)) / 2 + self._relaxing.stored

    @property
    def auxiliary(self) -> Array:
        """As in ElasticLaw."""
        return self._relaxing.state.ravel()

    def set_time_step(self, h: float) -> None:
        """As in ElasticLaw."""
        self._h = h
        self._relaxing.set_time_step(h)
        self.matrix = self._D + np.diag((h / 2 + self._relaxing.stiffening_time) * self._model.eigenvalues)

    def resume(self, q: Array, r: Array, auxiliary: Array) -> None:
        """As in ElasticLaw."""
        self._q = self._q_before = q.copy()
        self.velocity = r.copy()
        self._relaxing.resume(auxiliary)

    def rollback(self) -> None:
        """As in ElasticLaw."""
        self._q = self._q_before
        self._relaxing.rollback()

    def open(self, q: Array, r: Array) -> None:
        """As in ElasticLaw."""
        pull: Array = self._ω * (self._ω * q + self._relaxing.pull[0])
        self.pull = pull

    def close(self, v: Array, after: Array) -> float:
        """As in ElasticLaw."""
        self._q_before, self._q = self._q, after
        self.velocity = v
        return self._h * float(v.dot(self._D).dot(v)) + self._relaxing.step((self._ω * v)[None])

    def adjoint(self) -> "LinearAdjoint":
        """As in ElasticLaw."""
        ends = self._q_before, self._q, self.velocity
        return LinearAdjoint(self._model, self._model.damping, self._h / 2, *ends, self._relaxing.adjoint())


class LinearAdjoint(NamedTuple):
    """A step of small strains from q to q⁺, of a material that relaxes or not: γ (q + reach v̂) + D v̂.

    D is that of the model; of equilibria 0.
    """

    model: ContactModel
    damping: Array
    reach: float  # s
    q: Array
    q_after: Array
    v: Array
    branches: BranchesAdjoint | None

    @property
    def _resisting_time(self) -> float:
        return self.reach + (0.0 if self.branches is None else self.branches.stiffening_time)

    @property
    def by_velocity(self) -> Array:
        """As in LawAdjoint."""
        D, ω = self.damping, np.sqrt(self.model.eigenvalues)
        by_velocity = np.diag(self._resisting_time * ω**2) + (D if D.ndim == 2 else np.diag(D))
        if self.branches is not None and self.branches.share is not None:
            by_velocity -= self.branches.stiffening_time * ω[:, None] * (np.eye(len(ω)) - self.branches.share) * ω
        return by_velocity

    @property
    def by_shape(self) -> Array:
        """As in LawAdjoint."""
        return np.diag(self.model.eigenvalues)

    def after(self, carried: Array, energy: float) -> LawOwed:
        """As in LawAdjoint."""
        γ, nothing = self.model.eigenvalues, np.zeros(len(self.q))
        end = energy * γ * self.q_after
        if self.branches is None:
            return LawOwed(end, nothing, nothing, (energy, NONE, nothing))
        w_, rate_ = self.branches.after(carried, energy)
        return LawOwed(end, nothing, np.sqrt(γ) * rate_[0], (energy, w_, rate_[0]))

    def before(self, y: Array, owed: LawOwed) -> tuple[Array, Array, Array]:
        """As in LawAdjoint."""
        _, w_, _ = owed.kept
        if self.branches is not None:
            w_ = w_ - self.branches.pulled_back((np.sqrt(self.model.eigenvalues) * y)[None])
        return w_.ravel(), np.zeros(len(y)), NONE

    def with_velocity(self, carried: Array, v_: Array) -> Array:
        """As in LawAdjoint: it is not carried."""
        return carried

    def by_model(self, y: Array, owed: LawOwed) -> tuple[Array, Array]:
        """As in LawAdjoint."""
        ω, (energy, _, rate_) = np.sqrt(self.model.eigenvalues), owed.kept
        along = energy * ω * self.q_after**2 - 2 * ω * y * (self.q + self._resisting_time * self.v) + rate_ * self.v
        if self.branches is not None:
            along += self.branches.along_frequencies(self.model.safe_frequencies, y, energy)
        return along, spread((y, self.v), self.damping) if self.damping.any() else np.zeros_like(self.model.damping)
