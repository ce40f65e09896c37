"""Scales of inputs: what a basis knows of a pressure must not depend on the unit that it is given in."""

from dataclasses import replace

import numpy as np

from fenics_rom.system.protocols import Array, Factor
from fenics_rom.system.system import System


def scale_inputs(system: System, factor: Factor) -> System:
    """The system with the columns of effects scaled, so that at rest each stores as much energy as a contact's.

    A pressure in a closed chamber, whose forces balance each other, moves a body much less than the same force in one
    place. What its column is made larger by, its unit is made smaller by: B stays as it is, and only `forces` changes.

    Args:
        system: those actuators and loads that have units are effects.
        factor: of K.
    """
    if not system.units:
        return system

    def stored(columns: Array) -> float:
        """Square root of the largest bᵀK⁻¹b."""
        return float(np.sqrt(np.diag(system.algebra.inner(columns, factor.solve(columns))).max()))

    reference = float(np.median([stored(B) for B in system.contacts.values()]))
    of_effects = {name: B for name, B in {**system.actuators, **system.loads}.items() if name in system.units}
    scales = {name: reference / size for name, B in of_effects.items() if (size := stored(B)) > 0}

    def scaled(columns: dict[str, Array]) -> dict[str, Array]:
        return {name: scales.get(name, 1.0) * B for name, B in columns.items()}

    return replace(
        system,
        actuators=scaled(dict(system.actuators)),
        loads=scaled(dict(system.loads)),
        units={name: unit / scales.get(name, 1.0) for name, unit in system.units.items()},
    )
