"""Small strains of a material that relaxes: γ (q + h/2 v̂) + D v̂, and the branches beside it.

Branches (mechanics/viscoelasticity.py) have energy coordinates ω w, too. In a step they pull with -ω Σ g (ω w)/(1 + θ
h/τ) and add their stiffening time to h/2: modes that are apart stay so.
"""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.viscoelasticity import MaxwellBranches
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.runtime.steppers.elastic.law import ElasticLaw


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
