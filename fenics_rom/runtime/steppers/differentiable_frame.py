"""What a body in a moving frame tells of the step that it took, so that it can be gone back through."""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.frame_geometry import Geometry, vector
from fenics_rom.mechanics.frame_motion import rotation_of, turned
from fenics_rom.runtime.steppers.adjoint import NONE, contact_adjoint
from fenics_rom.runtime.steppers.elastic.carried_strains import StrainsCarried
from fenics_rom.runtime.steppers.elastic.strains_adjoint import StrainsAdjoint
from fenics_rom.runtime.steppers.expected_step import Expected
from fenics_rom.runtime.steppers.frame_slopes import InertiaSlopes, Moving, PointsMoved, StepTurn
from fenics_rom.runtime.steppers.frame_state import FrameState
from fenics_rom.runtime.steppers.taken_step import found_taken, linear_taken, residual_taken
from fenics_rom.runtime.steppers.touched_frame import TouchedFrame

if TYPE_CHECKING:
    from fenics_rom.mechanics.contact_adjoint import ContactAdjoint
    from fenics_rom.runtime.steppers.frame_adjoint import FramePart, TouchedPoints
    from fenics_rom.runtime.steppers.parted_adjoint import Expectation, PartedAdjoint


class DifferentiableFrame(TouchedFrame):
    """Arguments and attributes as in FrameKernel."""

    def _moving(self, frame: FrameState, motion: Any, e: Array, r: Array) -> Moving:
        """The body at one end of the last step."""
        v = motion.v if self._constants.carried else frame.velocity
        return Moving(np.array(frame.position), np.array(v), np.array(motion.ω), e * self._inverse_ω, r.copy())

    def adjoint(self, u: Array) -> "PartedAdjoint":
        """As in Kernel."""
        from fenics_rom.runtime.steppers.frame_adjoint import Acting, FramePart
        from fenics_rom.runtime.steppers.parted_adjoint import Ends, PartedAdjoint

        (e, r), (e_after, r_after) = self._state_before.reshape(2, -1), self.state.reshape(2, -1)
        start = self._moving(self._frame_before, self._now_before, e, r)
        end = self._moving(self.frame, self._now, e_after, r_after)
        ω̂ = (start.ω + end.ω) / 2
        turn = Geometry(self._now_before.R, self._now.R, vector(self.h * ω̂))
        v, (residual, rows_after) = (r + r_after) / 2, residual_taken(self.residual)
        law, moved = self.elastic, (self.h / 2, start.q, end.q, v)
        was = self.expectation if law is not None and law.is_exact else None
        middle, reach = start.q + self.h / 2 * v, self.h / 2
        if was is not None and isinstance(law, StrainsCarried):
            middle, reach = start.q + self.h / 2 * law.expected, 0.0
        edges = start.q + self.h / 2 * r, "velocity"
        if isinstance(law, StrainsCarried):
            edges = start.q + self.h / 2 * law.velocity_before, "law"
        forces = self._loads.at(self._acting) if law is None else self._forces  # a compiled step left none
        acting = Acting(self._loads, forces, self._following, self._acting, middle, reach, self.ties, *edges)
        contact, is_kink = contact_adjoint(self._interface)
        found = found_taken(self._found, u, self.reactions, (self.h, start.q, r.copy(), v, middle), follows=reach > 0)
        part = FramePart(
            InertiaSlopes(self._constants, self._second),
            StepTurn(turn, self.h, ω̂, self._constants.carried),
            (start, end),
            acting,
            law.adjoint() if law is not None else linear_taken(self._model, *moved, None),
            found,
            residual,
            None if contact is None else self._touched_points(contact, start, v),
        )
        ends, given = Ends(self._model.safe_frequencies, start.q, end.q, rows_after), None
        if self._found is not None:
            given = self._found.stroke_slopes(start.q).T
        expectation = None
        if was is not None and isinstance(law, StrainsCarried):
            expectation = self._expectation_taken(was, part, law)
        return PartedAdjoint((part,), ends, is_kink, given, False, expectation)

    def _expectation_taken(self, was: Expected, part: "FramePart", law: StrainsCarried) -> "Expectation":
        from fenics_rom.runtime.steppers.parted_adjoint import Expectation

        (start, end), step, h = part.ends, part.step, self.h
        taken = part.law
        assert isinstance(taken, StrainsAdjoint)
        v, by_spin, led = taken.velocity_before, 0.0, None
        if len(was.x):
            spin = was.x[:3]
            step = StepTurn(self._geometry_of(spin), h, spin)
            mean = np.zeros(3) if was.translation is None else was.translation
            by_spin = 0.0 if was.passed is None or h > 2 * was.passed[0] else h / was.passed[0]
            end = Moving(start.position + h * mean, 2 * mean - start.v, 2 * spin - start.ω, end.q, end.r)
        end = end._replace(q=start.q + h * v, r=2 * v - start.r)
        middle = start.q + h / 2 * v
        acting = part.acting._replace(
            forces=was.forces, u=was.u, middle=middle, reach=h / 2, edges=middle, guided_by="x"
        )
        pressed = None
        if was.pressed is not None:
            places = self.points.rest + self.points.moved(start.q)
            if self.residual is not None:
                places = places + self.residual.carried_before[1].reshape(-1, 3)
            pressed = PointsMoved(step, self.points.rows, places, self.points.moved(v)), was.pressed
        found = np.empty(0, dtype=int) if part.found is None else part.found.places
        before = part._replace(step=step, ends=(start, end), acting=acting, found=None, touched=None, pressed=pressed)
        of_T = was.T, was.lack, was.whole, law.farthest, law.made_tangent
        if self._constants.carried:
            there = end._replace(q=start.q + h * was.whole, r=2 * was.whole - start.r)
            led = before._replace(ends=(start, there))
        return Expectation(before, taken, found, *of_T, by_spin, led)

    def _geometry_of(self, spin: Array) -> Geometry:
        """How the frame would have turned in the last step with ω̂ (3,)."""
        a, b, c = (self.h * spin).tolist()
        return Geometry(self._now_before.R, rotation_of(*turned(self._frame_before.rotation, (a, b, c))), (a, b, c))

    @property
    def tangent(self) -> Array:
        """As in Kernel: that of what resists the shape."""
        return NONE if self.elastic is None else self.elastic.tangent

    @tangent.setter
    def tangent(self, tangent: Array) -> None:
        if self.elastic is not None:
            self.elastic.keep_tangent(tangent)

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
