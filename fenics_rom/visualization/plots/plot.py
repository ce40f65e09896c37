"""Plots as files: one file with all panels, or a folder with a file for each."""

import math
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from fenics_rom.arguments import check_flag, mapping_in, names_in, path_in
from fenics_rom.errors import FileError, SceneError, check_known, check_type
from fenics_rom.io.atomic_write import check_folder, make_folder, system_reason
from fenics_rom.io.given import object_or_file
from fenics_rom.io.overwriting import check_outputs, check_outputs_in
from fenics_rom.io.progress import Report, silent
from fenics_rom.rom.file import ROM_FILE
from fenics_rom.rom.rom import Rom
from fenics_rom.system.system import System
from fenics_rom.trajectory.file import RUN_FILE
from fenics_rom.trajectory.trajectory import Trajectory
from fenics_rom.visualization.figure import DARK, LIGHT, Panel, Style, figure_class, write_figure
from fenics_rom.visualization.plots.reduced import full_response, has_frequencies, reduced_panels
from fenics_rom.visualization.plots.runs import run_panels

File = str | PathLike[str]

FORMATS = (".pdf", ".svg", ".png")
FOLDER_FORMATS = (".pdf", ".png")  # what a folder gets of each panel: one to print, one to look at
COLUMN_INCHES, HEIGHT_INCHES = 3.5, 2.6  # of a panel, which is as wide as a column of a paper
DPI = 220  # of .png
RELATIVE_HEIGHTS = {"response": 1.35, "pressure": 1.35}  # of a usual panel; these have several parts


def plot(
    model: File | Rom | Trajectory | Mapping[str, Trajectory | File],
    output: File,
    *,
    what: Sequence[str] | None = None,
    dark: bool = False,
    full: System | None = None,
    force: bool = False,
    report: Report = silent,
) -> tuple[Path, ...]:
    """Draws what there is to see of a ROM or of runs.

    Of runs: the energy account ("energy"), against time each output ("output_NAME"), each input that changes
    ("input_NAME") and each reading ("reading_NAME"), the forces of obstacles ("forces"), pressures of contact
    ("pressure", and a map of the largest, "pressure_map"), and what a run states of its
    error ("error", and bands of outputs). Of a ROM: its Hankel
    singular values ("sigma") and frequency responses ("response").

    Args:
        model: a ROM, a run, or runs by their names in the legend, which are drawn over one another; or their files.
        output: a .pdf, .svg or .png file, which gets all panels; or a folder, which gets a .pdf and a .png of each.
        what: names of panels; None: all that there are.
        dark: light on dark instead of dark on light.
        full: the full model that the ROM was made from: its responses are drawn beside the reduced ones. It takes a
            factorisation at each of some fifty frequencies.
        force: whether existing files of another kind are written over.
        report: called with the stage, how much of it is done, and of how much.

    Returns:
        The files that were written.

    Raises:
        FileError: the output has another ending, cannot be written, or is read for this, or of another kind.
        SceneError: there is no such panel, or something else was given than ROMs and runs.
        StructureError, SolverError: of `full`.
        MissingPackageError: there is no Matplotlib.

    Example:
        >>> [file.name for file in fr.plot({"reduced": run}, "run.pdf")]
        ['run.pdf']
    """
    figure_of = figure_class()
    import matplotlib

    place, style = path_in("plot", output), DARK if check_flag("dark", dark, SceneError) else LIGHT
    if what is not None:
        what = names_in("what", what, SceneError)
    if full is not None:
        check_type("plot: full", full, System, "fr.assemble(scene)")
    inputs = [*_files_in(model), *(full.scene.files if full is not None and full.scene is not None else ())]
    in_folder = is_folder(place)
    if not in_folder:
        check_outputs(place, inputs=inputs, force=force)
    panels = _select_panels(_read(model), style, what, full, report)
    files = [place]
    if in_folder:
        names = [f"{name}{ending}" for name in panels for ending in FOLDER_FORMATS]
        check_outputs_in(place, names, inputs=inputs, force=force)
        make_folder(place)
        files = [place / name for name in names]
    with matplotlib.rc_context(style.settings):
        if in_folder:
            for name, draw in panels.items():
                size = COLUMN_INCHES, HEIGHT_INCHES * RELATIVE_HEIGHTS.get(name, 1.0)
                figure = figure_of(figsize=size, layout="constrained")
                draw(figure)
                for ending in FOLDER_FORMATS:
                    write_figure(figure, place / f"{name}{ending}", dpi=DPI)
        else:
            wide = min(len(panels), 2)
            high = math.ceil(len(panels) / wide)
            tall = max(RELATIVE_HEIGHTS.get(name, 1.0) for name in panels)
            figure = figure_of(figsize=(wide * COLUMN_INCHES, high * HEIGHT_INCHES * tall), layout="constrained")
            parts = figure.subfigures(high, wide, squeeze=False)
            for draw, part in zip(panels.values(), parts.flat, strict=False):
                draw(part)
            write_figure(figure, place, dpi=DPI)
    return tuple(files)


def is_folder(place: Path) -> bool:
    """Whether plots are to go into a folder; FileError where they can go neither into one nor into such a file."""
    try:
        is_folder = place.is_dir() or not place.suffix
    except OSError as error:  # as of a name that is too long
        raise FileError(f"{place}: cannot be written: {system_reason(error)}") from error
    if is_folder:
        check_folder(place)
        return True
    if place.suffix not in FORMATS:
        raise FileError(f"{place}: use a folder, or a file that ends in {', '.join(FORMATS)}")
    return False


def _files_in(model: Any) -> list[File]:
    """Names of files among what is to be drawn."""
    return [
        each for each in (model.values() if isinstance(model, Mapping) else [model]) if isinstance(each, str | PathLike)
    ]


def _read(model: File | Rom | Trajectory | Mapping[str, Trajectory | File]) -> Rom | dict[str, Trajectory]:
    """The ROM, or the runs by their names."""
    if isinstance(model, Mapping):
        mapping_in("plot", model, SceneError)
        if not model:
            raise SceneError("plot: no runs were given; use at least one")
        return {name: object_or_file("plot", run, RUN_FILE) for name, run in model.items()}
    one = object_or_file("plot", model, ROM_FILE, RUN_FILE)
    return one if isinstance(one, Rom) else {one.name: one}


def _select_panels(
    model: Rom | dict[str, Trajectory], style: Style, what: Sequence[str] | None, full: System | None, report: Report
) -> Mapping[str, Panel]:
    """The panels that were asked for; raises SceneError where there is none of that name, or nothing at all."""
    if isinstance(model, Rom):
        asked = has_frequencies(model) and (what is None or "response" in what)
        response = full_response(model, full, report) if asked and full is not None else None
        panels = reduced_panels(model, style, response)
    else:
        panels = run_panels(model)
    for name in what or ():
        check_known("plot", name, panels, SceneError)
    if not panels or what == ():
        raise SceneError(
            "there is nothing to draw: no plot is named, or the ROM has neither Hankel singular values nor frequencies"
        )
    return {name: panels[name] for name in (panels if what is None else dict.fromkeys(what))}
