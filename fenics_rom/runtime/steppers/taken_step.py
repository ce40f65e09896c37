"""What all kernels tell of a step that they took, so that it can be gone back through; see parted_adjoint.py."""

from typing import TYPE_CHECKING

from numpy import ndarray as Array

from fenics_rom.rom.contact_model import ContactModel

if TYPE_CHECKING:
    from fenics_rom.mechanics.viscoelasticity import MaxwellBranches
    from fenics_rom.runtime.steppers.acts.found_forces import FoundForces
    from fenics_rom.runtime.steppers.acts.found_slopes import FoundSlopes
    from fenics_rom.runtime.steppers.elastic.law import LawAdjoint
    from fenics_rom.runtime.steppers.residual_maps import ResidualMaps
    from fenics_rom.runtime.steppers.residual_motion import ResidualMotion

Moved = tuple[float, Array, Array, Array, Array]  # h, q and r at the start, v̂, and the middle, where forces act


def residual_taken(residual: "ResidualMotion | None") -> "tuple[ResidualMaps | None, Array | None]":
    """What the residual part did, and its rows after the step."""
    if residual is None:
        return None, None
    maps = residual.maps
    return maps, residual.carried.reshape(maps.rows, -1).copy()


def found_taken(
    found: "FoundForces | None", u: Array, z: Array, moved: Moved, *, follows: bool = True
) -> "FoundSlopes | None":
    """What forces z (n,) were found by, whose input was u (p,), where the middle follows v̂ or what was expected."""
    if found is None:
        return None
    from fenics_rom.runtime.steppers.acts.found_slopes import FoundIn

    forces, given = found.actuators.split(u)
    return FoundIn(found, forces, given, z, *moved).slopes(follows=follows)


def linear_taken(
    model: ContactModel, reach: float, q: Array, q_after: Array, v: Array, branches: "MaxwellBranches | None"
) -> "LawAdjoint":
    """Small strains between q and q⁺ with v̂, (m,) each."""
    from fenics_rom.runtime.steppers.elastic.linear import LinearAdjoint

    relaxing = None if branches is None else branches.adjoint()
    return LinearAdjoint(model, model.damping, reach, q, q_after, v, relaxing)
