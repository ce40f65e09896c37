"""The steps of the bodies of a batch: linear ones, those among obstacles, and steppers of another kind."""

import math
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.body_axis import in_one_piece
from fenics_rom.runtime.batch_arrays import Segment
from fenics_rom.runtime.joint_state import BY_CONTACT, BY_OBSTACLES, DISSIPATED, SUPPLIED, TIME, JointState

if TYPE_CHECKING:
    from fenics_rom.runtime.batch_contact import BatchContact

MOST_TOGETHER = 1024  # bodies whose contact is found together: what their arrays take is bounded


class BatchStepper(Protocol):
    """Takes the steps of bodies that are not linear in a fixed frame; keeps what it needs besides q and r.

    Attributes:
        refuses: why a body could not take its step, in words.
        distrusted: bodies (B,) that went, since they began, where their model is not to be trusted.
    """

    refuses: str

    @property
    def distrusted(self) -> Array:
        """See above."""

    def set_time_step(self, h: float) -> None:
        """Of all bodies, s."""

    def begin(self, bodies: Array, q: Array, r: Array) -> None:
        """Bodies (B,) are put to q and r (B, m)."""

    def reset(self, bodies: Array) -> None:
        """What else bodies have is as when they began."""

    def entered(self, bodies: Array) -> None:
        """Bodies are in another contact mode."""

    def energy(self, bodies: Array, q: Array, r: Array) -> Array:
        """Stored (B,), J."""

    def step(self, mode: Array, q: Array, r: Array, u: Array) -> tuple[Array, Array]:
        """Mid-step velocities (m, B) from q and r (m, B) under u (B, p), not finite where lost; works (2, B), J."""

    def accept(self, held: Array, q: Array) -> None:
        """The step is taken, to q (m, B), but for bodies that are held."""


