"""Exact gradients of what comes of many steps of a linear body, by the adjoint of the steps that were taken.

With the state x = [e, r], e = ω q, as in rom/state_space.py, a step is x⁺ = A x + B u, and a switch of contact modes
x⁺ = S x. For J of outputs and energies, μ = ∂J/∂x⁺ goes backwards as Aᵀμ and Sᵀμ, and takes up what J reads of each
state; ∂J/∂u = Bᵀμ. What J owes to the numbers of the model goes by the mid-step velocity and its adjoint,

    v̂ = (r + r⁺)/2,    y = (2/h + D + h/2 γ)⁻¹ (h ω μ_e + 2 μ_r),
    ∂J/∂D = -Σ y v̂ᵀ,    ∂J/∂ω = Σ h μ_e v̂ - y (e + h ω v̂)

States are kept at the beginning of blocks alone, and found again block by block, the last one first.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.rom.midpoint_map import compliance
from fenics_rom.rom.state_space import StateSpace
from fenics_rom.runtime.differentiation.gradient import Objective, RolloutGradient, evaluate
from fenics_rom.runtime.rollout import ConstantInterval
from fenics_rom.runtime.simulator import Simulator

BLOCK_STEPS = 512  # whose states are held at once


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


def differentiate_linear(
    body: Simulator, u: Array, plan: Sequence[ConstantInterval], objective: Objective, names: Sequence[str]
) -> RolloutGradient:
    """As differentiate, of inputs with the loads (steps, p), and with names of outputs that there are."""
    rom, plants = body.rom, _Plants(body, names)

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
    value, slopes, energy_slopes = evaluate(objective, body, names, np.concatenate(rows), np.concatenate(energies))

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
