"""A body that knows how far it is from the full order; `Simulator` moves it."""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError, unknown
from fenics_rom.mechanics.environment import given_environment
from fenics_rom.runtime.error_tolerance import ADVICE, NO_MORE, Exceeded, checked_tolerance, tell
from fenics_rom.runtime.moving_body import MovingBody

if TYPE_CHECKING:
    from os import PathLike

    from fenics_rom.mechanics.base_path import BaseState
    from fenics_rom.mechanics.signals import SignalLike
    from fenics_rom.rom.rom import Rom
    from fenics_rom.runtime.error_watch import ErrorState, ErrorWatch, StatedError
    from fenics_rom.runtime.finer_beside import FinerBeside
    from fenics_rom.runtime.simulated_body import BesideState

NO_BOUND = "error_bound: a ROM beside gives an estimate alone; use error_estimate"


class ErringBody(MovingBody):
    """What there is to tell of errors; nothing is kept where that was not asked for."""

    errors: "ErrorWatch | None" = None
    beside: "FinerBeside | None" = None  # what states them where a finer ROM takes the same steps
    _advance: Callable[[Array], float]
    _untold = ""  # why there are none
    _errors_before: "ErrorState | None" = None  # the last step that was noted by itself
    whose, advice = "", ADVICE  # beginning and end of what is said of the tolerance

    @property
    def told_by(self) -> "ErrorWatch | FinerBeside | None":
        """What states errors; None where they are not known."""
        return self.errors or self.beside

    @property
    def error_tolerance(self) -> float | None:
        """What the estimate of any output's error is to be no larger than, m; None: whatever it is."""
        return None if self.told_by is None else self.told_by.tolerance

    @property
    def exceeded(self) -> Exceeded | None:
        """Where the estimate was first larger than the tolerance: time, s, error, m, output; None where it was not."""
        return None if self.told_by is None else self.told_by.exceeded

    @property
    def warnings(self) -> tuple[str, ...]:
        """As in SimulatedBody; and where the error was beyond its tolerance."""
        exceeded, tolerance = self.exceeded, self.error_tolerance
        told = () if exceeded is None or tolerance is None else (exceeded.message(tolerance, self.advice),)
        return super().warnings + told

    @property
    def stated_errors(self) -> "dict[str, StatedError]":
        """Bound and estimate by these names, as far as they are known."""
        if self.told_by is None:
            return {}
        bound = {} if self.errors is None or self.errors.maps.touched else {"bound": self.error_bound}
        return bound | {"estimate": self.error_estimate}

    @property
    def error_bound(self) -> "StatedError":
        """What the error against the full order, with the same steps, is no larger than, but for round-off.

        It is of the full order under the same inputs, and counted from rest, or from the last state that was put in,
        which the full order is taken to be in, too.

        Raises:
            StepError: it is not known.
        """
        if self.beside is not None:
            raise StepError(NO_BOUND)
        return self._told_errors().bound(self.contact, self._stepper.state)

    @property
    def error_estimate(self) -> "StatedError":
        """About what that error is, by a finer model.

        Raises:
            StepError: it is not known.
        """
        if self.beside is not None:
            return self.beside.stated()
        return self._told_errors().estimate(self.contact, self._stepper.state, self.beyond_shared)

    def set_signal(self, name: str, signal: "SignalLike") -> None:
        """Gives a load or an obstacle another value, or another function of time (s), from the next step on.

        Args:
            name: of gravity (multiples of its acceleration), a base motion (m/s²), a prescribed force (N) or an
                obstacle (its displacement, m, or with a motion a BaseState).
            signal: numbers, or a function that gives them.

        Raises:
            StepError: there is no such load or obstacle, or not so many numbers.
        """
        if self.environment is None:
            raise StepError(unknown("load or obstacle", name, []))
        self.environment.set_signal(name, signal)
        if self.beside is not None:
            self.beside.finer.set_signal(name, signal)
        self._advance = self._way_to_advance()

    def _told_errors(self) -> "ErrorWatch":
        if self.errors is None:
            raise StepError(f"errors are not known: {self._untold}")
        self._stepper.flush()
        return self.errors

    def _watch_errors(
        self, errors: bool | None, error_tolerance: float | None, finer: "Rom | str | PathLike[str] | None"
    ) -> None:
        """Begins to keep errors, if that is asked for; None: if the ROM knows how, within what the scene says.

        Raises:
            SceneError: `finer` is not one of higher order of the same body, or errors are known without.
            StepError: they, or a tolerance, are asked for, and cannot be known.
        """
        if finer is None:
            self._state_errors(errors, error_tolerance)
            return
        from fenics_rom.runtime.finer_beside import FinerBeside  # here, as few runs have one

        self._state_errors(errors, None)
        self.beside = FinerBeside(self, finer, error_tolerance, self._origin[1])

    def _state_errors(self, asked: bool | None, tolerance: float | None) -> None:
        """Begins to keep those that the ROM knows of itself."""
        rom, (given, acts, _) = self.rom, self._origin  # what acts here, as it was made
        tolerance = None if tolerance is None else checked_tolerance(tolerance)
        if asked is False:
            self._untold = "errors = False was given"
        elif given.error_model is None:
            made = "fr.reduce(system, errors=True), reduce --errors, or with run.errors = true in its scene"
            self._untold = f"ROM {rom.name!r} was not made by {made}"
        else:
            from fenics_rom.rom.error_model import untold_errors  # here, as few runs tell their errors
            from fenics_rom.runtime.error_maps import ErrorMaps
            from fenics_rom.runtime.error_watch import ErrorWatch

            plain = rom.environment if acts["scene"] is None else given_environment(acts["scene"])
            acting = plain if self.environment is None else self.environment.environment
            reason = untold_errors(acting, deforms=rom.deformation is not None)
            touched = acting.contact_law is not None
            if not reason and (rom.error_model is None or not (touched or rom.error_model.has_bound)):
                reason = "no damping"
            if reason:
                self._untold = f"a run with {reason} does not know its error"
            else:
                if tolerance is None and acting.run is not None:
                    tolerance = acting.run.error_tolerance
                self.errors = ErrorWatch(rom, ErrorMaps(rom, touched=touched), tolerance)
                self.advice = NO_MORE if touched else ADVICE
        if asked and self.errors is None:
            raise StepError(f"errors = True: {self._untold}")
        if tolerance is not None and self.errors is None:
            raise StepError(f"error_tolerance = {tolerance:g}: errors are not known: {self._untold}")

    @property
    def notes_each_step(self) -> bool:
        """Whether errors are kept step by step: by contact forces, known after each, or as they are looked at."""
        if self.errors is None:
            return False
        return self.errors.tolerance is not None or not self._stepper.kernel.holds_steps

    def _note_step(self, u: Array) -> None:
        """Takes in a step under inputs (p,), and the contact forces that were found in it, if steps are noted so."""
        errors = self.errors
        if errors is None or not self.notes_each_step:
            return
        inputs = u
        if errors.maps.touched:
            contact = self._stepper.contact  # asked for here alone: telling it takes as long as half a compiled step
            forces = np.zeros(len(self.contact_coordinates) * 3) if contact is None else contact.forces.ravel()
            inputs = np.concatenate([u, forces])
        self._errors_before = errors.state
        errors.note(self.contact, self._dt, inputs[None])
        if errors.tolerance is not None:
            beyond = self.beyond_shared if errors.maps.touched else None
            if found := errors.look(self.contact, self._stepper.state, beyond, self.time + self._dt):
                tell(self.whose + found.message(errors.tolerance, self.advice))

    def take_back_step(self, acted: tuple[Any, ...]) -> None:
        """As in MovingBody."""
        if self.errors is not None and self._errors_before is not None and self.notes_each_step:
            self.errors.state = self._errors_before
        if self.beside is not None:
            self.beside.take_back()
        super().take_back_step(acted)

    def place(self, pose: "BaseState") -> None:
        """As in MovingBody."""
        before = self.pose
        super().place(pose)
        if self.beside is not None:
            try:
                self.beside.finer.place(pose)
            except StepError:
                assert before is not None
                super().place(before)
                raise

    def _note_inputs(self, inputs: Array) -> None:
        """Takes in the inputs (n, p) of booked steps of the kernel that is stepping."""
        assert self.errors is not None
        self.errors.note(self.contact, self._stepper.kernel.h, inputs)
        self.tensions.note_all(inputs)

    def _begin_errors(self, saved: "ErrorState | BesideState | None" = None) -> None:
        """Goes on from errors that were saved; without, they are counted from the state that the body is in."""
        watch: Any = self.told_by
        if watch is not None and isinstance(saved, watch.saved_as):
            watch.state = saved
        elif self.errors is not None:
            self.errors.begin(self.contact, self._stepper.state)
        elif self.beside is not None:
            self.beside.begin()

    def _way_to_advance(self) -> Callable[[Array], float]:
        """As in MovingBody."""
        advance = super()._way_to_advance()
        if self.beside is not None:
            return self.beside.way_to_advance(advance)
        if self.errors is None:
            return advance
        if not self.notes_each_step:
            kernel: Any = self._stepper.kernel
            kernel.note_inputs = self._note_inputs
        elif self.environment is None:

            def advance_and_note(u: Array) -> float:
                twice = advance(u)
                if math.isfinite(twice):
                    self._note_step(u)
                return twice

            return advance_and_note
        return advance
