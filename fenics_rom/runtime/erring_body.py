"""A body that knows how far it is from the full order; `Simulator` moves it."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.runtime.moving_body import MovingBody

if TYPE_CHECKING:
    from fenics_rom.runtime.error_watch import ErrorState, ErrorWatch, StatedError


class ErringBody(MovingBody):
    """What there is to tell of errors; nothing is kept where that was not asked for."""

    errors: "ErrorWatch | None" = None
    _untold = ""  # why there are none

    @property
    def stated_errors(self) -> "dict[str, StatedError]":
        """Bound and estimate by these names, where they are kept."""
        return {} if self.errors is None else {"bound": self.error_bound, "estimate": self.error_estimate}

    @property
    def error_bound(self) -> "StatedError":
        """What the error against the full order, with the same steps, is no larger than: see `StatedError`.

        It is counted from rest, or from the last state that was put in, which the full order is taken to be in, too.

        Raises:
            StepError: it is not known.
        """
        return self._told_errors().bound(self.contact, self._stepper.state)

    @property
    def error_estimate(self) -> "StatedError":
        """About what that error is, by a finer model.

        Raises:
            StepError: it is not known.
        """
        return self._told_errors().estimate(self.contact, self._stepper.state)

    def _told_errors(self) -> "ErrorWatch":
        if self.errors is None:
            raise StepError(f"errors are not known: {self._untold}")
        self._stepper.flush()
        return self.errors

    def _watch_errors(self, asked: bool | None) -> None:
        """Begins to keep errors, if that is asked for; None: if the ROM knows how.

        Raises:
            StepError: they are asked for, and cannot be known.
        """
        rom = self.rom
        if rom.error_model is not None and asked is not False:
            from fenics_rom.rom.error_model import untold_errors  # here, as few runs tell their errors
            from fenics_rom.runtime.error_maps import ErrorMaps
            from fenics_rom.runtime.error_watch import ErrorWatch

            acting = rom.environment if self.environment is None else self.environment.environment
            reason = untold_errors(acting, deforms=rom.deformation is not None)
            self._untold = f"of a run with {reason}" if reason else ""
            if not reason:
                self.errors = ErrorWatch(rom, ErrorMaps(rom))
        else:
            made = "fr.reduce(system, errors=True), or with run.errors = true in its scene"
            self._untold = "errors = False was given" if asked is False else f"ROM {rom.name!r} was not made by {made}"
        if asked and self.errors is None:
            raise StepError(f"errors = True: {self._untold}")

    def _note_inputs(self, inputs: Array) -> None:
        """Takes in the inputs (n, p) of booked steps of the kernel that is stepping."""
        assert self.errors is not None
        self.errors.note(self.contact, self._stepper.kernel.h, inputs)
        self.tensions.note_all(inputs)

    def _begin_errors(self, saved: "ErrorState | None" = None) -> None:
        """Goes on from errors that were saved; without, they are counted from the state that the body is in."""
        if self.errors is not None and saved is not None:
            self.errors.state = saved
        elif self.errors is not None:
            self.errors.begin(self.contact, self._stepper.state)

    def _way_to_advance(self) -> Callable[[Array], float]:
        """As in MovingBody."""
        advance = super()._way_to_advance()
        if self.errors is not None:
            kernel: Any = self._stepper.kernel
            kernel.note_inputs = self._note_inputs
        return advance
