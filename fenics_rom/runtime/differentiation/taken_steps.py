"""Back through steps that were taken one by one: with contact, or of bodies that deform largely.

The run is taken once, and saved at the beginning of each block of steps. Then, the last block first, each is taken
again with its steps recorded, and gone back through: each kernel tells how (`Kernel.adjoint`).
"""

import math
import warnings
from collections.abc import Iterator, Sequence
from copy import copy
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import FenicsRomWarning
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.differentiation.gradient import Objective, RolloutGradient, evaluate
from fenics_rom.runtime.rollout import ConstantInterval
from fenics_rom.runtime.simulated_body import SimulatorState
from fenics_rom.runtime.simulator import Simulator
from fenics_rom.runtime.steppers.adjoint import Reads, StateAdjoint, StepAdjoint, SwitchAdjoint

LEAST_BLOCK = 4096  # steps that are recorded at once; of long runs as many as there are blocks
KINKS_SHOWN = 5
NONE = np.empty(0)


class _Recorded(NamedTuple):
    """A step, and the switches before it."""

    step: StepAdjoint
    contact: str
    switches: list[SwitchAdjoint]


class _Run:
    """Steps of a body, forwards once, and backwards.

    Args:
        body: where they begin; it is not moved.
        u, plan, names, switches: as in `differentiate_taken`.
    """

    def __init__(
        self, body: Simulator, u: Array, plan: Sequence[ConstantInterval], names: Sequence[str], switches: bool
    ):
        self.body, self._u, self._names, self._switches = copy(body), u, names, switches
        self._of_step = [interval for interval in plan for _ in range(interval.start, interval.stop)]
        self._block = max(LEAST_BLOCK, math.isqrt(len(u)))
        self._saved: list[tuple[SimulatorState, Array]] = []
        self._recorded: list[_Recorded] = []  # of the last block that was taken

    def forwards(self) -> tuple[Array, Array]:
        """Takes all steps; what outputs show after each, (steps, rows), and the energies (steps,)."""
        steps, body = len(self._u), self.body
        rows, energies = np.empty((steps, sum(len(body.output_rows(name)) for name in self._names))), np.empty(steps)
        for start in range(0, steps, self._block):
            self._save()
            is_last = start + self._block >= steps
            for step in range(start, min(start + self._block, steps)):
                self._take(step, is_last)
                rows[step] = np.concatenate([NONE, *(body.displacement(name).ravel() for name in self._names)])
                energies[step] = body.energy
        return rows, energies

    def backwards(self) -> Iterator[tuple[int, _Recorded]]:
        """All steps and their numbers, the last one first."""
        for block in reversed(range(len(self._saved))):
            start = block * self._block
            if block < len(self._saved) - 1:
                self._go_back(block)
                for step in range(start, start + self._block):
                    self._take(step, records=True)
            recorded, self._recorded = self._recorded, []
            while recorded:
                yield start + len(recorded) - 1, recorded.pop()

    def _save(self) -> None:
        """Notes where a block begins; steps go on as if it had not been asked."""
        kernel = self.body.integrator.kernel
        tangent = kernel.tangent
        self._saved.append((self.body.save(), tangent))
        kernel.tangent = tangent

    def _go_back(self, block: int) -> None:
        """To where a block begins."""
        state, tangent = self._saved[block]
        self.body.restore(state)
        self.body.integrator.kernel.tangent = tangent

    def _take(self, step: int, records: bool) -> None:
        """Takes a step, and may record it."""
        body, interval, switches = self.body, self._of_step[step], list[SwitchAdjoint]()
        body.dt = interval.dt
        if self._switches:
            switches += self._switched_to(interval.contact)
        switches += self._switched_to(body.nearest_contact)
        body.step(self._u[step])
        if records:
            loads = NONE if body.environment is None else body.environment.loads
            taken = body.integrator.kernel.adjoint(np.concatenate([self._u[step], loads]))
            self._recorded.append(_Recorded(taken, body.contact, switches))

    def _switched_to(self, contact: str) -> list[SwitchAdjoint]:
        """Makes a contact mode active; the switch, if it was not."""
        if contact == self.body.contact:
            return []
        switch = self.body.integrator.switch_adjoint(contact)
        self.body.switch(contact)
        return [switch]


