"""Back through steps that were taken one by one: with contact, or of bodies that deform largely.

The run is taken once, its steps recorded as long as there is memory for that, and then saved at the beginning of each
block of steps. Then, the last block first, each is taken again with its steps recorded, and gone back through: each
kernel tells how (`Kernel.adjoint`). Nothing of it keeps an account, so that it costs less than the run itself.
"""

import math
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import FenicsRomWarning
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.differentiation.base_twists import owed_to_twists
from fenics_rom.runtime.differentiation.gas_taken import GasAfter, GasBefore
from fenics_rom.runtime.differentiation.gradient import Objective, RolloutGradient, evaluate
from fenics_rom.runtime.rollout import ConstantInterval
from fenics_rom.runtime.simulated_body import SimulatorState
from fenics_rom.runtime.simulator import Simulator
from fenics_rom.runtime.steppers.adjoint import Reads, StateAdjoint, SwitchAdjoint, pose_pulled_back
from fenics_rom.runtime.steppers.parted_adjoint import PartedAdjoint

MEMORY = 512e6  # bytes of the steps that are recorded at once, beside a block
BLOCKS = 8  # that hold as many steps; of very long runs there are as many blocks as steps in each
MEASURED = 16  # one of so many records
KINKS_SHOWN = 5
NONE = np.empty(0)


class _Recorded(NamedTuple):
    """A step, and the switches before it."""

    step: PartedAdjoint
    contact: str
    shapes: Array  # of the coordinates in which it is gone back through, in the shared basis (k, m)
    switches: list[SwitchAdjoint]
    pose: BaseState | None  # of a moving frame after it
    gas: "tuple[GasBefore, GasAfter] | None"


class _Run:
    """Steps of a body, forwards once, and backwards.

    Args:
        body: where they begin; it is not moved.
        u, plan, names, base, switches: as in `differentiate_taken`.
    """

    def __init__(
        self,
        body: Simulator,
        u: Array,
        plan: Sequence[ConstantInterval],
        names: Sequence[str],
        base: Sequence[BaseState] | None,
        switches: bool,
    ):
        self.body, self._u, self._names, self._switches = _without_account(body), u, names, switches
        self._base = base
        self._of_step = [interval for interval in plan for _ in range(interval.start, interval.stop)]
        self._saved: list[tuple[SimulatorState, Array]] = []  # where blocks begin
        self._recorded: list[_Recorded] = []  # the first steps, or those of the last block that was taken

    @property
    def lengths(self) -> list[float]:
        """Of the steps, s."""
        return [interval.dt for interval in self._of_step]

    def forwards(self) -> tuple[Array, Array]:
        """Takes all steps; what outputs show after each, (steps, rows), and the energies (steps,)."""
        steps, body = len(self._u), self.body
        rows, energies = np.empty((steps, sum(len(body.output_rows(name)) for name in self._names))), np.empty(steps)
        self._first = steps  # that is not recorded
        memory, known = MEMORY, set[int]()
        for step in range(steps):
            if memory <= 0 and step < self._first:
                self._first, self._block = step, max(step // BLOCKS, math.isqrt(steps))
            records = step < self._first
            if not records and (step - self._first) % self._block == 0:
                self._save()
            self._take(step, records)
            if records and step % MEASURED == 0:
                size, known = _size_of(self._recorded[-1], known)
                memory -= MEASURED * size if step else 0  # all share much with the first one
            rows[step] = np.concatenate([NONE, *(body.displacement(name).ravel() for name in self._names)])
            energies[step] = body.energy
        return rows, energies

    def backwards(self) -> Iterator[tuple[int, _Recorded]]:
        """All steps and their numbers, the last one first."""
        first_ones, self._recorded = self._recorded, []
        for block in reversed(range(len(self._saved))):
            start = self._first + block * self._block
            self._go_back(block)
            for step in range(start, min(start + self._block, len(self._u))):
                self._take(step, records=True)
            while self._recorded:
                yield start + len(self._recorded) - 1, self._recorded.pop()
        while first_ones:
            yield len(first_ones) - 1, first_ones.pop()

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
        if records:  # else the step itself asks
            switches += self._switched_to(body.nearest_contact)
        filling, u, gas = body.filling, self._u[step], None
        before = GasBefore.of(body, filling, u) if records and filling is not None else None
        body.step(u, base=None if self._base is None else self._base[step])
        if records:
            loads = NONE if body.environment is None else body.environment.loads
            if filling is not None and before is not None:
                gas, u = (before, GasAfter.of(body, filling)), filling.last(u)
            taken = body.integrator.adjoint(np.concatenate([u, loads]))
            shapes = body.integrator.adjoint_model.coordinates
            self._recorded.append(_Recorded(taken, body.contact, shapes, switches, body.pose, gas))

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
    base: Sequence[BaseState] | None,
    *,
    switches: bool,
) -> RolloutGradient:
    """As differentiate, of inputs without loads (steps, p), and with names of outputs that there are.

    `switches`: whether the contact modes of the plan were asked for; else obstacles may ask for others.
    """
    rom, kernel, (q, r) = body.rom, body.integrator.kernel, body.state
    run = _Run(body, u, plan, names, base, switches)
    read, energies = run.forwards()
    value, slopes, energy_slopes = evaluate(objective, body, names, read, energies)

    models = {} if rom.deformation is not None else rom.contact_models
    along_ω = {name: np.zeros_like(model.eigenvalues) for name, model in models.items()}
    along_D = {name: np.zeros_like(model.damping) for name, model in models.items()}
    inputs, kinks, last = np.zeros(u.shape), list[int](), run.body.integrator.adjoint_kernel
    shown_rows, beyond_rows = _rows(rom, names)
    moves, points, led = body.pose is not None, _points_of(rom, names), list[tuple[Array, BaseState]]()
    is_carried, frame = body.base_wrench is not None, np.zeros(15 if moves else 0)
    μ = StateAdjoint(0 * last.state, np.zeros(rom.rigid), 0 * last.auxiliary, frame=frame)
    owed = np.zeros(0 if body.filling is None else len(body.filling.amounts))  # to what was blown in so far
    for step, (taken, contact, shapes, switches_before, pose, gas) in run.backwards():
        shown, place = slopes[step], NONE
        if pose is not None:
            shown, place = _seen(pose, points + read[step].reshape(-1, 3), shown.reshape(-1, 3))
        by_q = shown @ shown_rows @ shapes
        if gas is not None:
            by_q, owed = by_q + energy_slopes[step] * gas[1].by_q, owed + energy_slopes[step] * gas[1].by_amount
        reads = Reads(by_q, shown @ beyond_rows, float(energy_slopes[step]), place)
        μ, by_inputs, by_frequencies, by_damping, base_ = taken.pull_back(μ, reads)
        if is_carried and pose is not None:
            led.append((base_, pose))
        inputs[step] = by_inputs[: u.shape[1]]
        if gas is not None:
            owed, inputs[step, gas[0].columns], at_start = gas[0].pull_back(owed + inputs[step, gas[0].columns])
            ρ, m = len(μ.rigid), len(at_start)
            scaled = at_start / taken.ends.ω
            μ.state[ρ:m] += scaled[ρ:]
            μ.rigid[:] += at_start[:ρ]
        if taken.span is not None:  # whose γ and D are of what was found
            models, along_ω, along_D = {}, {}, {}
        if models:
            along_ω[contact] += by_frequencies
            along_D[contact] += by_damping
        if taken.is_kink or any(switch.is_kink for switch in switches_before):
            kinks.append(step)
        for switch in reversed(switches_before):
            μ = switch.pull_back(μ)
    μ = body.integrator.start_adjoint(μ)
    if models:
        along_ω[body.contact] += μ.state[: len(q)] * q
    state = kernel.start_pulled_back(q, r, μ)
    along_γ = {name: _by_eigenvalues(rom, name, along) for name, along in along_ω.items()}
    _tell(kinks[::-1], len(u))
    start = {} if body.pose is None else pose_pulled_back(body.pose, μ.frame, is_base=is_carried)
    poses, twists = dict[str, Array](), np.empty((0, 6))
    if is_carried and body.pose is not None:
        owed, states = zip((μ.frame[:12], body.pose), *led[::-1], strict=True)
        each = [pose_pulled_back(state, of_state, is_base=True) for of_state, state in zip(owed, states, strict=True)]
        poses = {name: np.array([of_state[name] for of_state in each[1:]]) for name in start}
        twists = owed_to_twists(np.array(owed), states, run.lengths)
    return RolloutGradient(value, inputs, state, along_γ, along_D, tuple(kinks[::-1]), start, poses, twists)


