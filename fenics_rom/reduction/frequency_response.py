"""Frequency responses (K + iωD - ω²M)⁻¹ B of reduced models, and of the full one by factorisations."""

from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StructureError
from fenics_rom.io.progress import Report, silent
from fenics_rom.mechanics.environment import HasEnvironment
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.rom import Rom
from fenics_rom.system.system import System


def relative_modulus(of: HasEnvironment | None, ω: float | Array) -> Any:
    """Modulus of the material of a scene or an environment at ω, rad/s, as a multiple of the relaxed one."""
    series = None if of is None else of.environment.viscoelasticity
    return 1.0 if series is None else series.modulus(ω)


def response(γ: Array, damping: Array, G: Array, ω: float) -> Array:
    """Amplitudes (m, p) of a model with M = I, K = diag(γ), D = diag(damping) or (m, m), at ω in rad/s."""
    if damping.ndim == 1:
        return G / (γ + 1j * ω * damping - ω**2)[:, None]
    return np.linalg.solve(np.diag(γ - ω**2) + 1j * ω * damping, G)


def elastic_response(mode: ContactModel, columns: int, ω: float, modulus: complex = 1.0) -> Array:
    """The same of a contact mode's own columns, without its rigid motions, (m - ρ, columns); see relative_modulus."""
    ρ, D = mode.rigid, mode.damping
    return response(modulus * mode.eigenvalues[ρ:], D[ρ:] if D.ndim == 1 else D[ρ:, ρ:], mode.inputs[ρ:, :columns], ω)


def dynamic_product(system: System, x: Array, ω: Array) -> Array:
    """(K + iωD - ω²M) x for complex columns x (rows here, c), each at its own ω (c,); K as it is there."""
    Mx, Kx, modulus = system.mass @ x, system.stiffness @ x, relative_modulus(system.scene, ω)
    if system.rayleigh is None:
        return modulus * Kx + 1j * ω * (system.damping @ x) - ω**2 * Mx
    α, β = system.rayleigh
    return (modulus + 1j * ω * β) * Kx + (1j * ω * α - ω**2) * Mx


def inner_products(system: System, left: Array, right: Array) -> Array:
    """leftᴴ right of complex columns, (c, d), summed over the ranks."""
    c, d = left.shape[1], right.shape[1]
    parts = system.algebra.inner(np.hstack([left.real, left.imag]), np.hstack([right.real, right.imag]))
    return parts[:c, :d] + parts[c:, d:] + 1j * (parts[:c, d:] - parts[c:, :d])


def mass_norms(system: System, x: Array) -> Array:
    """√(xᴴ M x) of complex columns, (c,)."""
    return np.sqrt(np.abs(np.diag(inner_products(system, x, system.mass @ x))))


@dataclass(frozen=True)
class FullResponse:
    """|H(iω)| of one contact mode's columns and |H(iω) - H_i(iω)|, (f,) each; in M, over all columns, without R."""

    sizes: Array
    errors: Array


def full_responses(system: System, rom: Rom, frequencies: Array, report: Report = silent) -> Mapping[str, FullResponse]:
    """Solves at each frequency for the contact columns of every contact mode, rad/s; every rank must call it.

    Raises:
        StructureError: the ROM is not of this model.
        SolverError: a factorisation failed.
    """
    Q, widths = _checked_basis(system, rom), rom.contacts
    B = np.hstack([system.contacts[name] for name in rom.contact_models])
    rigid = Q[:, : rom.rigid]
    B = B - system.mass @ (rigid @ system.algebra.inner(rigid, B))
    sizes, errors = (np.zeros((len(rom.contact_models), len(frequencies))) for _ in range(2))
    for done, ω in enumerate(frequencies):
        report("frequency responses", done, len(frequencies))
        modulus = relative_modulus(system.scene, ω)
        terms = (-(ω**2) + 0j, system.mass), (1j * ω, system.damping), (modulus + 0j, system.stiffness)
        with closing(system.algebra.factor(*terms)) as factor:
            H = factor.solve(B)
        column = 0
        for k, (name, mode) in enumerate(rom.contact_models.items()):
            block, C = slice(column, column + widths[name]), mode.coordinates[:, mode.rigid :]
            q = elastic_response(mode, widths[name], ω, modulus)
            reduced = Q @ (C @ q.real) + 1j * (Q @ (C @ q.imag))
            sizes[k, done] = np.linalg.norm(mass_norms(system, H[:, block]))
            errors[k, done] = np.linalg.norm(mass_norms(system, H[:, block] - reduced))
            column = block.stop
    report("frequency responses", len(frequencies), len(frequencies))
    return dict(zip(rom.contact_models, map(FullResponse, sizes, errors), strict=True))


def _checked_basis(system: System, rom: Rom) -> Array:
    """Q, the rows of this rank; refused where unknowns, contact modes or numbers of columns are not the system's."""
    moving = system.body.unknowns.moving
    if not np.array_equal(moving, rom.free) or not np.allclose(system.body.nodes, rom.nodes):
        raise StructureError(
            f"ROM {rom.name!r} is of a body of {len(rom.free)} displacements, and the scene has another one, of "
            f"{len(moving)}; use the scene that the ROM was made from"
        )
    for name, width in rom.contacts.items():
        if name not in system.contacts or system.contacts[name].shape[1] != width:
            raise StructureError(f"ROM {rom.name!r} has a contact mode {name!r} of {width} columns, the scene has none")
    return rom.basis[np.searchsorted(moving, system.body.free)][system.algebra.rows()]
