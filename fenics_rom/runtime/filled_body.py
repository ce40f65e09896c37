"""Actuators of a body whose strokes or gas are given, and what its chambers hold."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from numpy import ndarray as Array

from fenics_rom.compilation import compiled, jit
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.runtime.last_step import NotesLastStep

if TYPE_CHECKING:
    from fenics_rom.mechanics.filling import Filling


class FilledBody(NotesLastStep):
    """A body in the words of its ROM."""

    filling: "Filling | None" = None  # None where no chamber holds gas

    @property
    def model(self) -> ContactModel:
        """Of the active contact mode."""
        raise NotImplementedError

    @property
    def _q(self) -> Array:
        raise NotImplementedError

    @property
    def stroke_names(self) -> tuple[str, ...]:
        """Of the actuators whose strokes or gas are given, in the order of their forces."""
        return () if self.environment is None else self.environment.stroke_names(self.rom.actuators)

    @property
    def reactions(self) -> dict[str, float]:
        """Forces of the actuators whose strokes are given, in the last step: tensions in N, pressures in Pa."""
        return dict(zip(self.stroke_names, map(float, self._stepper.reactions), strict=False))

    @property
    def gas(self) -> dict[str, float]:
        """What was blown into each chamber so far, m³ at ambient pressure."""
        return {} if self.filling is None else dict(self.filling.amounts)

    def _fill(self) -> None:
        """Begins to keep account of gas, if there is any."""
        if self.environment is None or not self.environment.environment.gases:
            return
        from fenics_rom.mechanics.filling import Filling  # here, as few chambers hold gas

        gases, by_valve = self.environment.environment.gases, None
        if compiled() and any(gas.orifice for gas in gases.values()):
            from fenics_rom.mechanics.compiled.gas import let_in  # as loops have it, to the bit

            by_valve = jit(let_in)
        self.filling = Filling(gases, self.rom.actuators, self._stroke_of, by_valve)

    def _stroke_of(self, chamber: str) -> float:
        """By how much it is larger than at rest, m³, to the bit as what takes steps has it."""
        from fenics_rom.runtime.readings import readable

        in_loops = getattr(self._stepper.kernel, "strokes_in_loops", None)
        if in_loops is not None:
            return float(in_loops[self.stroke_names.index(chamber)])
        return readable(self.rom, self.contact, self._q, self._q, model=self.model).stroke(chamber)

    def _refill(self, amounts: Mapping[str, float]) -> None:
        """Goes on with some gas, where the body was put somewhere."""
        if self.filling is not None:
            self.filling.resume(amounts)
