"""What a body in a moving frame tells of the step that it took, so that it can be gone back through."""

from typing import TYPE_CHECKING, Any

from numpy import ndarray as Array

from fenics_rom.errors import StructureError
from fenics_rom.runtime.steppers.adjoint import contact_adjoint
from fenics_rom.runtime.steppers.frame_kernel import FrameKernel
from fenics_rom.runtime.steppers.frame_loads import FrameForces
from fenics_rom.runtime.steppers.frame_slopes import InertiaSlopes, Moving, StepTurn
from fenics_rom.runtime.steppers.frame_state import FrameState
from fenics_rom.runtime.steppers.taken_step import found_taken, linear_taken, residual_taken

if TYPE_CHECKING:
    from fenics_rom.mechanics.contact_adjoint import ContactAdjoint
    from fenics_rom.runtime.steppers.frame_adjoint import TouchedPoints
    from fenics_rom.runtime.steppers.parted_adjoint import PartedAdjoint


class DifferentiableFrame(FrameKernel):
    """Arguments and attributes as in FrameKernel."""

    _now: Any  # how the body moves, and how it did before the step
    _now_before: Any

    def check_differentiable(self) -> None:
        """As in Kernel."""
        if self._following is not None and self._following.rims:
            raise StructureError("pressure on an open surface in a moving frame: its steps are not differentiated")
        if self.elastic is not None and not self.elastic.tells_slopes:
            raise StructureError("strains that are carried along in a moving frame: their steps are not differentiated")

    @property
    def _turned_by(self) -> StepTurn:
        """How the frame turned in the last step."""
        raise NotImplementedError

    def _motion_of(self, frame: FrameState, motion: Any) -> tuple[Array, Array, Array]:
        """Position and velocity of the origin, and angular velocity, at one end of the last step."""
        raise NotImplementedError

    @property
    def _acting_forces(self) -> FrameForces:
        """What acted in the frame in the last step."""
        raise NotImplementedError

    def adjoint(self, u: Array) -> "PartedAdjoint":
        """As in Kernel."""
        from fenics_rom.runtime.steppers.frame_adjoint import Acting, FramePart
        from fenics_rom.runtime.steppers.parted_adjoint import Ends, PartedAdjoint

        before, after = self._motion_of(self._frame_before, self._now_before), self._motion_of(self.frame, self._now)
        (e, r), (e_after, r_after) = self._state_before.reshape(2, -1), self.state.reshape(2, -1)
        start = Moving(*before, e * self._inverse_ω, r.copy())
        end = Moving(*after, e_after * self._inverse_ω, r_after.copy())
        v, (residual, rows_after) = (r + r_after) / 2, residual_taken(self.residual)
        middle, reach = start.q + self.h / 2 * v, self.h / 2
        acting = Acting(self._loads, self._acting_forces, self._following, self._acting, middle, reach, self.ties)
        contact, is_kink = contact_adjoint(self._interface)
        moved = self.h / 2, start.q, end.q, v
        part = FramePart(
            InertiaSlopes(self._constants, self._second),
            self._turned_by,
            (start, end),
            acting,
            self.elastic.adjoint() if self.elastic is not None else linear_taken(self._model, *moved, None),
            found_taken(self._found, u, self.reactions, (self.h, start.q, r.copy(), v, middle)),
            residual,
            None if contact is None else self._touched_points(contact, start, v),
        )
        ends, given = Ends(self._model.safe_frequencies, 0, start.q, end.q, rows_after), None
        if self._found is not None:
            given = self._found.stroke_slopes(start.q).T
        return PartedAdjoint((part,), ends, is_kink, given)

    def _touched_points(self, contact: "ContactAdjoint", start: Moving, v: Array) -> "TouchedPoints | None":
        from fenics_rom.runtime.steppers.frame_adjoint import TouchedPoints

        if self.contact is None:
            return None
        places, kept = self.points.rest + self.points.moved(start.q), self.points.moved(start.r)
        inside = self.points.moved(v)
        if self.residual is not None:
            _, y, _, ẏ = self.residual.carried_before[:4].reshape(4, -1, 3)
            places, kept = places + y, kept + ẏ
            inside = inside + (self.residual.displacement - y) / self.h
        return TouchedPoints(self.points.rows, places, inside, kept, start.ω, self.contact.forces, contact)
