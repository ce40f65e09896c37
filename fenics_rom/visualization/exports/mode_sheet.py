"""The sheet of modes: the picture one looks at to see what a contact mode is."""

import textwrap
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fenics_rom.io.units import readable
from fenics_rom.rom.file import HANKEL_UNIT
from fenics_rom.rom.rom import Rom
from fenics_rom.visualization.exports.body_renderer import Stage
from fenics_rom.visualization.exports.contact_surface import contact_triangles
from fenics_rom.visualization.exports.fields import Field, fields
from fenics_rom.visualization.figure import figure_class, write_figure
from fenics_rom.visualization.plots.style import DARK, LIGHT

Array = np.ndarray

SIZE = 0.16  # largest displacement that is drawn, of the body's longest edge
WIDTH = 640  # pixels of a panel
PANEL = 2.0  # its width, inches
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

    rows = {name: some[:count] for name, some in fields(rom, kind).items()}
    patches = {name: contact_triangles(rom, name) for name in rows}
    drawn = {name: [_sized(rom, field) for field in row] for name, row in rows.items()}
    stage = Stage(
        rom.nodes,
        rom.triangles,
        [shape for row in drawn.values() for shape in row],
        width=WIDTH,
        dark=dark,
        captions=False,
        below=_face_down(rom, patches),
    )
    style = DARK if dark else LIGHT
    with matplotlib.rc_context(style.settings):
        wide = max(len(row) for row in rows.values())
        ratio = stage.height / WIDTH
        figure = figure_of(
            figsize=(PANEL * wide + 0.35, (PANEL * ratio + 0.34) * len(rows) + 0.4), layout="constrained"
        )
        figure.suptitle(f"{rom.name}: {_title(rom, kind)}", x=0.01, ha="left")
        grid = figure.subplots(len(rows), wide, squeeze=False)
        for axes_of_row, (name, row) in zip(grid, rows.items(), strict=True):
            for axes, field, shape in zip(axes_of_row, row, drawn[name], strict=False):
                stage.mark(patches[name], shape)
                axes.imshow(stage.picture(shape), interpolation="antialiased")
                axes.set_title(_words(field), fontsize=7, pad=2)
            for axes in axes_of_row:
                axes.set(xticks=[], yticks=[])
                axes.spines[:].set_visible(False)
            for axes in axes_of_row[len(row) :]:
                axes.set_axis_off()
            axes_of_row[0].set_ylabel("\n".join(textwrap.wrap(name.replace("_", " "), 12)), fontsize=9)
        stage.close()
        write_figure(figure, file, dpi=220)


def _sized(rom: Rom, field: Field) -> Array:
    """A shape as it is drawn, its largest component positive."""
    x = field.displacement
    largest = x.ravel()[np.abs(x).argmax()]
    extent = np.ptp(rom.nodes, axis=0).max()
    return x * (SIZE * extent / np.linalg.norm(x, axis=1).max() * np.sign(largest) if largest else 0.0)


def _face_down(rom: Rom, patches: Mapping[str, Array]) -> bool:
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


def _words(field: Field) -> str:
    """Number, σ and frequency."""
    σ = f"σ = {field.σ:.1e}" if field.σ is not None else ""
    hertz = f"{field.frequency:.3g} Hz" if field.frequency is not None else ""
    return ", ".join(filter(None, [f"{field.number}: {σ}" if σ else str(field.number), hertz]))
