"""Back through the steps of a held body that deforms largely; see held.py."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.rom.deformation import ReducedDeformation
from fenics_rom.runtime.steppers.acts.shape_loads import ShapeLoads
from fenics_rom.runtime.steppers.adjoint import NONE, contact_adjoint
from fenics_rom.runtime.steppers.deformation_maps import Expected
from fenics_rom.runtime.steppers.elastic.carried_strains import StrainsCarried
from fenics_rom.runtime.steppers.elastic.sampled import SampledAdjoint
from fenics_rom.runtime.steppers.held_part import HeldPart
from fenics_rom.runtime.steppers.parted_adjoint import Ends, Expectation, PartedAdjoint
from fenics_rom.runtime.steppers.parted_kernel import PartedKernel
from fenics_rom.runtime.steppers.taken_step import found_taken, residual_taken

if TYPE_CHECKING:
    from fenics_rom.mechanics.viscoelasticity import BranchesAdjoint
    from fenics_rom.runtime.steppers.adjoint import ContactStep
    from fenics_rom.runtime.steppers.compiled_held import CompiledHeld
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
    _expectation: Expected | None = None  # of the last step, of strains that are carried along; None: loops know it
    _compiled: "CompiledHeld | None" = None
    _tangent_before: Array = NONE  # the last step

    @property
    def _contact_step(self) -> "ContactStep | None":
        """Tells how contact was solved last; None where nothing can touch."""
        return None if self._interface is None else self._interface.solver.last_step

    def rollback(self) -> None:
        """As in Kernel."""
        super().rollback()
        self.tangent = self._tangent_before

    def adjoint(self, u: Array) -> PartedAdjoint:
        """As in Kernel."""
        if self._compiled is not None and self._expectation is None and not self.taken:
            if self.elastic is not None and not self.elastic.is_exact:
                self.taken = (self._whole_step(),)
            else:
                self._expectation = self._compiled.expectation(self._reactions_before, self._contact_before is not None)
        forces = self.loads.without_found(u)
        return self._adjoint_at_once(u, forces) if self._expectation else self._adjoint_of_parts(u, forces)

    def _whole_step(self) -> Part:
        """The last step, which loops took."""
        (e, r), (_, r_after) = self._state_before.reshape(2, -1).copy(), self.state.reshape(2, -1)
        maps = None if self.residual is None else self.residual.maps
        branches = None if self.branches is None else self.branches.adjoint()
        v = (r + r_after) / 2
        return Part(self.h, e * self._inverse_ω, r, v, self.reactions, self._contact_step, maps, branches)

    def _adjoint_at_once(self, u: Array, forces: Array) -> PartedAdjoint:
        """Of a step by strains that are carried along."""
        (e, r), (_, r_after), h = self._state_before.reshape(2, -1).copy(), self.state.reshape(2, -1).copy(), self.h
        q, v, ahead = e * self._inverse_ω, (r + r_after) / 2, self._expectation
        assert ahead is not None
        assert isinstance(self.elastic, StrainsCarried)
        contact, is_kink = contact_adjoint(self._interface)
        (residual, rows), law = residual_taken(self.residual), self.elastic.adjoint()
        middle, z = q + h / 2 * ahead.value, self.reactions
        found = found_taken(self._found, u, z, (h, q, r, v, middle), follows=False)
        places = np.empty(0, dtype=int) if found is None else found.places

        def part(at: Array, z: Array, reach: float) -> HeldPart:
            turned, columns = self.loads.slope(forces, z, at), self.loads.all_columns(at)
            return HeldPart(h, 2 / h, law, columns, turned, reach, found, self._Sᵀ, contact, residual, r_after)

        before = part(ahead.middle, ahead.reactions, h / 2)
        before = before if ahead.touched else before._replace(Sᵀ=self._Sᵀ[:, :0])
        of_T = ahead.tangent, ahead.residual, ahead.whole, self.elastic.farthest, ahead.made_tangent
        ends = Ends(self._ω, q, self._coordinates().copy(), rows)
        given = None if self._found is None else self._found.stroke_slopes(q).T
        expectation = Expectation(before, law, places, *of_T)
        return PartedAdjoint((part(middle, z, 0.0),), ends, is_kink, given, False, expectation)

    def _adjoint_of_parts(self, u: Array, forces: Array) -> PartedAdjoint:
        parts, is_kink = list[HeldPart](), False
        for taken in self.taken[::-1]:
            h, q, r, v, reactions, solved, residual, branches = taken
            contact, kink = contact_adjoint(self._interface, solved)
            middle, reach, after = q + h / 2 * v, h / 2, 2 * v - r
            found = found_taken(self._found, u, reactions, (h, q, r, v, middle))
            law = SampledAdjoint.of(self._body, h, q, v, branches)
            turned = self.loads.slope(forces, reactions, middle)
            columns = self.loads.all_columns(middle)
            held = h, 2 / h, law, columns, turned, reach, found, self._Sᵀ, contact, residual, after
            parts.append(HeldPart(*held))
            is_kink |= kink
        return self._parted_adjoint(parts, is_kink)

    def _parted_adjoint(self, parts: list[HeldPart], is_kink: bool) -> PartedAdjoint:
        """Of the last step, the last part first."""
        q, q_after = self.taken[0].q, self._coordinates().copy()
        ends = Ends(self._ω, q, q_after, residual_taken(self.residual)[1])
        given = None if self._found is None else self._found.stroke_slopes(q).T
        return PartedAdjoint(tuple(parts), ends, is_kink, given)
