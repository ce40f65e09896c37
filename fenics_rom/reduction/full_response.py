"""Frequency responses of the full model by solves with K + iωD - ω²M, one factorisation at each frequency."""

from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass

import numpy as np

from fenics_rom.errors import StructureError
from fenics_rom.io.progress import Report, silent
from fenics_rom.reduction.frequency_response import mass_norms, response
from fenics_rom.rom.rom import Rom
from fenics_rom.system.protocols import Array
from fenics_rom.system.system import System


@dataclass(frozen=True)
class FullResponse:
    """What the full model answers to the contact columns of one contact mode, and how far the reduced one is from it.

    Norms are in M, over all columns (Frobenius), without rigid motions.

    Attributes:
        sizes: (f,) |H(iω)|.
        errors: (f,) |H(iω) - H_i(iω)|.
    """

    sizes: Array
    errors: Array


def full_responses(system: System, rom: Rom, frequencies: Array, report: Report = silent) -> Mapping[str, FullResponse]:
    """Solves at each frequency for the contact columns of every contact mode; every rank must call it.

    Args:
        system: the full model that the ROM was made from.
        rom: its reduced model.
        frequencies: (f,), rad/s.
        report: called with the stage, how much of it is done, and of how much.

    Raises:
        StructureError: the ROM is not of this model.
        SolverError: a factorisation failed.
    """
    Q, widths = _checked_basis(system, rom), rom.contacts
    B = np.hstack([system.contacts[name] for name in rom.contact_models])
    rigid = Q[:, : rom.rigid]
    B = B - system.mass @ (rigid @ system.algebra.inner(rigid, B))
    sizes: dict[str, list[float]] = {name: [] for name in rom.contact_models}
    errors: dict[str, list[float]] = {name: [] for name in rom.contact_models}
    for done, ω in enumerate(frequencies):
        report("frequency responses", done, len(frequencies))
        terms = (-(ω**2) + 0j, system.mass), (1j * ω, system.damping), (1.0 + 0j, system.stiffness)
        with closing(system.algebra.factor(*terms)) as factor:
            H = factor.solve(B)
        column = 0
        for name, mode in rom.contact_models.items():
            ρ, block = mode.rigid, slice(column, column + widths[name])
            damping = mode.damping[ρ:] if mode.damping.ndim == 1 else mode.damping[ρ:, ρ:]
            q = response(mode.eigenvalues[ρ:], damping, mode.inputs[ρ:, : widths[name]], ω)
            C = mode.coordinates[:, ρ:]
            reduced = Q @ (C @ q.real) + 1j * (Q @ (C @ q.imag))
            sizes[name].append(float(np.linalg.norm(mass_norms(system, H[:, block]))))
            errors[name].append(float(np.linalg.norm(mass_norms(system, H[:, block] - reduced))))
            column = block.stop
    report("frequency responses", len(frequencies), len(frequencies))
    return {name: FullResponse(np.array(sizes[name]), np.array(errors[name])) for name in rom.contact_models}


def _checked_basis(system: System, rom: Rom) -> Array:
    """Q, the rows of this rank.

    Raises:
        StructureError: other unknowns, contact modes or numbers of columns than the system's.
    """
    moving = system.body.unknowns.moving
    if not np.array_equal(moving, rom.free) or not np.allclose(system.body.nodes, rom.nodes):
        raise StructureError(
            f"ROM {rom.name!r} is of a body of {len(rom.free)} displacements, and the scene has another one, of "
            f"{len(moving)}; allowed is the scene that the ROM was made from"
        )
    for name, width in rom.contacts.items():
        if name not in system.contacts or system.contacts[name].shape[1] != width:
            raise StructureError(
                f"ROM {rom.name!r} has a contact mode {name!r} of {width} columns, and the scene has none"
            )
    return rom.basis[np.searchsorted(moving, system.body.free)][system.algebra.rows()]
