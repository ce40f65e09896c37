"""Viscosity that resists J'/J in place of tr Ė, beside strains in tables: see `PointMaterial.viscous_stress`.

With F at a shape and L = ∇v, a point whose c = ω β λ has the power c (d² - t²) of

    d = F⁻ᵀ:L = J'/J,   t = F:L = tr Ė,   and the stresses c (d F⁻ᵀ - t F),  S = c (d C⁻¹ - t 1)

beside β Ė:C₀Ė. That is v·N v with N symmetric, so that what is dissipated is a square as a whole. ∂J/∂x is written x_.
"""

from functools import cached_property

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.voigt import VOIGT_INDEX, VOIGT_PAIRS
from fenics_rom.rom.deformation import ReducedDeformation

_COFACTORS = [np.roll(np.arange(9).reshape(3, 3), shift, (0, 1)).ravel() for shift in ((2, 2), (1, 1), (2, 1), (1, 2))]
_DIAGONAL = np.eye(3).ravel()


class VolumeViscosity:
    """Of the points of a body; use `of`."""

    def __init__(self, body: ReducedDeformation, c: Array):
        self.points, self.order, self.count = np.flatnonzero(c), body.order, len(c)
        self.c, self.gradients = c[self.points], body.gradients[:, :, self.points].reshape(-1, body.order).copy()
        self.by_point = self.gradients.reshape(9, -1, body.order).swapaxes(0, 1).copy()  # (P, 9, m)

    @classmethod
    def of(cls, body: ReducedDeformation) -> "VolumeViscosity | None":
        """None where no point has some."""
        c = body.weights * body.viscosity * body.material.dilating
        return cls(body, c) if c.any() else None

    def around(self, q: Array) -> "AroundVolumes":
        """At q (m,), or those of bodies (m, B)."""
        F = self.gradients.dot(q).reshape(9, len(self.c), -1)
        F += _DIAGONAL[:, None, None]
        return AroundVolumes(self, F)


class AroundVolumes:
    """At shapes of deformation gradients F (9, P, B)."""

    def __init__(self, volumes: VolumeViscosity, F: Array):
        one, other, less, by = (F.take(places, 0) for places in _COFACTORS)
        one *= other
        less *= by
        one -= less
        self._of, self._F, self._inverse = volumes, F, one / (one[:3] * F[:3]).sum(axis=0)

    @cached_property
    def matrices(self) -> Array:
        """N (B, m, m)."""
        by_point, c = self._of.by_point, self._of.c[:, None]
        left, right = self._inverse - self._F, self._inverse + self._F  # so that nothing is left at rest
        left *= c
        left, right = (side.transpose(1, 2, 0) @ by_point for side in (left, right))  # (P, B, m)
        half = left.transpose(1, 2, 0) @ right.swapaxes(0, 1)
        N: Array = half + half.swapaxes(1, 2)
        N /= 2
        return N

    @property
    def matrix(self) -> Array:
        """N (m, m) of one body."""
        N: Array = self.matrices[0]
        return N

    def forces(self, v: Array) -> Array:
        """N v (m, B) of velocities (m, B)."""
        d, t = self._rates(self._moved(v))
        P = self._of.c[:, None] * (d * self._inverse - t * self._F)
        force: Array = self._of.gradients.T @ P.reshape(len(self._of.gradients), -1)
        return force

    def force(self, v: Array) -> Array:
        """N v (m,) of one body."""
        force: Array = self.forces(v[:, None])[:, 0]
        return force

    def stresses(self, v: Array) -> Array:
        """c (d C⁻¹ - t 1) (B, 6, P) with the weights, of all points of the bodies, of velocities (m, B)."""
        of, (d, t) = self._of, self._rates(self._moved(v))
        inverse, c = self._inverse.reshape(3, 3, *d.shape), of.c[:, None]
        S = np.zeros((d.shape[1], 6, of.count))
        here = c * d * np.einsum("kipb,kjpb->ijpb", inverse, inverse)[tuple(VOIGT_PAIRS.T)]
        here[:3] -= c * t
        S[:, :, of.points] = here.transpose(2, 0, 1)
        return S

    def stress(self, v: Array) -> Array:
        """The same of one body (6, P), and of v (m,)."""
        S: Array = self.stresses(v[:, None])[0]
        return S

    def _moved(self, v: Array) -> Array:
        """L (9, P, B)."""
        return self._of.gradients.dot(v).reshape(9, len(self._of.c), -1)

    def _rates(self, L: Array) -> tuple[Array, Array]:
        """d and t (P, B)."""
        return (self._inverse * L).sum(axis=0), (self._F * L).sum(axis=0)

    # --- what of one body is owed to its shape ---

    def form_back(self, y: Array, v: Array) -> Array:
        """∂(y·N v)/∂q (m,)."""
        return self.matrix_back((np.outer(y, v) + np.outer(v, y)) / 2)

    def matrix_back(self, W: Array) -> Array:
        """What N owes to q (m,), which is owed a symmetric W (m, m)."""
        of = self._of
        of_rates = [np.einsum("cp,pcm->pm", side[:, :, 0], of.by_point) for side in (self._inverse, self._F)]
        by_d, by_t = (2 * of.c * np.einsum("pm,pcm->cp", rows @ W, of.by_point) for rows in of_rates)
        owed: Array = -(of.gradients.T @ (self._turned(by_d) + by_t).ravel())
        return owed

    def stress_back(self, M: Array, v: Array) -> tuple[Array, Array]:
        """What S owes to q and to v (m,), whose components are owed M (6, all points)."""
        of, L, F, inverse = self._of, self._moved(v[:, None]), self._F[:, :, 0], self._inverse[:, :, 0]
        d, M = self._rates(L)[0][:, 0], M[:, of.points].copy()
        M[3:] /= 2
        M = M[VOIGT_INDEX]
        trace, B = M[0, 0] + M[1, 1] + M[2, 2], inverse.reshape(3, 3, -1)
        BM = np.einsum("kip,ijp->kjp", B, M)  # F⁻ᵀ M
        along = np.einsum("kjp,kjp->p", BM, B)  # M : C⁻¹
        by_v = of.c * (along * inverse - trace * F)
        turned = np.einsum("kjp,njp,nip->kip", BM, B, B).reshape(9, -1)  # F⁻ᵀ M F⁻¹ F⁻ᵀ
        by_q = of.c * (-along * self._turned(L[:, :, 0]) - 2 * d * turned - trace * L[:, :, 0])
        return of.gradients.T @ by_q.ravel(), of.gradients.T @ by_v.ravel()

    def _turned(self, Z: Array) -> Array:
        """F⁻ᵀ Zᵀ F⁻ᵀ (9, P)."""
        B = self._inverse.reshape(3, 3, -1)
        turned: Array = np.einsum("ikp,lkp,ljp->ijp", B, Z.reshape(3, 3, -1), B)
        return turned.reshape(9, -1)