def differentiate_taken(
    body: Simulator,
    u: Array,
    plan: Sequence[ConstantInterval],
    objective: Objective,
    names: Sequence[str],
    *,
    switches: bool,
) -> RolloutGradient:
    """As differentiate, of inputs without loads (steps, p), and with names of outputs that there are.

    `switches`: whether the contact modes of the plan were asked for; else obstacles may ask for others.
    """
    rom, kernel, (q, r) = body.rom, body.integrator.kernel, body.state
    kernel.check_differentiable()
    run = _Run(body, u, plan, names, switches)
    value, slopes, energy_slopes = evaluate(objective, body, names, *run.forwards())

    models = {} if rom.deformation is not None else rom.contact_models
    along_ω = {name: np.zeros_like(model.eigenvalues) for name, model in models.items()}
    along_D = {name: np.zeros_like(model.damping) for name, model in models.items()}
    rows = {name: _rows(rom, name, names) for name in rom.contact_models}
    inputs, kinks, last = np.zeros(u.shape), list[int](), run.body.integrator.kernel
    μ = StateAdjoint(0 * last.state, np.zeros(rom.rigid), 0 * last.auxiliary)
    for step, (taken, contact, switches_before) in run.backwards():
        of_q, of_beyond = rows[contact]
        reads = Reads(slopes[step] @ of_q, slopes[step] @ of_beyond, float(energy_slopes[step]))
        μ, by_inputs, by_frequencies, by_damping = taken.pull_back(μ, reads)
        inputs[step] = by_inputs[: u.shape[1]]
        if models:
            along_ω[contact] += by_frequencies
            along_D[contact] += by_damping
        if taken.is_kink:
            kinks.append(step)
        for switch in reversed(switches_before):
            μ = switch.pull_back(μ)
    if models:
        along_ω[body.contact] += μ.state[: len(q)] * q
    state = kernel.start_pulled_back(q, r, μ)
    along_γ = {name: _by_eigenvalues(rom, name, along) for name, along in along_ω.items()}
    _tell(kinks[::-1], len(u))
    return RolloutGradient(value, inputs, state, along_γ, along_D, tuple(kinks[::-1]))


def _rows(rom: Rom, contact: str, names: Sequence[str]) -> tuple[Array, Array]:
    """What outputs show of q (rows, m) of a contact mode, and of what is beyond it, (rows, k - rigid)."""
    rows = np.concatenate([np.empty((0, len(rom.stiffness))), *(rom.outputs[name] for name in names)])
    return rows @ rom.contact_models[contact].coordinates, rows[:, rom.rigid :] / np.sqrt(rom.stiffness[rom.rigid :])


def _by_eigenvalues(rom: Rom, contact: str, along_ω: Array) -> Array:
    """∂J/∂γ (m,) from ∂J/∂ω; 0 of rigid motions."""
    by_γ, ω = np.zeros(len(along_ω)), np.sqrt(rom.contact_models[contact].eigenvalues[rom.rigid :])
    by_γ[rom.rigid :] = along_ω[rom.rigid :] / (2 * ω)
    return by_γ


def _tell(kinks: Sequence[int], steps: int) -> None:
    if kinks:
        shown = ", ".join(map(str, kinks[:KINKS_SHOWN])) + (", ..." if len(kinks) > KINKS_SHOWN else "")
        warnings.warn(
            f"{len(kinks)} of {steps} steps ({shown}) are at a kink, where a point begins or ceases to touch or to "
            "slip: there the gradient is that of the side which the step found",
            FenicsRomWarning,
            stacklevel=4,
        )