class SteppedBodies(JointState):
    """Bodies that go from step to step."""

    def switch(self, modes: Array, bodies: Array) -> None:
        """Makes contact modes active, by their numbers (B,), of bodies (B,)."""
        raise NotImplementedError

    def _step_linear(self, u: Array, held: Array) -> None:
        """The step of linear bodies under inputs and loads (size, p), but for those held."""
        contacts, near = self._contacts, []
        layout, (factors, push, couplings) = self._layout, self._coefficients
        chunks = layout.sort(factors)
        if len(held):
            before = layout.state[:, layout.row[held]], self._account[:, held]
        np.take(u, layout.body, axis=0, out=layout.inputs, mode="clip")  # the other modes of take go through a buffer
        for x, r, elastic, inertial, w, spare, segments in chunks:
            for segment in segments:
                np.matmul(segment.u, push[segment.mode], out=segment.w)
            np.multiply(elastic, x, out=spare)
            np.add(w, spare, out=w)
            np.multiply(inertial, r, out=spare)
            np.add(w, spare, out=w)
            driven = w if contacts is None or not any(couplings) else w.copy()
            for segment in segments:
                self._respond(segment, couplings[segment.mode], self._works[:, segment.rows])
            if contacts is not None:
                first, last = segments[0].rows.start, segments[-1].rows.stop
                found = contacts.look(layout.body[first:last], w, r).nonzero()[0]
                near.append((first + found, *(np.take(part, found, axis=0) for part in (x, r, driven))))
            np.add(x, w, out=x)
            np.subtract(w, r, out=r)
        self._account[TIME] += self._dt
        if contacts is not None:
            self._meet_obstacles(contacts, *(np.concatenate(parts) for parts in zip(*near, strict=True)))
            contacts.end_step()
        if self.ledger:
            self._account[SUPPLIED : DISSIPATED + 1] += self._dt / 2 * np.take(self._works, layout.row, axis=1)
        self.steps += 1
        if len(held):
            layout.state[:, layout.row[held]], self._account[:, held] = before

    def _step_otherwise(self, stepper: BatchStepper, u: Array, held: Array, on_error: str) -> Array:
        """The step that a stepper takes; the bodies that did not."""
        layout = self._layout
        x, r = layout.state[:, layout.row].transpose(0, 2, 1)
        v, works = stepper.step(layout.mode, self._dt / 2 * x, r, u)
        lost = ~(np.isfinite(v).all(axis=0) & np.isfinite(works).all(axis=0))
        if lost.any():
            lost[held] = False
            if lost.any() and on_error == "raise":
                raise StepError(
                    f"step {self.steps}, body {lost.argmax()}: {stepper.refuses}; all bodies were left as they were"
                )
            held = np.union1d(held, lost.nonzero()[0])
        goes = np.ones(self.size, bool)
        goes[held] = False
        x, r = np.where(goes, x + 2 * v, x), np.where(goes, 2 * v - r, r)
        layout.state[:, layout.row] = x.T, r.T
        stepper.accept(held, self._dt / 2 * x)
        self._account[TIME] += self._dt * goes
        if self.ledger:
            self._account[SUPPLIED : DISSIPATED + 1] += np.where(goes, works, 0.0)
        self.steps += 1
        return held

    def _respond(self, segment: Segment, coupling: tuple[Array, Array] | None, works: Array) -> None:
        """Makes w = 2 v̂ of what drives the bodies, and notes works (2, rows) of inputs and damping, in 2/h J."""
        if self.ledger:
            drawn = segment.w if coupling is None else np.matmul(segment.w, coupling[1], out=segment.spare)
            np.multiply(drawn, drawn, out=segment.spare)
            np.matmul(segment.spare, self._models.dissipation[segment.mode], out=works[1])
        if coupling is not None:
            segment.w[:] = np.matmul(segment.w, coupling[0], out=segment.spare)
        if self.ledger:
            force = np.matmul(segment.u, self._models.inputs[segment.mode], out=segment.spare)
            np.multiply(force, segment.w, out=force)
            np.matmul(force, self._ones, out=works[0])

    def _follow_obstacles(self, contacts: "BatchContact") -> None:
        """Makes the contact modes active that obstacles are nearest to, of the bodies that are near one."""
        bodies = contacts.watched()
        if len(bodies):
            nearest = contacts.nearest_modes(self._layout.mode[bodies], self.state(bodies)[0], bodies)
            self.switch(nearest, bodies)

    def _meet_obstacles(self, contacts: "BatchContact", rows: Array, x: Array, r: Array, driven: Array) -> None:
        """Takes the step of rows (B,) again, with contact.

        Args:
            contacts: of all bodies.
            rows: which.
            x, r: (B, m) where they were.
            driven: (B, m) what drives them without contact, as `StepCoefficients.push` has it; made another.
        """
        layout, couplings = self._layout, self._coefficients.coupling
        modes = layout.mode[layout.body[rows]]
        for mode in np.unique(modes).tolist():
            inside = (modes == mode).nonzero()[0]
            for part in np.array_split(inside, math.ceil(len(inside) / MOST_TOGETHER)):
                within, own = in_one_piece(part), in_one_piece(rows[part])
                x_own, r_own, w, coupling = x[within], r[within], driven[within], couplings[mode]
                u, bodies, works = layout.inputs[own], layout.body[own], np.zeros((2, len(x_own)))
                free = w if coupling is None else w @ coupling[0]
                touched, pushed, done = contacts.step(mode, bodies, x_own, r_own, free)
                w[in_one_piece(touched)] += pushed
                self._respond(Segment(mode, slice(0), u, w, np.empty_like(w)), coupling, works)
                layout.state[0, own], layout.state[1, own] = x_own + w, w - r_own
                if self.ledger:
                    self._works[:, own] = works
                    self._account[BY_OBSTACLES : BY_CONTACT + 1, bodies] += done[:2]
                    self._account[SUPPLIED : DISSIPATED + 1, bodies] += done[0], done[1] + done[2]