def _without_account(body: Simulator) -> Simulator:
    """A copy, which keeps no energy account."""
    revived, (*given, state) = body.__reduce__()
    copied: Simulator = revived(*given, replace(state, sums=None))
    return copied


def _size_of(record: Any, known: set[int]) -> tuple[int, set[int]]:
    """Bytes of the arrays of a record but for known ones, which it shares, and which of its parts are known then."""
    size, parts, left = 0, set[int](), [record]
    while left:
        part = left.pop()
        if id(part) in parts:
            continue
        parts.add(id(part))
        if id(part) in known:
            continue
        if isinstance(part, np.ndarray):
            size += part.nbytes
        elif isinstance(part, (tuple, list)):
            left += part
        elif hasattr(part, "__dict__"):
            left += vars(part).values()
    return size, parts


def _rows(rom: Rom, names: Sequence[str]) -> tuple[Array, Array]:
    """What outputs show of the shared basis, (rows, k), and of what is beyond a contact mode, (rows, k - rigid)."""
    rows = np.concatenate([np.empty((0, len(rom.stiffness))), *(rom.outputs[name] for name in names)])
    return rows, rows[:, rom.rigid :] / np.sqrt(rom.stiffness[rom.rigid :])


def _points_of(rom: Rom, names: Sequence[str]) -> Array:
    """Where points of outputs are at rest (points, 3), m; none in a fixed frame."""
    if rom.moving_frame is None:
        return np.empty((0, 3))
    return np.concatenate([np.empty((0, 3)), *(rom.moving_frame.output_points[name] for name in names)])


def _seen(pose: BaseState, places: Array, slopes: Array) -> tuple[Array, Array]:
    """Derivatives with displacements in a frame, and with where it is (6,), from those with places (points, 3)."""
    R = rotation_matrix(pose.rotation)
    seen = slopes @ R
    turning = np.cross((places - pose.position) @ R, seen).sum(axis=0)
    return seen.ravel(), np.concatenate([slopes.sum(axis=0), turning])


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
            "slip, or a switch finds less to hold than nearby: there the gradient is that of the side which the step "
            "found",
            FenicsRomWarning,
            stacklevel=4,
        )
