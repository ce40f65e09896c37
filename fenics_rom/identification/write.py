"""What an identification leaves in a folder: a scene that runs, a report, the residuals and a picture of the fit."""

import csv
import io
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from fenics_rom.arguments import path_in
from fenics_rom.errors import check_type
from fenics_rom.identification.parameters import is_tilting
from fenics_rom.identification.plot import draw_fit
from fenics_rom.identification.result import Given, Identification
from fenics_rom.io.atomic_write import make_folder, write_whole
from fenics_rom.io.markdown import markdown
from fenics_rom.io.mpi_ranks import is_rank_0
from fenics_rom.io.overwriting import check_outputs_in
from fenics_rom.scene.scene import Scene

Keys = tuple[str | int, ...]

FILES = ("identified.toml", "identification.md", "residuals.csv", "fit.png", "fit.pdf")
PARAMETER_HEADING = ("parameter", "unit", "start", "found", "95 % interval", "given")


def write_identification(folder: str | Path, result: Identification, *, force: bool = False) -> None:
    """Writes identified.toml, identification.md, residuals.csv, fit.png and fit.pdf; under MPI rank 0 alone writes.

    Args:
        folder: is made where it does not exist.
        result: what was found.
        force: whether files of other kinds are written over.

    Raises:
        FileError: the folder cannot be made or written to, or one of the files there was read for the result, or is of
            another kind.
        MissingPackageError: there is no Matplotlib.

    Example:
        >>> fr.write_identification("found", fr.identify(scene, ["markers.csv"], parameters=["young"]))
        >>> fr.read_scene("found/identified.toml").name
        'plate'
    """
    check_type("write_identification", result, Identification, "fr.identify(scene, data)")
    place = path_in("write_identification", folder)
    if not is_rank_0():
        return
    texts = {
        "identified.toml": identified_text(result, place),
        "identification.md": markdown_report(result),
        "residuals.csv": residuals_csv(result),
    }
    check_outputs_in(place, FILES, inputs=result.read_files, force=force)
    make_folder(place)
    for name, text in texts.items():
        write_whole(place / name, text.encode())
    draw_fit(result, [place / "fit.png", place / "fit.pdf"])


def identified_text(result: Identification, folder: Path) -> str:
    """The scene file with the values that were found, for a file in `folder`: paths in it are relative to that."""
    found: dict[Keys, str] = {each.parameter.path: f"{each.value:.8g}" for each in result.found if each.parameter.path}
    gravity = result.scene.effects.gravity
    if gravity is not None and is_tilting([estimate.parameter for estimate in result.found]):
        numbers = ", ".join(f"{component:.8g}" for component in gravity.acceleration)
        found["effects", "gravity", "acceleration"] = f"[{numbers}]"
    held = ", ".join(estimate.parameter.name for estimate in result.estimates if estimate.held)
    said = f"# The data do not determine {held}: left at the start value.\n" if held else ""
    return said + scene_text(result.scene, found, folder)


def scene_text(scene: Scene, found: Mapping[Keys, str], folder: Path) -> str:
    """The scene file with other values, as TOML has them, for a file in `folder`."""
    document = tomlkit.parse(scene.text)
    for path, text in found.items():
        replace_value(document, path, tomlkit.value(text))
    for path, file in ((("mesh", "file"), document["mesh"]["file"]), *_tables(document)):
        if not Path(file).is_absolute():
            moved = os.path.relpath(Path(scene.source).parent / file, folder)
            replace_value(document, path, Path(moved).as_posix())
    return tomlkit.dumps(document)


def replace_value(document: Any, path: Keys, value: Any) -> None:
    """Gives a document another value, wherever it is written."""
    *tables, key = path
    for table in tables:
        document = document[table]
    document[key] = value


def _tables(part: Any) -> Iterator[tuple[Keys, str]]:
    """Keys that name tables, anywhere in a part of a scene, and their names."""
    for key, value in part.items() if isinstance(part, Mapping) else enumerate(part):
        if isinstance(value, Mapping | list):
            yield from (((key, *keys), name) for keys, name in _tables(value))
        elif key == "table":
            yield (key,), value


