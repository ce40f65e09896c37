"""Gas in the chambers of many bodies of one ROM that compiled loops step."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.compiled.gas import Filled, store_in_gas
from fenics_rom.mechanics.compiled.searched_forces import Actuators
from fenics_rom.runtime.compiled_mode import Mode
from fenics_rom.runtime.simulator import Simulator


class FilledBodies:
    """What was blown into them, and what that stores."""

    _single: Simulator
    _modes: list[Mode]
    _mode: Array  # number of the mode of each (size,)
    _filled: Filled

    def _gas_energy(self, bodies: Array) -> Array:
        """What gas of some bodies stores (B,), J."""
        stored = np.zeros(len(bodies))
        if self._single.filling is None:
            return stored
        for number, mode in enumerate(self._modes):
            at = (self._mode[bodies] == number).nonzero()[0]
            if len(at):
                given, strokes = self._strokes_of(mode, bodies[at])
                own = np.zeros(len(at))
                store_in_gas(given, strokes, self._filled.amounts[bodies[at]], own)
                stored[at] = own
        return stored

    def _strokes_of(self, mode: Mode, bodies: Array) -> tuple[Actuators, Array]:
        """What is found in steps, and strokes (B, n) of some bodies in a contact mode."""
        pulled, states = mode.body.pulled, mode.states
        q = states.halves[bodies, 0] * mode.body.inverse_ω
        q[:, : self._single.rom.rigid] = states.rigid[bodies]
        return pulled.actuators, q @ pulled.lines.T

    def _gas_of(self, body: int) -> dict[str, float]:
        """What was blown into chambers of a body, m³, by name."""
        return dict(zip(self._single.stroke_names, self._filled.amounts[body].tolist(), strict=False))
