"""What a body in a moving frame tells of the step that it took, so that it can be gone back through."""

from typing import TYPE_CHECKING, Any

from numpy import ndarray as Array

from fenics_rom.errors import StructureError
from fenics_rom.runtime.steppers.adjoint import contact_adjoint
from fenics_rom.runtime.steppers.frame_kernel import FrameKernel
from fenics_rom.runtime.steppers.frame_loads import FrameForces
from fenics_rom.runtime.steppers.frame_slopes import InertiaSlopes, Moving, StepTurn
from fenics_rom.runtime.steppers.frame_state import FrameState

if TYPE_CHECKING:
    from fenics_rom.runtime.steppers.elastic.linear import LinearAdjoint
    from fenics_rom.runtime.steppers.frame_adjoint import FrameAdjoint


class DifferentiableFrame(FrameKernel):
    """Arguments and attributes as in FrameKernel."""

    _now: Any  # how the body moves, and how it did before the step
    _now_before: Any

    def check_differentiable(self) -> None:
        """As in Kernel."""
        refused = {
            "strokes in a moving frame": self._found is not None,
            "a moving frame of a body that deforms largely": self._following is not None or self._extent is not None,
            "contact in a moving frame of a material that relaxes": self._relaxes_beyond,
        }
        for what, there in refused.items():
            if there:
                raise StructureError(f"{what}: its steps are not differentiated")

    @property
    def _relaxes_beyond(self) -> bool:
        """Whether what contact points yield beyond the basis relaxes."""
        return self.residual is not None and self.branches is not None

    @property
    def _turned_by(self) -> StepTurn:
        """How the frame turned in the last step."""
        raise NotImplementedError

    def adjoint(self, u: Array) -> "FrameAdjoint":
        """As in Kernel."""
        from fenics_rom.runtime.steppers.frame_adjoint import FrameAdjoint, FrameParts, TouchedPoints

        step, residual = self._turned_by, self.residual
        before, after = self._motion_of(self._frame_before, self._now_before), self._motion_of(self.frame, self._now)
        (e, r), (e_after, r_after) = self._state_before.reshape(2, -1), self.state.reshape(2, -1)
        ends = (
            Moving(*before, e * self._inverse_ω, r.copy()),
            Moving(*after, e_after * self._inverse_ω, r_after.copy()),
        )
        law = self._plain_adjoint(ends) if self.elastic is None else self.elastic.adjoint()
        parts = FrameParts(
            self._model,
            InertiaSlopes(self._constants, self._second),
            self._loads,
            self.ties,
            None if residual is None else residual.maps,
        )
        contact, is_kink = contact_adjoint(self._interface)
        touched = None
        if contact is not None and self.contact is not None:
            rate, places = (r + r_after) / 2, self.points.rest + self.points.moved(ends[0].q)
            inside, start = self.points.moved(rate), self.points.moved(r)
            if residual is not None:
                _, y, _, ẏ = residual.before.reshape(4, -1, 3)
                places, start = places + y, start + ẏ
                inside = inside + (residual.displacement - y) / self.h
            rows = self.points.rows
            touched = TouchedPoints(rows, places, inside, start, before[2], self.contact.forces, contact)
        rows_after = None if residual is None else residual.state.reshape(4, -1).copy()
        return FrameAdjoint(parts, step, ends, self._acting_forces, law, rows_after, touched, is_kink)

    def _motion_of(self, frame: FrameState, motion: Any) -> tuple[Array, Array, Array]:
        """Position and velocity of the origin, and angular velocity, at one end of the last step."""
        raise NotImplementedError

    @property
    def _acting_forces(self) -> FrameForces:
        """What acted in the frame in the last step."""
        raise NotImplementedError

    def _plain_adjoint(self, ends: tuple[Moving, Moving]) -> "LinearAdjoint":
        """Of small strains of a material that does not relax."""
        from fenics_rom.runtime.steppers.elastic.linear import LinearAdjoint

        before, after = ends
        return LinearAdjoint(self._model, self.h, before.q, after.q, (before.r + after.r) / 2, None)
