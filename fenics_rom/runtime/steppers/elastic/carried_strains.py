"""Large deformation by one linear system a step: strains are carried along as unknowns of their own.

A step takes A = ∂E/∂q where its middle is expected, and ε⁺ = ε + h A v̂, with ½ ε:C₀ε stored (C₀ of small strains), and
what a material stores besides as ½ s², s⁺ = s + h bᵀv̂ (a scalar auxiliary variable: Shen, Xu & Yang, 2018). That is
quadratic, so that the balance is exact at any step. As E sees no rotation, what is left for s is of third order in the
strain. ε drifts from E(q) by what the step is wrong. It is taken back as far as the energy for that was dissipated
before, and what remains is the mismatch that a run reports.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.viscoelasticity import MaxwellBranches
from fenics_rom.rom.carried_strains import MonomialsAround, MonomialShape, PointsAround, PointShape, carried_strains
from fenics_rom.rom.deformation import ReducedDeformation
from fenics_rom.rom.material_points import MaterialPoints
from fenics_rom.rom.volume_viscosity import VolumeViscosity
from fenics_rom.runtime.steppers.adjoint import NONE
from fenics_rom.runtime.steppers.definite import is_definite
from fenics_rom.runtime.steppers.deformation_maps import E_OF_Q, Carried, StrainsMaps, s_of
from fenics_rom.runtime.steppers.elastic.law import ElasticLaw
from fenics_rom.runtime.steppers.elastic.strains_adjoint import StrainsAdjoint, start_back

TANGENT_RENEWAL = 0.05  # of v̂, by which a step may differ from what was expected before the tangent is made anew
STEEPEST_FREQUENCY = 10.0  # times that of the stiffest mode
MISMATCH_LIMIT = 0.03  # of the largest strain, in the energy norm


class Ahead(NamedTuple):
    """The shape that a step leads to, and the middle of the next one, if v̂ stays."""

    q: Array  # (m,)
    shape: MonomialShape | PointShape
    left: float  # energy of the shape that is not ½ E:C₀E, J
    middle: Array  # (m,)
    around: MonomialsAround | PointsAround  # the middle
    force: Array  # there, of what is strained and damped, but for what of branches is there before the step (m,)


class StrainsCarried(ElasticLaw):
    """As in ElasticLaw, of the points of a body.

    Args:
        body: its points.
        stiffest: frequency of the stiffest mode, rad/s.
        branches: how their material relaxes, in the strains that are carried along; None: it does not.

    Attributes:
        strains: that are carried along.
        points: whose energy is not that of these strains alone; None: there are none.
        volumes: whose viscosity is not that of these strains alone; None: there are none.
        steepest: largest slope of s, 1/s.
        steady: what of the matrix does not change (m, m).
        ahead: f̂ (m,) of a step that is open at `velocity`.
        expected: v̂ (m,) of the step, no longer than what was trained.
        made_tangent: whether the step that is open made the tangent that it is expected with.
        went_as_expected: whether the last step did, so that the tangent that it was expected with is kept.
    """

    is_exact = True
    NOTES = ("strained", "mismatch")  # energy of the strains at most, J; and what those that are carried along lack

    def __init__(self, body: ReducedDeformation, stiffest: float, branches: MaxwellBranches | None = None):
        self._body, self.branches, self.steepest = body, branches, STEEPEST_FREQUENCY * stiffest
        self.points = None if body.material.is_quadratic else MaterialPoints(body)
        self.strains, self.volumes, m = carried_strains(body), VolumeViscosity.of(body), body.order
        self._springs, self._is_expected = body.springs if body.springs.any() else None, False
        self._next: Ahead | None = None  # None: not known
        self._next_before: Ahead | None = None
        self._tangent: Array | None = None  # that is expected ahead
        self.pull, self.matrix, self._h = np.zeros(m), np.zeros((m, m)), 0.0
        self._q = self._q_before = np.zeros(m)
        self.went_as_expected, self.expected, self.ahead, self.made_tangent = True, self.pull, self.pull, True
        self.resume(self._q, self._q, np.empty(0))
        self._carried_before = self._carried

    @staticmethod
    def strain_count(body: ReducedDeformation) -> int:
        """How many strains branches have."""
        return carried_strains(body).size

    @property
    def velocity(self) -> Array:  # type: ignore[override]
        """As in ElasticLaw."""
        return self._carried.velocity

    @property
    def stored(self) -> float:
        """As in ElasticLaw."""
        stored = self._carried.energy + self._carried.left
        if self._springs is not None:
            stored += float(self._q.dot(self._springs.dot(self._q))) / 2
        return stored if self.branches is None else stored + self.branches.stored

    @property
    def auxiliary(self) -> Array:
        """As in ElasticLaw."""
        own = self._carried.in_one(self.strains.size)
        return own if self.branches is None else np.concatenate([own, self.branches.state.ravel()])

    def note(self, notes: dict[str, float]) -> None:
        """As in ElasticLaw."""
        strained, gap = self._noted
        notes["strained"] = most = max(notes["strained"], strained)
        if gap and most > 0:
            notes["mismatch"] = max(notes["mismatch"], math.sqrt(gap / most))

    def note_all(self, notes: dict[str, float], noted: Array) -> None:
        """The same of steps in a row, which noted so (n, 2): see `took`."""
        most = np.maximum.accumulate(np.maximum(noted[:, 0], notes["strained"]))
        has_gap = (noted[:, 1] > 0) & (most > 0)
        gaps = np.sqrt(noted[has_gap, 1] / most[has_gap])
        notes["strained"], notes["mismatch"] = float(most[-1]), max(notes["mismatch"], float(gaps.max(initial=0.0)))

    def messages(self, notes: Mapping[str, float]) -> tuple[str, ...]:
        """As in ElasticLaw."""
        mismatch = notes["mismatch"]
        if mismatch <= MISMATCH_LIMIT:
            return ()
        return (
            f"the linearly implicit stepper's strains went {100 * mismatch:.2g} % off those of the shape (limit "
            f"{100 * MISMATCH_LIMIT:g} %): its steps are too long for this motion; take a smaller dt or "
            'stepper = "newton"',
        )

    def set_time_step(self, h: float) -> None:
        """As in ElasticLaw."""
        self._h, self._next, self._tangent = h, None, None
        if self.branches is not None:
            self.branches.set_time_step(h)
        self._inert = 2 / h * np.eye(self._body.order)
        self.steady = self._body.external_damping + h / 2 * self._body.springs

    def reset_buffer(self) -> None:
        """As in ElasticLaw."""
        self._next, self._tangent = None, None

    def resume(self, q: Array, r: Array, auxiliary: Array) -> None:
        """As in ElasticLaw."""
        self._q = self._q_before = q.copy()
        self._next, self._tangent = None, None
        own = 2 * self.strains.size + self._body.order + 4
        if self.branches is not None:
            self.branches.resume(auxiliary[own:])
        if len(auxiliary):
            self._carried = Carried.of(auxiliary[:own], self.strains.size)
            return
        left, c = 0.0, 0.0
        energy = self.strains.around(q).elastic[0]
        if self.points is not None:
            left = float(self.points.energies_and_forces(q)[0][0]) - energy
            c = min(1e-4 * self.points.most + 4 * abs(left), self.points.most)
        self._carried = Carried(r.copy(), E_OF_Q, left, c, 0.0, energy)

    def rollback(self) -> None:
        """As in ElasticLaw."""
        self._carried, self._next, self._q = self._carried_before, self._next_before, self._q_before
        if self.branches is not None:
            self.branches.rollback()

    def open(self, q: Array, r: Array) -> None:
        """As in ElasticLaw; the tangent is kept as long as steps go as was expected."""
        v, self._q, self._is_expected = self._carried.velocity, q.copy(), False
        self._now = now = self._next or self._looked_ahead(self._q, v)
        force = self.steady.dot(v)
        force += now.force
        if self._springs is not None:
            force += self._springs.dot(q)
        if self.branches is not None:
            force += now.around.pulled(self.branches.pull[1])
        self.made_tangent = self._tangent is None
        if self._tangent is None:
            self._tangent = self._tangent_ahead(now, v)
        self.matrix, self.ahead = self._tangent, force

    def at(self, v: Array) -> None:
        """As in ElasticLaw."""
        if not self._is_expected:
            self.pull = self.ahead - self.matrix.dot(self._carried.velocity)

    def _tangent_ahead(self, now: Ahead, v: Array) -> Array:
        """That of f̂ with v̂, what stresses make stiff included, unless that is not definite."""
        h, body = self._h, self._body
        matrix = now.around.stiffness(h / 2 + self._stiffening_time) + self.steady
        σ = self.strains.stressed(now.around.damped(v, self._stiffening_time, self.points is None))
        geometric = self.strains.geometric(σ if self.branches is None else σ + self.branches.pull[1])
        if self.points is not None:
            geometric = body.geometric(self.points.stress(self.points.strains(now.middle)[1])) + geometric
        if self.volumes is not None:
            volumes = self.volumes.around(now.middle)
            matrix, geometric = matrix + volumes.matrix, geometric + body.geometric(volumes.stress(v))
        stressed: Array = matrix + h / 2 * geometric
        return stressed if is_definite(self._inert + stressed) else matrix

    def expect(self, v: Array) -> Array:
        """As in ElasticLaw; it can hardly go further than it was trained."""
        h, body, now, was = self._h, self._body, self._now, self._carried
        far = h / 2 * math.sqrt(v.dot(v))
        if not math.isfinite(far):
            v = np.zeros_like(v)
        elif far > body.training_radius:
            v = v * (body.training_radius / far)
        self.expected, self._is_expected = v, True
        middle = self._q + h / 2 * v
        around, pulled = now.shape.around(middle)
        self.matrix = around.stiffness(h / 2 + self._stiffening_time)
        self.matrix += self.steady
        if len(was.strained):
            pulled = around.pulled(was.strained[1])
        if self.branches is not None:
            pulled = pulled + around.pulled(self.branches.pull[1])
        self.pull = pulled if self._springs is None else pulled + self._springs.dot(self._q)
        left, c, s, b, N = was.left, was.c, 0.0, None, None
        if self.volumes is not None:
            N = self.volumes.around(middle).matrix
            self.matrix += N
        if self.points is not None:
            b, c = self._slope(self.points, around, middle, c)
            s = s_of(left + c)
            self.matrix += np.multiply.outer(h / 2 * b, b)
            self.pull = self.pull + s * b
        self._begun = around, pulled, left, c, s, b, N
        return v

    def close(self, v: Array, after: Array) -> float:
        """As in ElasticLaw."""
        h, body, (around, pulled, left, c, s, b, N) = self._h, self._body, self._begun
        missed = v - self.expected
        self.went_as_expected = not missed.dot(missed) > TANGENT_RENEWAL**2 * v.dot(v)
        if not self.went_as_expected:
            self._tangent = None
        square, viscous = around.squares(v)
        if N is not None:
            viscous += float(v.dot(N.dot(v)))
        heat = h * (float(v.dot(body.external_damping.dot(v))) + viscous)
        if self.branches is not None:
            heat += self.branches.step(self._with_stress(around.rates(v)))
        if b is not None:
            grown = h * float(b.dot(v))
            left += grown * (s + grown / 2)
        strained_more = h * (float(v.dot(pulled)) + h / 2 * square)
        self._next_before, self._next = self._next, self._looked_ahead(after, v)
        moved = self._q, after, around, v
        taken_back, gap = self._taken_back(self._next, left, c, strained_more, heat, moved)
        self._q_before, self._q = self._q, after
        self._noted = 2 * self._next.shape.energy, gap
        return heat - taken_back

    @property
    def carried(self) -> Carried:
        """What steps hand on."""
        return self._carried

    def took(
        self, after: Array, carried: Carried, relaxed: Array, noted: tuple[float, float], went_as_expected: bool
    ) -> None:
        """Takes note of a step to q⁺ (m,) that a compiled function took, and of what that hands on.

        `relaxed`: strains of branches, and C₀ times them (N, 2, size).
        `noted`: twice the energy of the strains at its end, J, and the square of what those carried along lack.
        """
        self._q_before, self._q, self._carried_before, self._carried = self._q, after, self._carried, carried
        if self.branches is not None:
            self.branches.took(relaxed.copy())
        self._next = self._next_before = self._tangent = None
        self._noted, self.went_as_expected = noted, went_as_expected

    def tell(self, expected: Array, matrix: Array) -> None:
        """What was expected of that step, (m,) and (m, m)."""
        self.expected, self.matrix = expected, matrix

    @property
    def tangent(self) -> Array:  # type: ignore[override]
        """As in ElasticLaw."""
        return NONE if self._tangent is None else self._tangent

    def keep_tangent(self, tangent: Array) -> None:
        """As in ElasticLaw."""
        self._tangent = tangent if len(tangent) else None

    @property
    def velocity_before(self) -> Array:
        """v̂ (m,) that the last step began with."""
        return self._carried_before.velocity

    @property
    def farthest(self) -> float:
        """The most |v̂| that a step is expected to have, so that it hardly goes further than was trained."""
        return 2 / self._h * self._body.training_radius

    def adjoint(self) -> StrainsAdjoint:
        """As in ElasticLaw."""
        before = self._with_strains(self._carried_before, self._q_before)
        after = self._with_strains(self._carried, self._q)
        branches = None if self.branches is None else self.branches.adjoint()
        moved = self._q_before, self._q, self._carried.velocity, self.expected
        return StrainsAdjoint(self._maps, *moved, before, after, self.matrix, branches)

    def start_back(self, q: Array, own: Array) -> tuple[Array, Array]:
        """As in ElasticLaw."""
        return start_back(self._maps, q, own)

    @property
    def _maps(self) -> StrainsMaps:
        most = 0.0 if self.points is None else self.points.most
        sizes = self._stiffening_time, self.points is None, most, self.steepest
        return StrainsMaps(self._body, self.strains, self.volumes, self._h, self.steady, *sizes)

    def _with_strains(self, carried: Carried, q: Array) -> Array:
        """What is carried beside q, with ε and C₀ε wherever ε is E(q)."""
        if not len(carried.strained):
            carried = carried._replace(strained=self._with_stress(self.strains.at(q)))
        return carried.in_one(self.strains.size)

    def _looked_ahead(self, q: Array, v: Array) -> Ahead:
        """From q, to which a step with v̂ led: what both need is found together."""
        points, middle = self.points, q + self._h / 2 * v
        shape, around, force = self.strains.with_next(q, middle, v, self._stiffening_time, points is None)
        if points is None:
            return Ahead(q, shape, 0.0, middle, around, force)
        stored, pulled = points.energy_and_force(q, middle)
        if self.volumes is not None:
            pulled += self.volumes.around(middle).force(v)
        return Ahead(q, shape, stored - shape.energy, middle, around, force + pulled)

    @property
    def _stiffening_time(self) -> float:
        """Of branches, s."""
        return 0.0 if self.branches is None else self.branches.stiffening_time

    def _with_stress(self, strains: Array) -> Array:
        """(2, size): some strains, and C₀ times them."""
        return np.stack([strains, self.strains.stressed(strains)])

    def _slope(
        self, points: MaterialPoints, around: MonomialsAround | PointsAround, q: Array, c: float
    ) -> tuple[Array, float]:
        """b = ∂√(2 (Ψ + c))/∂q (m,) of the energy Ψ that is left at q, and c, which grows where Ψ comes near -c.

        Up to a bound, as what is in s and what is in ε must not grow against each other. Any b balances energy; one
        much steeper than the stiffest mode, as where a point is all but flat, would drown it in round-off.
        """
        (stored,), forces = points.energies_and_forces(q)
        of_strains, force = around.elastic
        left = float(stored) - of_strains
        if left + c < c / 2:
            c = min(c + 4 * abs(left), points.most)  # ½ s² - c stays what it was
        b: Array = (forces[:, 0] - force) / math.sqrt(2 * max(left + c, c / 4))
        steep = math.sqrt(b.dot(b))
        return b if steep <= self.steepest else b * (self.steepest / steep), c

    def _taken_back(
        self,
        there: Ahead,
        left: float,
        c: float,
        strained_more: float,
        dissipated: float,
        moved: tuple[Array, Array, MonomialsAround | PointsAround, Array],
    ) -> tuple[float, float]:
        """Moves strains, also of branches, and s to those of the shape there; by A v̂ they `went`, and stored more.

        Energies, J: added (< 0: taken), of the gap. `left` and c are what v̂ has made of them.

        At most what is in the tank, which holds what was dissipated in this and the steps before, up to what strains
        store (as in teleoperation: Franken et al., 2011): a step may give back, and the run never more than it got.
        """
        was, (q, after, around, v) = self._carried, moved
        s, gap_s, share, gap_square, budget = 0.0, 0.0, 1.0, 0.0, was.tank + dissipated
        if self.points is not None:
            s = s_of(left + c)
            gap_s = s_of(there.left + c) - s
        energy, strained = there.shape.energy, E_OF_Q
        added = energy - was.energy - strained_more + gap_s * (s + gap_s / 2)
        if self.branches is not None or added > budget:
            aimed = self.strains.at(after)
            went = (was.strained[0] if len(was.strained) else self.strains.at(q)) + self._h * around.rates(v)
            went, gap = self._with_stress(went), self._with_stress(aimed - went)
            square = gap_square = float(gap[1].dot(gap[0])) + gap_s * gap_s
            slope = float(gap[1].dot(went[0])) + gap_s * s
            if self.branches is not None:
                of_branches = self.branches.growth(gap)
                slope, square = slope + of_branches[0], square + of_branches[1]
            if slope + square / 2 > budget and square > 0:
                root = math.sqrt(max(slope * slope + 2 * square * budget, 0.0))
                share = min(2 * budget / (slope + root) if slope > 0 else (root - slope) / square, 1.0)
            added = share * slope + share**2 * square / 2
            if share < 1:
                strained = went + share * gap
                energy = float(strained[1].dot(strained[0])) / 2
            if self.branches is not None:
                self.branches.move(share * gap)
        left += share * gap_s * (s + share * gap_s / 2)
        tank = min(max(budget - added, 0.0), 2 * there.shape.energy)
        self._carried_before, self._carried = was, Carried(v, strained, left, c, tank, energy)
        return added, (1 - share) ** 2 * gap_square
