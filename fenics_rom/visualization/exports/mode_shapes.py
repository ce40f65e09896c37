"""The shapes that a reduced model is made of, and the sheet of them that shows what a contact mode is."""

import math
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError, check_known
from fenics_rom.io.units import readable
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.file import HANKEL_UNIT
from fenics_rom.rom.rom import Rom
from fenics_rom.visualization.contact_surface import on_kept_surface
from fenics_rom.visualization.exports.body_renderer import BodyRenderer
from fenics_rom.visualization.figure import DARK, LIGHT, figure_class, write_figure

DRAWN_AMPLITUDE = 0.16  # largest displacement that is drawn, of the body's longest edge
PANEL_PIXELS = 640  # width of a panel
PANEL_INCHES = 2.0  # its width on the sheet
TITLES = {
    "eigenvectors": "eigenvectors of the reduced models, with frequency",
    "rest": "shapes at rest, under unit inputs",
}


@dataclass(frozen=True)
class ModeShape:
    """A shape of the reduced model of one contact mode."""

    number: int  # from 1; rigid motions are not counted
    displacement: Array  # (N, 3), kg^-1/2 where its norm in M is 1, m per unit of the input where it is a shape at rest
    frequency: float | None = None  # Hz, of Rayleigh's quotient xᵀKx / xᵀMx; None for shapes at rest
    σ: float | None = None  # Hankel singular value; None where there are none


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
    """The shapes of one of the SHAPE_KINDS, by contact mode. Raises SceneError of another, and without a mesh."""
    check_known("kind of shape", kind, SHAPE_KINDS, SceneError)
    if not len(rom.triangles):
        raise SceneError(f"ROM {rom.name!r} has no surface to draw: it is of matrices, not of a mesh")
    return {name: SHAPE_KINDS[kind](rom, mode) for name, mode in rom.contact_models.items()}


def write_sheet(file: Path, rom: Rom, kind: str, count: int, dark: bool) -> None:
    """Draws the first shapes of each contact mode, a row each, with σ and frequency.

    Every shape is drawn as large as every other: how far it is from rest says nothing. The surface that a contact mode
    is touched at is outlined in red, where the ROM knows it.

    Args:
        file: its ending says the format.
        rom: with a mesh.
        kind: of SHAPE_KINDS.
        count: of shapes in a row; contact modes that have fewer leave room.
        dark: light on dark instead of dark on light.
    """
    figure_of = figure_class()
    import matplotlib

    rows = {name: shapes[:count] for name, shapes in mode_shapes(rom, kind).items()}
    patches = {name: rom.triangles[on_kept_surface(rom, name)] for name in rows}
    drawn = {name: [_scale_to_drawn(rom, shape) for shape in row] for name, row in rows.items()}
    renderer = BodyRenderer(
        rom.nodes,
        rom.triangles,
        [displacement for row in drawn.values() for displacement in row],
        width=PANEL_PIXELS,
        dark=dark,
        captions=False,
        below=_faces_down(rom, patches),
    )
    style = DARK if dark else LIGHT
    with matplotlib.rc_context(style.settings):
        wide = max(len(row) for row in rows.values())
        ratio = renderer.height / PANEL_PIXELS
        figure = figure_of(
            figsize=(PANEL_INCHES * wide + 0.35, (PANEL_INCHES * ratio + 0.34) * len(rows) + 0.4), layout="constrained"
        )
        figure.suptitle(f"{rom.name}: {_title(rom, kind)}", x=0.01, ha="left")
        grid = figure.subplots(len(rows), wide, squeeze=False)
        for axes_of_row, (name, row) in zip(grid, rows.items(), strict=True):
            for axes, shape, displacement in zip(axes_of_row, row, drawn[name], strict=False):
                renderer.outline(patches[name], displacement)
                axes.imshow(renderer.render(displacement), interpolation="antialiased")
                axes.set_title(_words(shape), fontsize=7, pad=2)
            for axes in axes_of_row:
                axes.set(xticks=[], yticks=[])
                axes.spines[:].set_visible(False)
            for axes in axes_of_row[len(row) :]:
                axes.set_axis_off()
            axes_of_row[0].set_ylabel("\n".join(textwrap.wrap(name.replace("_", " "), 12)), fontsize=9)
        renderer.close()
        write_figure(figure, file, dpi=220)


def _scale_to_drawn(rom: Rom, shape: ModeShape) -> Array:
    """A shape as it is drawn, its largest component positive."""
    x = shape.displacement
    largest = x.ravel()[np.abs(x).argmax()]
    extent = np.ptp(rom.nodes, axis=0).max()
    return x * (DRAWN_AMPLITUDE * extent / np.linalg.norm(x, axis=1).max() * np.sign(largest) if largest else 0.0)


def _faces_down(rom: Rom, patches: Mapping[str, Array]) -> bool:
    """Whether the contact modes' patches are seen better from below."""
    corners = rom.nodes[np.concatenate(list(patches.values()))]
    return bool(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2].sum() < 0)


def _title(rom: Rom, kind: str) -> str:
    """What the sheet shows, with the unit of σ where there are some."""
    if kind != "modes":
        return TITLES[kind]
    if not any(len(mode.hankel_singular_values) for mode in rom.contact_models.values()):
        return f"modes of method {rom.method!r}, the most important first, with frequency"
    return f"balanced modes, with σ in {readable(HANKEL_UNIT[rom.weighting])} and frequency"


def _words(shape: ModeShape) -> str:
    """Number, σ and frequency."""
    σ = f"σ = {shape.σ:.1e}" if shape.σ is not None else ""
    hertz = f"{shape.frequency:.3g} Hz" if shape.frequency is not None else ""
    return ", ".join(filter(None, [f"{shape.number}: {σ}" if σ else str(shape.number), hertz]))
