"""The maps between the contact modes of a ROM that is run, and what a switch took out of the state."""

from dataclasses import dataclass

from numpy import ndarray as Array

from fenics_rom.rom.rom import Rom
from fenics_rom.rom.switch_maps import switch_maps

REPORTED_LOSS = 0.01  # share of the stored energy, lost in one switch: some 10 % of a shape


@dataclass(frozen=True)
class SwitchLoss:
    """What a switch took out of the state, because the next contact mode's model cannot hold it."""

    energy: float = 0.0  # J
    share: float = 0.0  # of what was stored
    start: str = ""  # contact modes
    end: str = ""
    time: float = 0.0  # s

    @property
    def message(self) -> str:
        """What the user should know; empty where little was lost."""
        if self.share <= REPORTED_LOSS:
            return ""
        return (
            f"switching from {self.start!r} to {self.end!r} at t = {self.time:.4g} s lost {100 * self.share:.2g} % of "
            f"the stored energy ({self.energy:.2g} J), as the next model cannot hold all of that shape; a higher order "
            "loses less"
        )


class Projections:
    """The maps between the contact modes of a ROM, each found when it is first asked for."""

    def __init__(self, rom: Rom):
        self._rom = rom
        self._maps: dict[tuple[str, str], tuple[Array, Array]] = {}

    def between(self, start: str, end: str) -> tuple[Array, Array]:
        """Maps of ω q and of r, each (m_end, m_start), from one contact mode to another."""
        if (start, end) not in self._maps:
            rom, models = self._rom, self._rom.contact_models
            self._maps[start, end] = switch_maps(rom.stiffness, models[start], models[end], rom.switching)
        return self._maps[start, end]
