"""Large deformation of the bodies of a batch: one linear system a step for each, and products for all of them at once.

The step is that of `steppers/held.py` by `StrainsCarried`, in coordinates of monomials (`rom/carried_strains.py`). Only
what a material stores beyond a stress that is linear in the strain is found at points.
Arrays have bodies along the last axis.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.rom.deformation import ReducedTendon
from fenics_rom.rom.material_points import MaterialPoints
from fenics_rom.rom.rom import Rom
from fenics_rom.rom.strain_tables import StrainTables
from fenics_rom.rom.volume_viscosity import VolumeViscosity
from fenics_rom.runtime.steppers.definite import definite_inverse
from fenics_rom.runtime.steppers.elastic.carried_strains import STEEPEST_FREQUENCY, TANGENT_RENEWAL
from fenics_rom.runtime.steppers.training_watch import TRUSTED_EXTENT

TOGETHER = 128  # bodies that go through a step together, so that their arrays stay in the cache


class _Carried(NamedTuple):
    """What is carried along beside the states of B bodies."""

    strains: Array  # ε (r, B)
    stressed: Array  # C₀ε (r, B)
    velocity: Array  # v̂ of the step before (m, B)
    rest: Array  # the energy ½ s² - c, and c (2, B), J
    tank: Array  # of energy that was dissipated (1, B), J
    inverse: Array  # of the tangent (m m, B)
    strained: Array  # largest energy of the strains so far (1, B), J
    mismatch: Array  # of ε and the shape's strains so far, relative (1, B)
    stale: Array  # whether the tangent is to be made anew (1, B)

    def of(self, bodies: slice) -> "_Carried":
        """A view of some bodies."""
        return _Carried(*(part[:, bodies] for part in self))


class BatchDeformation:
    """How far bodies of a ROM with large deformation have gone, and their steps.

    Args:
        rom: with one viscosity.
        inputs: (c, p, m) of each contact mode, filled up to the most contact columns.
        first: number of these.
        size: number of bodies B.

    Attributes:
        distance: (B,) |q| at most, m kg^1/2.
        refuses: why a body could not take its step.
    """

    refuses = "its state after the step is not finite"

    def __init__(self, rom: Rom, inputs: Array, first: int, size: int):
        assert rom.deformation is not None
        self._body = body = rom.deformation
        self._points = None if body.material.is_quadratic else MaterialPoints(body)
        self._volumes = VolumeViscosity.of(body)
        self._steepest = STEEPEST_FREQUENCY * math.sqrt(rom.stiffness[-1])
        self._tables, self._β = StrainTables.of(body), float(body.viscosity[0])
        tables, m = self._tables, body.order
        others = m + 1 if self._points is None else 0  # entries of K(x) that are used only beside points
        table, self._upper = tables.stiffness[others:], tables.place - others
        self._at_rest, self._by_strains = table[:, 0].copy(), table[:, 1:] / tables.half[1:]
        self._places = tables.place - 1  # of the products of coordinates in strains
        self._dead = inputs.copy()
        self._pressures: list[tuple[int, Array, Array]] = []
        self._tendons: list[tuple[int, ReducedTendon]] = []
        column, m = first, body.order
        for name, columns in rom.actuators.items():
            if name in body.pressures:
                force = body.pressures[name]
                by_strains = np.hstack([force[:, 1 : m + 1], force[:, m + 1 :] / self._tables.half[m + 1 :]])
                self._pressures.append((column, force[:, :1], by_strains))
            elif name in body.tendons:
                self._tendons.append((column, body.tendons[name]))
            if name in body.pressures or name in body.tendons:
                self._dead[:, column] = 0.0
            column += columns
        r = len(self._tables.gram)
        widths = r, r, m, 2, 1, m * m, 1, 1
        self._now, self._next = (
            _Carried._make([*(np.zeros((width, size)) for width in widths), np.ones((1, size), bool)]) for _ in range(2)
        )
        self.distance = np.zeros(size)
        self.begin(np.arange(size), *np.zeros((2, size, m)))

    def set_time_step(self, h: float) -> None:
        """Has the tangents made anew for another time step, s."""
        self._h, body = h, self._body
        self._fixed = 2 / h * np.eye(body.order) + body.external_damping + h / 2 * body.springs
        self._now.stale[:] = True

    def entered(self, bodies: Array) -> None:
        """Bodies are in another contact mode: tangents are made anew."""
        self._now.stale[:, bodies] = True

    def begin(self, bodies: Array, q: Array, r: Array) -> None:
        """Bodies (B,) are put to q and r (B, m)."""
        now, strains = self._now, self._tables.at(q.T)
        now.strains[:, bodies], now.stressed[:, bodies] = strains, self._tables.gram @ strains
        now.velocity[:, bodies], now.tank[:, bodies], now.stale[:, bodies] = r.T, 0.0, True
        if self._points is not None:
            left = self._points.energies_and_forces(q.T)[0] - _dot(strains, now.stressed[:, bodies]) / 2
            now.rest[:, bodies] = left, np.minimum(1e-4 * self._points.most + 4 * np.abs(left), self._points.most)
        now.strained[:, bodies] = now.mismatch[:, bodies] = self.distance[bodies] = 0.0

    def energy(self, bodies: Array, q: Array, r: Array) -> Array:
        """Stored (B,), of bodies at q and r (B, m), J."""
        stored = np.einsum("rb,rb->b", self._now.strains[:, bodies], self._now.stressed[:, bodies])
        stored += np.einsum("bm,bm->b", q @ self._body.springs, q)
        energy: Array = (stored + np.einsum("bm,bm->b", r, r)) / 2 + self._now.rest[0, bodies]
        return energy

    @property
    def mismatch(self) -> Array:
        """(B,) of the strains that are carried along, relative to the largest, at most; in the energy norm."""
        mismatch: Array = self._now.mismatch[0].copy()
        return mismatch

    @property
    def distrusted(self) -> Array:
        """Bodies (B,) that went further than their model is to be trusted."""
        return self.distance > TRUSTED_EXTENT * self._body.training_radius

    def step(self, mode: Array, q: Array, r: Array, u: Array) -> tuple[Array, Array]:
        """The step of all bodies, in contact modes (B,), from q and r (m, B) under u (B, p); nothing is changed yet.

        Returns:
            Mid-step velocities v̂ (m, B), which need not be finite, and works (2, B) supplied and dissipated, J.
        """
        v, works = np.empty_like(q), np.empty((2, q.shape[1]))
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            for start in range(0, len(mode), TOGETHER):
                part = slice(start, min(start + TOGETHER, len(mode)))
                dead = np.empty((len(q), part.stop - start))
                for k in np.unique(mode[part]):
                    own = mode[part] == k
                    dead[:, own] = (u[part][own] @ self._dead[k]).T
                v[:, part], works[:, part] = self._stepped(part, dead, q[:, part], r[:, part], u[part].T)
        return v, works

    def accept(self, held: Array, q: Array) -> None:
        """The step is taken, to q (m, B), but for bodies that are held."""
        for part, before in zip(self._next, self._now, strict=True):
            part[:, held] = before[:, held]
        self._now, self._next = self._next, self._now
        np.maximum(self.distance, np.sqrt(np.einsum("mb,mb->b", q, q)), out=self.distance)

    def _stepped(self, part: slice, dead: Array, q: Array, r: Array, u: Array) -> tuple[Array, Array]:
        """As `step`, of some bodies under dead loads (m, B); what is carried along goes to `_next`."""
        h, β, body, tables, points = self._h, self._β, self._body, self._tables, self._points
        now, then, B = self._now.of(part), self._next.of(part), q.shape[1]
        expected = self._expected(now, then, dead, q, r, u)
        middle = q + h / 2 * expected
        strains = tables.at(middle)
        pushed, pulled = self._loads(dead, u, middle, strains), self._pulled(middle, now.stressed)
        right = pushed + 2 / h * r - body.springs @ q - pulled
        upper, stiffness = self._stiffness(strains)
        matrices = (h + 2 * β) * stiffness
        matrices += self._fixed
        N = None if self._volumes is None else self._volumes.around(middle).matrices
        if N is not None:
            matrices += N
        then.rest[:], gap_s, s = now.rest, np.zeros(B), np.zeros(B)
        if points is not None:
            b = self._slope(points, then.rest, middle, upper, stiffness)
            s = _root(then.rest)
            matrices += h / 2 * np.einsum("ib,jb->bij", b, b)
            right -= s * b
        lost = ~np.isfinite(matrices.reshape(B, -1).sum(axis=1))
        matrices[lost] = np.eye(len(q))
        v = np.linalg.solve(matrices, right.T[:, :, None])[:, :, 0].T
        v[:, lost] = math.nan
        missed = v - expected
        then.stale[0] = (missed * missed).sum(axis=0) > TANGENT_RENEWAL**2 * (v * v).sum(axis=0)
        then.velocity[:] = v

        after = q + h * v
        then.strains[:] = tables.at(after)
        then.stressed[:] = tables.gram @ then.strains
        square = 2 * _dot(v, _times(stiffness, v))
        drawn = h * (_dot(v, body.external_damping @ v) + β * square)
        if N is not None:
            drawn += h * _dot(v, _times(N, v))
        strained = _dot(then.strains, then.stressed)
        added = (strained - _dot(now.strains, now.stressed)) / 2 - h * (_dot(v, pulled) + h / 2 * square)
        if points is not None:
            grown = h * _dot(b, v)
            then.rest[0] += grown * (s + grown / 2)
            s, left = _root(then.rest), points.energies_and_forces(after)[0] - strained / 2
            gap_s = np.sqrt(2 * np.maximum(left + then.rest[1], 0.0)) - s
            added += gap_s * (s + gap_s / 2)
        budget, share = now.tank[0] + drawn, np.ones(B)
        then.strained[0] = np.maximum(now.strained[0], strained)
        then.mismatch[:] = now.mismatch
        over = (added > budget).nonzero()[0]
        if len(over):
            rates = tables.rates(middle[:, over], v[:, over])
            moved = h * rates, h * (tables.gram @ rates)
            share[over], added[over] = _held_back(now, then, over, moved, (s[over], gap_s[over]), budget[over])
        then.rest[0] += share * gap_s * (s + share * gap_s / 2)
        then.tank[0] = np.minimum(np.maximum(budget - added, 0.0), strained)
        return v, np.stack([h * _dot(pushed, v), drawn - added])

    def _expected(self, now: _Carried, then: _Carried, dead: Array, q: Array, r: Array, u: Array) -> Array:
        """v̂ (m, B) by one iteration of Newton's from the step before, as `HeldBody._expected`."""
        h, body, v, m = self._h, self._body, now.velocity, len(q)
        middle = q + h / 2 * v
        strains = self._tables.at(middle)
        linear, points = self._β * self._tables.rates(middle, v), self._points
        if points is None:
            linear += strains
        stressed = self._tables.gram @ linear
        residual = 2 / h * (v - r) + body.external_damping @ v + body.springs @ middle + self._pulled(middle, stressed)
        residual -= self._loads(dead, u, middle, strains)
        if points is not None:
            residual += points.energies_and_forces(middle)[1]
        if self._volumes is not None:
            residual += self._volumes.around(middle).forces(v)
        then.inverse[:] = now.inverse
        stale = now.stale[0].nonzero()[0]
        if len(stale):
            geometric = stressed[:, stale].T[:, self._places]
            if points is not None:
                S = points.stress(points.strains(middle[:, stale])[1]).reshape(6, -1, len(stale))
                geometric = geometric + [body.geometric(each) for each in S.transpose(2, 0, 1)]
            matrices = (h + 2 * self._β) * self._stiffness(strains[:, stale])[1] + self._fixed
            if self._volumes is not None:
                around = self._volumes.around(middle[:, stale])
                matrices += around.matrices
                geometric = geometric + [body.geometric(S) for S in around.stresses(v[:, stale])]
            for body_, matrix, stiff in zip(stale, matrices, geometric, strict=True):
                then.inverse[:, body_] = definite_inverse(matrix + h / 2 * stiff, matrix).ravel()
        expected: Array = v - np.einsum("ijb,jb->ib", then.inverse.reshape(m, m, -1), residual)
        far = h / 2 * np.sqrt(_dot(expected, expected))
        expected *= np.where(far > body.training_radius, body.training_radius / far, 1.0)
        expected[:, ~np.isfinite(far)] = 0.0
        return expected

    def _slope(self, points: MaterialPoints, rest: Array, q: Array, upper: Array, stiffness: Array) -> Array:
        """b (m, B) at q (m, B), as `StrainsCarried._slope`; what is in `rest` (2, B) grows where it must."""
        stored, b = points.energies_and_forces(q)
        linear = upper[:, 1 : len(q) + 1].T
        force = _times(stiffness, q) + linear
        left = stored - (_dot(force + linear, q) + upper[:, 0]) / 4
        b -= force
        rest[1] = np.where(left + rest[1] < rest[1] / 2, np.minimum(rest[1] + 4 * np.abs(left), points.most), rest[1])
        b /= np.sqrt(2 * np.maximum(left + rest[1], rest[1] / 4))
        steep = np.sqrt(_dot(b, b))
        b *= np.where(steep > self._steepest, self._steepest / steep, 1.0)
        return b

    def _pulled(self, q: Array, stressed: Array) -> Array:
        """Forces (m, B) of stresses (r, B) at q (m, B)."""
        m = len(q)
        force: Array = np.einsum("ijb,jb->ib", stressed.take(self._places, 0), q)
        force += stressed[:m]
        return force

    def _stiffness(self, strains: Array) -> tuple[Array, Array]:
        """Upper triangles (B, ...) of ½ K(x), as far as they are used, and ½ AᵀC₀A (B, m, m), of strains (r, B)."""
        upper = strains.T @ self._by_strains.T
        upper += self._at_rest
        return upper, upper.take(self._upper, axis=1)

    def _loads(self, dead: Array, u: Array, q: Array, strains: Array) -> Array:
        """Generalized forces (m, B) of the inputs (p, B) on bodies at q (m, B)."""
        force = dead.copy()
        for column, at_rest, by_strains in self._pressures:
            force += u[column] * (by_strains @ strains + at_rest)
        for column, tendon in self._tendons:
            points = tendon.points[:, :, None] + (tendon.shapes @ q).reshape(-1, 3, q.shape[1])
            pulls = points[1:] - points[:-1]
            pulls *= u[column] / np.sqrt(np.square(pulls).sum(axis=1, keepdims=True))
            forces = np.zeros_like(points)
            forces[:-1] = pulls
            forces[1:] -= pulls
            force += tendon.shapes.T @ forces.reshape(-1, q.shape[1])
        return force


