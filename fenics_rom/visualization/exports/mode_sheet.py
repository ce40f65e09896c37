"""The sheet of modes: the picture one looks at to see what a contact mode is."""

import textwrap
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fenics_rom.io.units import readable
from fenics_rom.rom.file import HANKEL_UNIT
from fenics_rom.rom.rom import Rom
from fenics_rom.visualization.exports.body_renderer import BodyRenderer
from fenics_rom.visualization.exports.contact_surface import find_contact_triangles
from fenics_rom.visualization.exports.mode_shapes import ModeShape, mode_shapes
from fenics_rom.visualization.figure import figure_class, write_figure
from fenics_rom.visualization.plots.style import DARK, LIGHT

Array = np.ndarray

DRAWN_AMPLITUDE = 0.16  # largest displacement that is drawn, of the body's longest edge
PANEL_PIXELS = 640  # width of a panel
PANEL_INCHES = 2.0  # its width on the sheet
TITLES = {
    "eigenvectors": "eigenvectors of the reduced models, with frequency",
    "rest": "shapes at rest, under unit inputs",
}


def write_sheet(file: Path, rom: Rom, kind: str, count: int, dark: bool) -> None:
    """Draws the first shapes of each contact mode, a row each, with σ and frequency.

    Every shape is drawn as large as every other: how far it is from rest says nothing. Of a contact mode that is a
    patch around a point, or that obstacles touch, the patch is outlined in red.

    Args:
        file: its ending says the format.
        rom: with a mesh.
        kind: of shapes: "modes", "eigenvectors" or "rest".
        count: of shapes in a row; contact modes that have fewer leave room.
        dark: light on dark instead of dark on light.

    Raises:
        MissingPackageError: there is no PyVista, or no Matplotlib.
        FileError: it cannot be written.
        SceneError: the ROM has no surface.
    """
    figure_of = figure_class()
    import matplotlib

    rows = {name: shapes[:count] for name, shapes in mode_shapes(rom, kind).items()}
    patches = {name: find_contact_triangles(rom, name) for name in rows}
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
