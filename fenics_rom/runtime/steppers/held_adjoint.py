"""Back through the steps of a held body that deforms largely; see held.py."""

from typing import TYPE_CHECKING, NamedTuple

from numpy import ndarray as Array

from fenics_rom.rom.deformation import ReducedDeformation
from fenics_rom.runtime.steppers.acts.shape_loads import ShapeLoads
from fenics_rom.runtime.steppers.adjoint import StateAdjoint, check_is_differentiated, contact_adjoint
from fenics_rom.runtime.steppers.deformation_maps import Expected, LinearlyImplicitMaps, Taken
from fenics_rom.runtime.steppers.elastic.carried_strains import StrainsCarried
from fenics_rom.runtime.steppers.elastic.sampled import SampledAdjoint
from fenics_rom.runtime.steppers.held_part import HeldPart
from fenics_rom.runtime.steppers.linearly_implicit_adjoint import LinearlyImplicitAdjoint, start_pulled_back
from fenics_rom.runtime.steppers.parted_adjoint import Ends, PartedAdjoint
from fenics_rom.runtime.steppers.parted_kernel import PartedKernel
from fenics_rom.runtime.steppers.taken_step import found_taken, residual_taken

if TYPE_CHECKING:
    from fenics_rom.mechanics.viscoelasticity import BranchesAdjoint
    from fenics_rom.runtime.steppers.adjoint import ContactStep, StepAdjoint
    from fenics_rom.runtime.steppers.residual_maps import ResidualMaps


class Part(NamedTuple):
    """A part of a step, as it was solved."""

    h: float  # s
    q: Array  # at its start
    r: Array
    v: Array  # v̂
    reactions: Array
    contact: "ContactStep | None"
    residual: "ResidualMaps | None"
    branches: "BranchesAdjoint | None"


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
        if isinstance(self.elastic, StrainsCarried):
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
        parts, is_kink = list[HeldPart](), False
        for taken in self.taken[::-1]:
            h, q, r, v, reactions, solved, residual, branches = taken
            contact, kink = contact_adjoint(self._interface, solved)
            middle, reach, after = q + h / 2 * v, h / 2, 2 * v - r
            found = found_taken(self._found, u, reactions, (h, q, r, v, middle))
            law = SampledAdjoint.of(self._body, h, q, v, branches)
            turned = self.loads.slope(u, reactions, middle)
            columns = self.loads.all_columns(middle)
            held = h, 2 / h, law, columns, turned, reach, found, self._Sᵀ, contact, residual, after
            parts.append(HeldPart(*held))
            is_kink |= kink
        return self._parted_adjoint(parts, is_kink)

    def _parted_adjoint(self, parts: list[HeldPart], is_kink: bool) -> "StepAdjoint":
        """Of the last step, the last part first."""
        q, q_after = self.taken[0].q, self._coordinates().copy()
        ends = Ends(self._ω, 0, q, q_after, residual_taken(self.residual)[1])
        given = None if self._found is None else self.loads.stroke_slopes(q)
        return PartedAdjoint(tuple(parts), ends, is_kink, given)

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
