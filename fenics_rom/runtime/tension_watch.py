"""Tendons that were given tensions below 0: a cable does not push, and a model of it does as it is told."""

from collections.abc import Mapping

from numpy import ndarray as Array

from fenics_rom.rom.rom import Rom


class TensionWatch:
    """Keeps the least tension that each tendon of a ROM was given in a run, where it is below 0.

    Attributes:
        least: N, by name; of those alone that were told to push.
    """

    def __init__(self, rom: Rom):
        self._rom, self.least, self._columns = rom, dict[str, float](), tuple[tuple[str, int], ...]()

    def enter(self, contact: str) -> bool:
        """Goes on with inputs of a contact mode; whether there is a tendon to watch."""
        self._columns = tuple(pulled_columns(self._rom, self._rom.contacts[contact]).items())
        return bool(self._columns)

    def note(self, u: Array) -> None:
        """Of an input (p,)."""
        for name, column in self._columns:
            if (tension := u.item(column)) < 0.0 and tension < self.least.get(name, 0.0):
                self.least[name] = tension

    def note_all(self, inputs: Array) -> None:
        """Of inputs (steps, p)."""
        for name, column in self._columns:
            if (tension := float(inputs[:, column].min(initial=0.0))) < self.least.get(name, 0.0):
                self.least[name] = tension


def pulled_columns(rom: Rom, start: int) -> dict[str, int]:
    """Columns of the input, of tendons whose tension is given, by name; those of all actuators begin at start."""
    columns: dict[str, int] = {}
    for name, count in rom.actuators.items():
        if rom.environment.is_pulled(name):
            columns[name] = start
        start += count
    return columns


def push_messages(least: Mapping[str, float]) -> tuple[str, ...]:
    """What to say of tendons by the least tension, N, that each was given."""
    return tuple(
        f"effects.tendon.{name}: its tension was down to {tension:.3g} N: a cable does not push, and the model let it; "
        "use tensions >= 0 N"
        for name, tension in least.items()
    )
