"""The shapes that a reduced model is made of: balanced modes, eigenvectors, shapes at rest."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from fenics_rom.errors import SceneError, unknown
from fenics_rom.rom.rom import ContactModel, Rom

Array = np.ndarray


@dataclass(frozen=True)
class ModeShape:
    """A shape of the reduced model of one contact mode.

    Attributes:
        number: from 1; rigid motions are not counted.
        displacement: (N, 3), kg^-1/2 where its norm in M is 1, m per unit of the input where it is a shape at rest.
        frequency: Hz, of Rayleigh's quotient xᵀKx / xᵀMx; None for shapes at rest.
        σ: Hankel singular value; None where there are none.
    """

    number: int
    displacement: Array
    frequency: float | None = None
    σ: float | None = None


def balanced_modes(rom: Rom, mode: ContactModel) -> list[ModeShape]:
    """The directions that reduced models of lower order keep, the most important first, M-orthonormal.

    Without rigid motions, which every order keeps. Of a balanced reduction they are the balanced modes, with their σ.
    """
    R, σ = mode.directions[:, mode.rigid :], mode.hankel_singular_values
    γ = mode.eigenvalues @ np.square(R)
    return [
        ModeShape(
            k + 1, rom.reconstruct(mode.coordinates @ R[:, k]), math.sqrt(γ[k]) / math.tau, σ[k] if k < len(σ) else None
        )
        for k in range(R.shape[1])
    ]


def eigenvectors(rom: Rom, mode: ContactModel) -> list[ModeShape]:
    """W_i without rigid motions: the reduced model's own natural modes, ascending, M-orthonormal."""
    return [
        ModeShape(k + 1, rom.reconstruct(mode.coordinates[:, mode.rigid + k]), math.sqrt(γ) / math.tau)
        for k, γ in enumerate(mode.eigenvalues[mode.rigid :])
    ]


def shapes_at_rest(rom: Rom, mode: ContactModel) -> list[ModeShape]:
    """W_i diag(1/γ) G: where each input of 1 holds the body; of one that moves freely, what strains in it."""
    ρ = mode.rigid
    q = mode.inputs[ρ:] / mode.eigenvalues[ρ:, None]
    return [ModeShape(k + 1, rom.reconstruct(mode.coordinates[:, ρ:] @ q[:, k])) for k in range(q.shape[1])]


SHAPE_KINDS: Mapping[str, Callable[[Rom, ContactModel], list[ModeShape]]] = {
    "modes": balanced_modes,
    "eigenvectors": eigenvectors,
    "rest": shapes_at_rest,
}


def mode_shapes(rom: Rom, kind: str) -> dict[str, list[ModeShape]]:
    """The shapes of one of the SHAPE_KINDS, by contact mode.

    Raises:
        SceneError: there is no such kind, or the ROM has no mesh to see them on.
    """
    if kind not in SHAPE_KINDS:
        raise SceneError(unknown("kind of shape", kind, SHAPE_KINDS))
    if not len(rom.triangles):
        raise SceneError(f"ROM {rom.name!r} has no surface to draw: it is of matrices, not of a mesh")
    return {name: SHAPE_KINDS[kind](rom, mode) for name, mode in rom.contact_models.items()}
