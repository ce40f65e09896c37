"""The contact models of a ROM as a batch steps them: in arrays of one shape, those of lower order filled with zeros."""

from typing import NamedTuple

import numpy as np

from fenics_rom.errors import StepError, unknown
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.midpoint import compliance
from fenics_rom.runtime.switching import Projections

Array = np.ndarray


class StepCoefficients(NamedTuple):
    """What a step of one length multiplies with, for each of c contact models.

    Attributes:
        factors: (2, c, m) of x and of r: -a h²/4 γ and a, or without a where that is dense.
        push: (c, p, m) a h/2 G.
        coupling: where the damping is dense, aᵀ (m, m) and (R a)ᵀ (m, m), else None.
    """

    factors: Array
    push: Array
    coupling: list[tuple[Array, Array] | None]


class PaddedModels:
    """The c contact models of a ROM, with the largest of their orders m and of their contact columns.

    Args:
        rom: the reduced models.
        dtype: of what multiplies states.

    Attributes:
        names: of the contact modes.
        orders: (c,).
        contact_columns: of the contact mode that has most.
        frequencies: ω = √γ (c, m), rad/s; 1 where a model has less, as there x = 0.
        inputs: G (c, p, m).
        dissipation: of each, (m,), what makes wᵀDw/2 of the squares of w, or of those of R w where D is dense.
    """

    def __init__(self, rom: Rom, dtype: np.dtype):
        self._rom, self._dtype = rom, dtype
        models = rom.contact_models.values()
        self.names = list(rom.contact_models)
        self.contact_columns = max(rom.contacts.values())
        self.orders = np.array([model.order for model in models])
        m = self.orders.max()
        p = self.contact_columns + sum(rom.actuators.values()) + sum(rom.loads.values())
        self.frequencies = np.ones((len(self.names), m))
        self.inputs = np.zeros((len(self.names), p, m), dtype)
        for ω, G, model, contact in zip(self.frequencies, self.inputs, models, rom.contacts.values(), strict=True):
            ω[: model.order] = np.sqrt(model.eigenvalues)
            G[:contact, : model.order] = model.inputs[:, :contact].T
            G[self.contact_columns :, : model.order] = model.inputs[:, contact:].T
        self.dissipation = [
            (_pad(model.damping / 2, (m,)) if model.damping.ndim == 1 else np.ones(m) / 2).astype(dtype)
            for model in models
        ]
        self._projections = Projections(rom)
        self._switch_maps: dict[tuple[int, int], Array] = {}
        self._output_maps: dict[str, list[Array]] = {}

    def step_coefficients(self, h: float) -> StepCoefficients:
        """Those of steps of length h, s."""
        factors, push = np.zeros((2, *self.frequencies.shape), self._dtype), np.empty(self.inputs.shape, self._dtype)
        coupling: list[tuple[Array, Array] | None] = []
        for k, model in enumerate(self._rom.contact_models.values()):
            a, Ra = (4 / h * part for part in compliance(model, h))
            dense = a.ndim == 2
            angles = h / 2 * self.frequencies[k]
            diagonal = _pad(np.ones(model.order) if dense else a, angles.shape)
            factors[:, k] = -diagonal * angles**2, diagonal
            push[k] = diagonal * (h / 2 * self.inputs[k])
            square = (len(diagonal),) * 2
            maps = [_pad(part.T, square).astype(self._dtype) for part in (a, Ra)] if dense else None
            coupling.append(None if maps is None else (maps[0], maps[1]))
        return StepCoefficients(factors, push, coupling)

    def switch_map(self, start: int, end: int) -> Array:
        """What takes the rows x and r of one contact mode to another's, (2, m, m)."""
        if (start, end) not in self._switch_maps:
            potential, kinetic = self._projections.between(self.names[start], self.names[end])
            m, rigid = self.frequencies.shape[1], self._rom.rigid
            maps = _pad(np.stack([potential.T, kinetic.T]), (2, m, m))
            ω = self.frequencies[end]
            maps[0] *= self.frequencies[start][:, None] / np.where(ω > 0, ω, np.inf)
            maps[0, :rigid, :rigid] = np.eye(rigid)
            self._switch_maps[start, end] = maps.astype(self._dtype)
        return self._switch_maps[start, end]

    def output_maps(self, output: str) -> list[Array]:
        """What takes rows of each contact mode to a named output, (m, rows).

        Raises:
            StepError: no such output.
        """
        if output not in self._rom.outputs:
            raise StepError(unknown("output", output, self._rom.outputs))
        if output not in self._output_maps:
            rows, m = self._rom.outputs[output], self.frequencies.shape[1]
            maps = [(rows @ model.coordinates).T for model in self._rom.contact_models.values()]
            self._output_maps[output] = [_pad(map, (m, map.shape[1])).astype(self._dtype) for map in maps]
        return self._output_maps[output]


def _pad(part: Array, shape: tuple[int, ...]) -> Array:
    """An array of that shape, zero beyond the part."""
    whole = np.zeros(shape)
    whole[tuple(slice(n) for n in part.shape)] = part
    return whole
