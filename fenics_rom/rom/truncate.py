"""A ROM at a lower order, of the directions that it keeps first; a ROM without its rigid motions."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray as Array

from fenics_rom.arguments import is_number
from fenics_rom.errors import StructureError, shown
from fenics_rom.mechanics.readings import OfDisplacement
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.given_rom import given_rom
from fenics_rom.rom.rom import Rom, diagonalized_span

if TYPE_CHECKING:
    from os import PathLike


def truncate(rom: "Rom | str | PathLike[str]", order: int) -> Rom:
    """The ROM at a lower order: the leading directions of every contact mode that has more.

    Args:
        rom: at the order it was reduced to, or the name of its file.
        order: number of displacements that strain; rigid motions stay, and are not counted.

    Raises:
        StructureError: order below 1, or beyond what every contact mode has, or a ROM with oblique switching.
        SceneError, FileError: something else than a ROM was given.

    Example:
        >>> fr.truncate(rom, 5).contact_models["middle"].order
        5
    """
    rom = given_rom("truncate", rom)
    most = max(mode.order - mode.rigid for mode in rom.contact_models.values())
    if not (is_number(order, whole=True) and 1 <= order <= most):
        raise StructureError(f"order {shown(order)}: use 1 to {most}, the largest order in the ROM")
    if rom.deformation is not None:
        raise StructureError("a ROM with large deformation cannot be truncated; reduce to that order instead")
    if rom.switching == "oblique":
        raise StructureError("a ROM with oblique switching cannot be truncated; reduce to that order instead")
    κ, modes = rom.stiffness, rom.contact_models
    truncated = {name: _truncate_mode(κ, modes[name], rom.rigid + order) for name in modes}
    residual = None if rom.residual_compliance is None else replace(rom.residual_compliance, dt=0.0, errors={})
    return replace(rom, contact_models=truncated, force_validation=None, residual_compliance=residual)


def _truncate_mode(κ: Array, mode: ContactModel, order: int) -> ContactModel:
    if order >= mode.order:
        return mode
    γ, C = diagonalized_span(κ, mode.coordinates @ mode.directions[:, :order])
    within = mode.coordinates.T @ C  # (m, order), orthonormal columns
    D = mode.damping
    reduced = within.T @ (D[:, None] * within if D.ndim == 1 else D @ within)
    return ContactModel(
        eigenvalues=γ,
        damping=np.diag(reduced).copy() if D.ndim == 1 else (reduced + reduced.T) / 2,
        inputs=within.T @ mode.inputs,
        coordinates=C,
        directions=np.linalg.qr(within.T @ mode.directions[:, :order])[0],
        hankel_singular_values=mode.hankel_singular_values,
        contact_points=mode.contact_points,
    )


def without_rigid_motions(rom: Rom) -> Rom:
    """The ROM of what strains alone, for a body whose frame moves with it."""
    ρ = rom.rigid
    if not ρ:
        return rom
    models = {
        name: replace(
            model,
            eigenvalues=model.eigenvalues[ρ:],
            damping=model.damping[ρ:] if model.damping.ndim == 1 else model.damping[ρ:, ρ:],
            inputs=model.inputs[ρ:],
            coordinates=model.coordinates[ρ:, ρ:],
            directions=np.eye(model.order - ρ),
            left_inverse=None,
        )
        for name, model in rom.contact_models.items()
    }
    readings = {
        name: replace(reading, operator=reading.operator[:, ρ:]) if isinstance(reading, OfDisplacement) else reading
        for name, reading in rom.readings.items()
    }
    return replace(
        rom,
        contact_models=models,
        basis=rom.basis[:, ρ:],
        stiffness=rom.stiffness[ρ:],
        outputs={name: rows[:, ρ:] for name, rows in rom.outputs.items()},
        readings=readings,
        error_model=None,
    )
