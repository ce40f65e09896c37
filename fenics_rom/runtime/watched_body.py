"""What is watched of a body while it runs, and told in its warnings: its skin, and the tensions of its tendons."""

from typing import TYPE_CHECKING, Any

from numpy import ndarray as Array

from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.stepper import ReducedStepper
from fenics_rom.runtime.tension_watch import TensionWatch, pulled_columns

if TYPE_CHECKING:
    from fenics_rom.mechanics.skin_watch import Told
    from fenics_rom.runtime.skin_looks import SkinLooks


class WatchedBody:
    """A body that is watched as it moves."""

    rom: Rom
    steps: int
    contact: Any  # the active contact mode
    _stepper: ReducedStepper
    _skin: "SkinLooks | None" = None  # None where no obstacle can come through it
    _tensions: TensionWatch | None = None  # None where no tendon is given a tension

    def look_at_skin(self) -> None:
        """Looks at what is in the body, if something may have gone in since the last look, or after enough steps."""
        if self._skin is not None and self.steps >= self._skin.next_check:
            self._skin.check()

    def _forget_places(self) -> None:
        """Takes note that the body was put elsewhere."""
        if self._skin is not None:
            self._skin.forget()

    @property
    def _told(self) -> "tuple[Told, ...]":
        """What went through the skin so far."""
        return () if self._skin is None else self._skin.watch.told

    def _begin_looks(self, told: "tuple[Told, ...]") -> None:
        """Goes on from what was told of the skin."""
        if self._skin is not None:
            self._skin.watch.begin(told, self.steps)
            self._skin.forget()
        if not told:
            self._tensions = None

    def _watch_tensions(self) -> None:
        """Takes note of tensions below 0 that tendons are given, in the active contact mode."""
        pulled = pulled_columns(self.rom, self.rom.contacts[self.contact])
        if not pulled:
            return
        if self._tensions is None:
            self._tensions = TensionWatch(pulled)
        self._tensions.enter(pulled)
        kernel: Any = self._stepper.kernel
        if kernel.holds_steps:
            kernel.note_inputs = self._tensions.note_all

    @property
    def least_tensions(self) -> dict[str, float]:
        """Least tensions, N, that tendons were given in the run so far, of those that were told to push."""
        self._stepper.flush()
        return {} if self._tensions is None else self._tensions.least

    def _note_input(self, u: Array) -> None:
        if self._tensions is not None:
            self._tensions.note(u)

    def note_inputs(self, inputs: Array) -> None:
        """Takes note of tensions below 0 among inputs (steps, p) of the active contact mode."""
        if self._tensions is not None:
            self._tensions.note_all(inputs)
