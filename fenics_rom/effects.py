"""The table of effects: everything that can act on a body, with what it does to the energy.

A scene names the effects it calls for. One that is not named costs nothing and changes no bit.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from fenics_rom.schema import Number


@dataclass(frozen=True)
class Effect:
    """One effect: its force in the equation of motion and its part in the energy account."""

    force: str
    stores: str = "nothing"
    dissipates: str = "nothing"
    supplies: str = "nothing"
    parameters: Mapping[str, Number] = field(default_factory=dict)


EFFECTS: Mapping[str, Effect] = {
    "inertia": Effect(force="M dv/dt", stores="½ vᵀ M v"),
    "damping": Effect(
        force="D v, D = α M + β K (Rayleigh)",
        dissipates="vᵀ D v per second",
        parameters={
            "alpha": Number(default=0.0, at_least=0.0, unit="1/s"),
            "beta": Number(default=0.0, at_least=0.0, unit="s"),
        },
    ),
}
