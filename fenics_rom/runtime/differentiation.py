"""Exact gradients of what comes of many steps of a linear body, by the adjoint of the steps that were taken.

With the state x = [e, r], e = ω q, as in rom/state_space.py, a step is x⁺ = A x + B u, and a switch of contact modes
x⁺ = S x. For J of outputs and energies, μ = ∂J/∂x⁺ goes backwards as Aᵀμ and Sᵀμ, and takes up what J reads of each
state; ∂J/∂u = Bᵀμ. What J owes to the numbers of the model goes by the mid-step velocity and its adjoint,

    v̂ = (r + r⁺)/2,    y = (2/h + D + h/2 γ)⁻¹ (h ω μ_e + 2 μ_r),
    ∂J/∂D = -Σ y v̂ᵀ,    ∂J/∂ω = Σ h μ_e v̂ - y (e + h ω v̂)

States are kept at the beginning of blocks alone, and found again block by block, the last one first.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError, check_known
from fenics_rom.rom.midpoint_map import compliance
from fenics_rom.rom.state_space import StateSpace
from fenics_rom.runtime.rollout import plan_steps
from fenics_rom.runtime.simulator import Simulator

BLOCK_STEPS = 512  # whose states are held at once

Objective = Callable[[dict[str, Array], Array], tuple[float, Mapping[str, Array], Array | None]]


@dataclass(frozen=True, eq=False)
class RolloutGradient:
    """What an objective J is, and how it changes.

    Attributes:
        value: J.
        inputs: with each input, (steps, p), per N (or Pa).
        state: with q and r at the start, (m,) each.
        eigenvalues: with γ (m,) of each contact mode, by name, per s^-2; of rigid motions 0. Maps of switches, which
            act on √γ q, are held: stiffness that changes as a whole changes all γ in one proportion.
        damping: with D of each contact mode, by name, per s^-1: (m,) where it is diagonal, else (m, m), symmetric.

    Example:
        >>> body = fr.Simulator(rom, dt=1e-3)
        >>> kept = lambda outputs, energies: (energies[-1], {}, np.eye(len(energies))[-1])
        >>> gradient = fr.differentiate(body, np.ones((50, 3)), kept, contact="middle")
        >>> bool(gradient.damping["middle"].sum() < 0)  # more damping leaves less energy
        True
    """

    value: float
    inputs: Array
    state: tuple[Array, Array]
    eigenvalues: Mapping[str, Array]
    damping: Mapping[str, Array]


class _Stretch(NamedTuple):
    """Steps of a block: one contact mode, one dt."""

    first: int  # step
    last: int  # step after the last one
    contact: str
    dt: float
    start: Array  # state x (2m,)


class _Plants:
    """The maps of steps and switches, each found once."""

    def __init__(self, body: Simulator, outputs: Sequence[str]):
        self.rom, self._outputs = body.rom, tuple(outputs)
        self._plants: dict[tuple[str, float], StateSpace] = {}
        self._switches: dict[tuple[str, str], Array] = {}

    def step(self, contact: str, dt: float) -> StateSpace:
        if (contact, dt) not in self._plants:
            self._plants[contact, dt] = self.rom.state_space(contact, self._outputs, dt)
        return self._plants[contact, dt]

    def switch(self, start: str, end: str) -> Array:
        if (start, end) not in self._switches:
            self._switches[start, end] = self.rom.switch_map(start, end)
        return self._switches[start, end]

    def frequencies(self, contact: str) -> Array:
        """What turns q into e, (m,): ω, and 1 of rigid motions."""
        ω = np.sqrt(self.rom.contact_models[contact].eigenvalues)
        return np.where(ω == 0, 1.0, ω)

    def stored(self, contact: str) -> Array:
        """Which numbers of a state store energy, (2m,): 1, and 0 of displacements along rigid motions."""
        γ = self.rom.contact_models[contact].eigenvalues
        return np.concatenate([γ > 0, np.ones(len(γ))])


def differentiate(
    body: Simulator,
    inputs: Sequence[Sequence[float]] | Array,
    objective: Objective,
    *,
    contact: str | Sequence[str] | None = None,
    dt: float | Sequence[float] | Array | None = None,
    outputs: Sequence[str] | None = None,
) -> RolloutGradient:
    """Value and gradient of an objective over the steps of `body.rollout`, from where the body is; it is not moved.

    Costs about three times the steps; of their states it keeps one in 512.

    Args:
        body: a linear one, which nothing touches.
        inputs, contact, dt: of each step, as in `Simulator.rollout`.
        objective: gets the displacements of outputs by name, m, (steps, points, 3), and the stored energies (steps,),
            J, after each step; returns J, its derivatives with each output, by name, and with each energy (None: 0).
        outputs: names of those that the objective gets; None: all.

    Raises:
        StructureError: the body is not linear.
        StepError: as in `Simulator.rollout`, or derivatives of another shape, or that are not finite.

    Example:
        >>> body, target = fr.Simulator(rom, dt=1e-3), np.array([0.0, 0.0, 1e-3])
        >>> def miss(outputs, energies):  # of both tips at the end
        ...     apart = outputs["tip"][-1] - target
        ...     slope = np.zeros_like(outputs["tip"])
        ...     slope[-1] = 2 * apart
        ...     return (apart**2).sum(), {"tip": slope}, None
        >>> gradient = fr.differentiate(body, np.zeros((200, 3)), miss)
        >>> gradient.value, gradient.inputs.shape, bool(gradient.inputs[:, 2].sum() < 0)
        (2e-06, (200, 3), True)
    """
    rom = body.rom
    rom.check_linear()
    names = tuple(rom.outputs if outputs is None else outputs)
    for name in names:
        check_known("output", name, rom.outputs, StepError)
    u, plan = plan_steps(body, inputs, contact, dt)
    plants = _Plants(body, names)

    q, r = body.state
    x, active, stretches = np.concatenate([q * plants.frequencies(body.contact), r]), body.contact, []
    rows, energies = [np.empty((0, sum(len(body.output_rows(name)) for name in names)))], [np.empty(0)]
    for interval in plan:
        x = x if interval.contact == active else plants.switch(active, interval.contact) @ x
        active, plant = interval.contact, plants.step(interval.contact, interval.dt)
        for first in range(interval.start, interval.stop, BLOCK_STEPS):
            stretch = _Stretch(first, min(first + BLOCK_STEPS, interval.stop), active, interval.dt, x)
            stretches.append(stretch)
            states = _states(plant, stretch, u)
            rows.append(states[1:] @ plant.C.T)
            energies.append(np.square(states[1:]) @ plants.stored(active) / 2)
            x = states[-1].copy()
    value, slopes, energy_slopes = _evaluate(objective, body, names, np.concatenate(rows), np.concatenate(energies))

    gradient = RolloutGradient(
        value,
        np.empty(u.shape),
        (q, r),
        {name: np.zeros_like(model.eigenvalues) for name, model in rom.contact_models.items()},
        {name: np.zeros_like(model.damping) for name, model in rom.contact_models.items()},
    )
    μ = np.zeros(len(x))
    for stretch in reversed(stretches):
        if stretch.contact != active:
            μ = plants.switch(stretch.contact, active).T @ μ
            active = stretch.contact
        μ = _go_back(plants, stretch, u, μ, slopes, energy_slopes, gradient)
    if body.contact != active:
        μ = plants.switch(body.contact, active).T @ μ
    ω, (along_e, along_r) = plants.frequencies(body.contact), np.split(μ, 2)
    gradient.eigenvalues[body.contact][rom.rigid :] += (along_e * q / (2 * ω))[rom.rigid :]
    return RolloutGradient(
        value, gradient.inputs[:, : body.inputs], (ω * along_e, along_r), gradient.eigenvalues, gradient.damping
    )


def _states(plant: StateSpace, stretch: _Stretch, u: Array) -> Array:
    """At the start of a stretch and after each of its steps, (steps + 1, 2m)."""
    pushes = u[stretch.first : stretch.last] @ plant.B.T
    states = np.empty((len(pushes) + 1, len(stretch.start)))
    states[0], A = stretch.start, plant.A
    for before, after, push in zip(states[:-1], states[1:], pushes, strict=True):
        np.dot(A, before, out=after)
        after += push
    return states


def _go_back(
    plants: _Plants, stretch: _Stretch, u: Array, μ: Array, slopes: Array, energy_slopes: Array, into: RolloutGradient
) -> Array:
    """μ at the start of a stretch from that at its end; adds what its steps owe."""
    steps, h = slice(stretch.first, stretch.last), stretch.dt
    plant, model = plants.step(stretch.contact, h), plants.rom.contact_models[stretch.contact]
    states = _states(plant, stretch, u)
    read = slopes[steps] @ plant.C
    adjoints = read + energy_slopes[steps, None] * plants.stored(stretch.contact) * states[1:]
    Aᵀ = plant.A.T
    for row in adjoints[::-1]:
        row += μ
        μ = Aᵀ.dot(row)
    into.inputs[steps] = adjoints @ plant.B

    ω, m, rigid = plants.frequencies(stretch.contact), model.order, plants.rom.rigid
    e, v̂, μ_e = states[:-1, :m], (states[:-1, m:] + states[1:, m:]) / 2, adjoints[:, :m]
    a, _ = compliance(model, h)
    y = h * ω * μ_e + 2 * adjoints[:, m:]
    y = y * a if a.ndim == 1 else y @ a
    along_ω = (h * μ_e * v̂ - y * (e + h * ω * v̂) - read[:, :m] * states[1:, :m] / ω).sum(axis=0)
    into.eigenvalues[stretch.contact][rigid:] += (along_ω / (2 * ω))[rigid:]
    if model.damping.ndim == 1:
        into.damping[stretch.contact][:] -= (y * v̂).sum(axis=0)
    else:
        both = y.T @ v̂
        into.damping[stretch.contact][:] -= (both + both.T) / 2
    return μ


def _evaluate(
    objective: Objective, body: Simulator, names: Sequence[str], rows: Array, energies: Array
) -> tuple[float, Array, Array]:
    """J, and its derivatives with all rows that are read (steps, rows), and with the energies (steps,)."""
    parts = np.split(rows, np.cumsum([len(body.output_rows(name)) for name in names])[:-1], axis=1) if names else []
    given = {name: body.rom.by_point(part) for name, part in zip(names, parts, strict=True)}
    value, by_output, by_energy = objective(given, energies)
    for name in by_output:
        check_known("output", name, given, StepError)
    slopes = [_checked(name, by_output.get(name, 0.0), part).reshape(len(rows), -1) for name, part in given.items()]
    return (
        float(value),
        np.hstack([np.empty((len(rows), 0)), *slopes]),
        _checked("energies", 0.0 if by_energy is None else by_energy, energies),
    )


def _checked(name: str, slope: "Array | float", of: Array) -> Array:
    """Derivatives with something, as an array of its shape; 0. of what is not named."""
    slope = np.asarray(slope, dtype=float)
    if slope.shape not in ((), of.shape) or not np.isfinite(slope).all():
        raise StepError(f"derivatives with {name}: allowed are finite numbers {of.shape}, given: {slope.shape}")
    return np.broadcast_to(slope, of.shape)
