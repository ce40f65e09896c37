"""What a gradient is of: an objective of outputs and energies; and what it is."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError, check_known, shown
from fenics_rom.mechanics.signals import real_numbers, real_numbers_or_nan

if TYPE_CHECKING:
    from fenics_rom.runtime.simulator import Simulator

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
            Of bodies that deform largely, whose elasticity and damping are elsewhere, both are empty; and of runs in
            which a switch in a moving frame made further modes, which have their own.
        kinks: steps, counted from the first, at which J has no derivative, but one to each side: that of the side that
            the step found is in the gradient. Also where J jumps, as a switch before the step finds no shape or rate
            to hold, but would nearby.
        pose: of a body in a moving frame with position, rotation, velocity and angular_velocity at the start, (3,)
            each, per m, rad, m/s and rad/s along the axes of space; of a free body, or of the base that carries it.
            The rotation adds to the attitude, the shape turns along, and velocities stay.
        base: of a carried body with the same of the base at the end of each step, (steps, 3) each. They are the numbers
            of `BaseState`, each on its own: a path that changes both poses and twists changes J by the sum.
        twists: of a carried body with the twist of the base at the start and at the end of each step, (steps + 1, 6):
            velocity of its origin and angular velocity, in its own axes then, per m/s and rad/s, where its poses follow
            these: p⁺ = p + h R (1 + h/2 ω̂~) v̂ and R⁺ = R cay(h ω̂), with their means v̂ and ω̂ in a step. That keeps
            what touches where it is; a pose by itself moves it through an obstacle, or off it, which is a kink.

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
    kinks: tuple[int, ...] = ()
    pose: Mapping[str, Array] = field(default_factory=dict)
    base: Mapping[str, Array] = field(default_factory=dict)
    twists: Array = field(default_factory=lambda: np.empty((0, 6)))

    def __repr__(self) -> str:
        steps, width = self.inputs.shape
        models = f"γ and D of {', '.join(self.eigenvalues)}" if self.eigenvalues else "no γ and D"
        return (
            f"RolloutGradient: J = {self.value:.6g}, with {width} inputs of {steps} steps, the start of order "
            f"{len(self.state[0])}, {models}; {len(self.kinks)} kinks"
        )


def evaluate(
    objective: Objective, body: "Simulator", names: Sequence[str], rows: Array, energies: Array
) -> tuple[float, Array, Array]:
    """J, and its derivatives with all rows that are read (steps, rows), and with the energies (steps,)."""
    parts = np.split(rows, np.cumsum([len(body.output_rows(name)) for name in names])[:-1], axis=1) if names else []
    given = {name: body.rom.by_point(part) for name, part in zip(names, parts, strict=True)}
    return checked_slopes(objective, given, energies)


def checked_slopes(objective: Objective, given: dict[str, Array], energies: Array) -> tuple[float, Array, Array]:
    """J, and its derivatives with all rows of the outputs (steps, rows), and with the energies (steps,).

    Raises:
        StepError: J is no finite number, or they are of another shape, not finite, or of an output that is not given.
    """
    returned = objective(given, energies)
    try:
        value, by_output, by_energy = returned
        if np.ndim(value) or not isinstance(by_output, Mapping):
            raise ValueError
        J = float(real_numbers(value))
        if not np.isfinite(J):
            raise ValueError
    except (TypeError, ValueError):
        raise StepError(
            "objective: use a finite J, its derivatives by name of an output, and those with the energies or "
            f"None (got {shown(returned)})"
        ) from None
    for name in by_output:
        check_known("output", name, given, StepError)
    steps = len(energies)
    slopes = [_checked(name, by_output.get(name, 0.0), part).reshape(steps, -1) for name, part in given.items()]
    return (
        J,
        np.hstack([np.empty((steps, 0)), *slopes]),
        _checked("energies", 0.0 if by_energy is None else by_energy, energies),
    )


def _checked(name: str, slope: "Array | float", of: Array) -> Array:
    """Derivatives with something, as an array of its shape; 0. of what is not named."""
    slope = real_numbers_or_nan(slope)
    if slope.shape not in ((), of.shape) or not np.isfinite(slope).all():
        raise StepError(f"derivatives with {name}: use finite numbers {of.shape} (got {slope.shape})")
    return np.broadcast_to(slope, of.shape)