def parameter_rows(result: Identification) -> list[tuple[str, ...]]:
    """The table of parameters, under PARAMETER_HEADING."""
    rows: list[tuple[str, ...]] = []
    for estimate in result.estimates:
        parameter, low, high = estimate.parameter, estimate.low, estimate.high
        found = "not determined" if estimate.held else f"{estimate.value:.5g}"
        interval = "-" if low is None or high is None else f"{low:.5g} to {high:.5g}"
        given = "held at its start value" if estimate.held else "; ".join(map(_condition, estimate.given)) or "-"
        rows.append((parameter.name, parameter.unit, f"{parameter.start:.5g}", found, interval, given))
    return rows


def _condition(given: Given) -> str:
    """A held value, and what the estimate moves by where it is a little more."""
    parameter = given.parameter
    unit = "" if parameter.unit == "1" else f" {parameter.unit}"
    return f"{parameter.name} = {parameter.start:.5g}{unit} ({given.step:+.2g}: {given.shift:+.2g})"


def summary_lines(result: Identification) -> dict[str, str]:
    """How good the fit is, line by line."""
    experiment = result.experiment
    moving = len(experiment.times)
    shifts = {name: shift.max(initial=0.0) for name, shift in result.shifts.items()}
    return {
        "measured": f"{moving} values in motion, {len(experiment.measured) - moving} at rest"
        + (f"; {experiment.unseen} cells were empty" if experiment.unseen else ""),
        "residual": f"{result.residual:.4g} m (root mean square)",
        "residual, full order": f"{result.full_residual:.4g} m",
        "noise": f"{result.noise:.4g} m (standard deviation of a value)",
        "reduced model": f"{result.order} displacements, {result.bases} bases",
        "intervals": "by differences of full-order runs" if result.full_order_jacobian else "by exact derivatives",
        "reduction moves": f"at most {shifts['reduction']:.1g} of half an interval",
        "time step moves": f"at most {shifts['time step']:.1g} of half an interval" if moving else "-",
    }


def markdown_report(result: Identification) -> str:
    """Everything in Markdown."""
    parts = [
        f"# Identification of {result.scene.name}\n",
        markdown(PARAMETER_HEADING, parameter_rows(result)),
        listed(summary_lines(result)),
    ]
    names = [estimate.parameter.name for estimate in result.found]
    if len(names) > 1:
        correlations = [
            (name, *(f"{value:.3f}" for value in row)) for name, row in zip(names, result.correlations, strict=True)
        ]
        parts += ["Correlations of the errors:\n", markdown(("", *names), correlations)]
    return with_warnings(parts, result.warnings)


def listed(lines: Mapping[str, str]) -> str:
    """Lines of a report, each with its name, in Markdown."""
    return "\n".join(f"- {name}: {text}" for name, text in lines.items()) + "\n"


def with_warnings(parts: Sequence[str], warnings: Sequence[str]) -> str:
    """A report in Markdown of its parts, and what was warned of, if anything was."""
    told = ["Warnings:\n", "\n".join(f"- {message}" for message in warnings) + "\n"] if warnings else []
    return "\n".join([*parts, *told])


def residuals_csv(result: Identification) -> str:
    """Every value, measured and as the reduced and the full model have it, as CSV."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(
        ("file", "line", "marker", "time (s)", "measured (m)", "model (m)", "full order (m)", "residual (m)")
    )
    experiment = result.experiment
    times = [*map(repr, experiment.times.tolist()), *[""] * (len(experiment.measured) - len(experiment.times))]
    columns = np.stack([experiment.measured, result.predicted, result.full, experiment.measured - result.predicted])
    for place, time, values in zip(experiment.places, times, columns.T.tolist(), strict=True):
        file, line, marker = place
        writer.writerow((file, line, marker, time, *(f"{value:.9g}" for value in values)))
    return text.getvalue()