def _held_back(
    now: _Carried, then: _Carried, bodies: Array, moved: tuple[Array, Array], of_s: tuple[Array, Array], budget: Array
) -> tuple[Array, Array]:
    """Moves strains of bodies (B,) only so far to those of their shapes as a budget (B,), J, lets them.

    As `StrainsCarried._taken_back` says.

    Args:
        now, then: before the step, and after it: with the strains of the shapes, which become those that are carried.
        bodies: which.
        moved: what ε and C₀ε did in the step (r, B).
        of_s: s (B,), and what it lacks of that of the shape.
        budget: what may be added.

    Returns:
        By which share they were moved (B,), and what that added, J.
    """
    (s, gap_s), ε, σ = of_s, then.strains[:, bodies], then.stressed[:, bodies]
    most = then.strained[0, bodies]
    went, went_stressed = now.strains[:, bodies] + moved[0], now.stressed[:, bodies] + moved[1]
    gap, gap_stressed = ε - went, σ - went_stressed
    square = _dot(gap, gap_stressed) + gap_s**2
    slope = _dot(gap_stressed, went) + gap_s * s
    root = np.sqrt(np.maximum(slope**2 + 2 * square * budget, 0.0))
    limited = np.minimum(np.where(slope > 0, 2 * budget / (slope + root), (root - slope) / square), 1.0)
    share = np.where((slope + square / 2 > budget) & (square > 0), limited, 1.0)
    then.strains[:, bodies] = went + share * gap
    then.stressed[:, bodies] = went_stressed + share * gap_stressed
    off = np.sqrt((1 - share) ** 2 * square / np.where(most > 0, most, 1.0))
    then.mismatch[0, bodies] = np.maximum(now.mismatch[0, bodies], off)
    return share, share * slope + share**2 * square / 2


def _dot(one: Array, other: Array) -> Array:
    """Scalar products (B,) of columns."""
    product: Array = np.einsum("rb,rb->b", one, other)
    return product


def _times(matrices: Array, vectors: Array) -> Array:
    """Products (m, B) of matrices (B, m, m) with columns."""
    products: Array = (matrices @ vectors.T[:, :, None])[:, :, 0].T
    return products


def _root(rest: Array) -> Array:
    """s (B,)."""
    root: Array = np.sqrt(2 * np.maximum(rest[0] + rest[1], 0.0))
    return root
