"""Back through the steps of a held body that deforms largely; see held.py."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.actuator_forces import SHARE
from fenics_rom.mechanics.contact_adjoint import ContactAdjoint
from fenics_rom.mechanics.hyperelastic import (
    discrete_gradient_slopes,
    discrete_gradient_stress,
    linear_stress,
    moduli,
    strain,
)
from fenics_rom.rom.deformation import ReducedDeformation
from fenics_rom.runtime.steppers.acts.shape_loads import ShapeLoads
from fenics_rom.runtime.steppers.adjoint import StateAdjoint, check_is_differentiated, contact_adjoint
from fenics_rom.runtime.steppers.balance_adjoint import BalanceAdjoint, BalancedPart, HeldStrokes, StrokesGiven
from fenics_rom.runtime.steppers.deformation_maps import Expected, LinearlyImplicitMaps, Taken
from fenics_rom.runtime.steppers.elastic.carried_strains import StrainsCarried
from fenics_rom.runtime.steppers.linearly_implicit_adjoint import LinearlyImplicitAdjoint, start_pulled_back
from fenics_rom.runtime.steppers.parted_kernel import PartedKernel

if TYPE_CHECKING:
    from fenics_rom.runtime.steppers.adjoint import ContactStep, StepAdjoint
    from fenics_rom.runtime.steppers.residual_motion import ResidualMaps


class Part(NamedTuple):
    """A part of a step, as it was solved."""

    h: float  # s
    q: Array  # at its start
    r: Array
    v: Array  # v̂
    reactions: Array
    contact: "ContactStep | None"
    residual: "ResidualMaps | None"


class HeldAdjoint(PartedKernel):
    """What steps of a held body leave to be gone back through.

    Attributes:
        loads: what acts on the shape in the contact mode.
        taken: the parts of the last step.
    """

    loads: ShapeLoads
    taken: tuple[Part, ...]
    _body: ReducedDeformation
    _unit: Array  # (m, m)
    _matrix: Array  # of the last step (m, m)
    _expectation: Expected | None = None  # of the last step, of strains that are carried along

    @property
    def _contact_step(self) -> "ContactStep | None":
        """Tells how contact was solved last; None where nothing can touch."""
        return None if self._interface is None else self._interface.solver.last_step

    def check_differentiable(self) -> None:
        """As in Kernel."""
        check_is_differentiated(self._actuators, self.branches)

    def adjoint(self, u: Array) -> "StepAdjoint":
        """As in Kernel."""
        u = self.loads.without_found(u)
        if not isinstance(self.elastic, StrainsCarried):
            return self._adjoint_of_parts(u)
        contact, is_kink = contact_adjoint(self._interface)
        residual = None if self.residual is None else self.residual.state.reshape(4, -1).copy()
        before, after = self._state_before.copy(), self.state.copy()
        shapes = (state[: self._model.order] * self._inverse_ω for state in (before, after))
        carried_before, carried_after = self.elastic.carried_with_strains(*shapes)
        states = [before, carried_before, after, carried_after]
        assert self._expectation is not None
        taken = Taken(self._expectation, self._matrix, self.reactions, self.loads.held(self.reactions)[0])
        return LinearlyImplicitAdjoint(self._maps(self.elastic), u, taken, states, residual, contact, is_kink)

    def _adjoint_of_parts(self, u: Array) -> "StepAdjoint":
        parts, is_kink = list[BalancedPart](), False
        for part in self.taken:
            contact, kink = contact_adjoint(self._interface, part.contact)
            parts.append(balanced_part(self._body, self.loads, u, part, self._Sᵀ, contact))
            is_kink |= kink
        return self._balance_adjoint(parts[::-1], [part.reactions for part in self.taken[::-1]], is_kink)

    def _balance_adjoint(self, parts: list[BalancedPart], reactions: list[Array], is_kink: bool) -> "StepAdjoint":
        """Of the last step, in parts under what was found, (n,) each; the last one first."""
        q, q_after = self.taken[0].q, self._coordinates().copy()
        given = StrokesGiven(self.loads.places, self.loads.stroke_slopes(q))
        residual = None if self.residual is None else self.residual.state.reshape(4, -1).copy()
        states = q, q_after, self._r.copy(), residual
        held = [self.loads.held(found)[0] for found in reactions]
        return BalanceAdjoint(parts, held, given, self._ω, self._body.force(q_after), *states, is_kink, False)

    def start_pulled_back(self, q: Array, r: Array, after: StateAdjoint) -> tuple[Array, Array]:
        """As in Kernel."""
        if not isinstance(self.elastic, StrainsCarried):
            return super().start_pulled_back(q, r, after)
        return start_pulled_back(self._maps(self.elastic), q, after)

    def _maps(self, law: StrainsCarried) -> LinearlyImplicitMaps:
        loads, residual = self.loads, None if self.residual is None else self.residual.maps
        steady, most = law.steady + 2 / self.h * self._unit, 0.0 if law.points is None else law.points.most
        return LinearlyImplicitMaps(
            self._body,
            law.strains,
            self.h,
            steady,
            self._Sᵀ,
            self._ω,
            loads.dead,
            loads.followers,
            loads.strokes,
            loads.places,
            residual,
            law.points is None,
            most,
            law.steepest,
        )


def balanced_part(
    body: ReducedDeformation, loads: ShapeLoads, u: Array, part: Part, Sᵀ: Array, contact: ContactAdjoint | None
) -> BalancedPart:
    """A part of a step under forces u (p,), as the linear map that it is nearby.

    Args:
        body: whose points were sampled.
        loads: that act on it.
        u: inputs (p,) without what is found.
        part: as it was solved.
        Sᵀ: rows of the contact points, transposed (m, 3P).
        contact: of the part.
    """
    h, q, r, v, reactions, _, residual = part
    m, middle, end = len(q), q + h / 2 * v, q + h * v
    H, H_start, H_end = (body.displacement_gradients(at) for at in (middle, q, end))
    E, E_end = strain(H_start), strain(H_end)
    viscous = moduli("st_venant_kirchhoff", E, body.viscosity * body.first_lame, body.viscosity * body.shear) / h
    rates = linear_stress((E_end - E) / h, body.viscosity * body.first_lame, body.viscosity * body.shear)
    S = body.weights * (discrete_gradient_stress(body.law, E, E_end, body.first_lame, body.shear) + rates)
    A = body.strain_rates(H).reshape(-1, m)
    of_end, of_start = discrete_gradient_slopes(body.law, E, E_end, body.first_lame, body.shear)
    by_start, by_end = (
        A.T @ np.einsum("cdp,dpk->cpk", body.weights * slope, body.strain_rates(at)).reshape(-1, m)
        for slope, at in ((of_start - viscous, H_start), (of_end + viscous, H_end))
    )
    turned = body.springs + body.geometric(S) - loads.slope(u, reactions, middle)
    _, strokes = loads.held(reactions)
    slopes = [stroke.slope(middle).T @ v for stroke in strokes]  # of Bᵀv̂ with the middle
    at_start = [stroke.force(q) for stroke in strokes]
    moved = [stroke.stroke_slope(q) for stroke in strokes]
    bent = [stroke.slope(q).T @ r for stroke in strokes]
    columns = _rows([stroke.force(middle) for stroke in strokes], m)
    held = HeldStrokes(
        columns.T,
        columns + h / 2 * _rows(slopes, m),
        _rows(slopes, m) + SHARE / h * _rows(moved, m) - (1 - SHARE) * _rows(bent, m),
        (SHARE - 1) * _rows(at_start, m),
        -SHARE / h,
    )
    by_velocity = 2 / h * np.eye(m) + body.external_damping + h / 2 * turned + h * by_end
    by_shape = turned + by_start + by_end
    return BalancedPart(h, 2 / h, by_velocity, by_shape, loads.columns(middle), held, Sᵀ, contact, residual)


def _rows(vectors: list[Array], m: int) -> Array:
    """Vectors (m,) as rows, (n, m)."""
    return np.array(vectors).reshape(-1, m)
