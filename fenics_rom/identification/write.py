"""What an identification leaves in a folder: a scene that runs, a report, the residuals and a picture of the fit."""

import csv
import io
from pathlib import Path

import numpy as np

from fenics_rom.errors import FileError
from fenics_rom.identification.identified_scene import identified_text
from fenics_rom.identification.plot import draw_fit
from fenics_rom.identification.result import Estimate, Identification
from fenics_rom.io.atomic_write import check_folder, write_whole
from fenics_rom.io.markdown import markdown
from fenics_rom.io.mpi_ranks import is_rank_0

PARAMETER_HEADING = ("parameter", "unit", "start", "found", "95 % interval", "")


def write_identification(folder: str | Path, result: Identification) -> None:
    """Writes identified.toml, identification.md, residuals.csv, fit.png and fit.pdf; under MPI rank 0 alone writes.

    Args:
        folder: is made where it does not exist.
        result: what was found.

    Raises:
        FileError: the folder cannot be made or written to.
        MissingPackageError: there is no Matplotlib.

    Example:
        >>> fr.write_identification("found", fr.identify(scene, ["markers.csv"], parameters=["young"]))
        >>> fr.read_scene("found/identified.toml").name
        'plate'
    """
    if not is_rank_0():
        return
    place = Path(folder)
    texts = {
        "identified.toml": identified_text(result, place),
        "identification.md": markdown_report(result),
        "residuals.csv": residuals_csv(result),
    }
    check_folder(place)
    try:
        place.mkdir(exist_ok=True)
        for name, text in texts.items():
            write_whole(place / name, text.encode())
        draw_fit(result, [place / "fit.png", place / "fit.pdf"])
    except OSError as error:
        raise FileError(f"{place}: cannot be written: {error.strerror or error}") from error


def parameter_rows(result: Identification) -> list[tuple[str, ...]]:
    """The table of parameters, under PARAMETER_HEADING."""
    return [
        (
            estimate.parameter.name,
            estimate.parameter.unit,
            _number(estimate.parameter.start),
            "not determined" if estimate.held else _number(estimate.value),
            _interval(estimate),
            "held at its start value" if estimate.held else "",
        )
        for estimate in result.estimates
    ]


def _interval(estimate: Estimate) -> str:
    if estimate.low is None or estimate.high is None:
        return "-"
    return f"{_number(estimate.low)} to {_number(estimate.high)}"


def _number(value: float) -> str:
    return f"{value:.5g}"


def summary_lines(result: Identification) -> dict[str, str]:
    """How good the fit is, line by line."""
    experiment = result.experiment
    moving = len(experiment.times)
    shifts = {name: shift.max(initial=0.0) for name, shift in result.shifts.items()}
    return {
        "measured": f"{moving} values in motion, {len(experiment.measured) - moving} at rest",
        "residual": f"{result.residual:.4g} m (root mean square)",
        "residual, full order": f"{result.full_residual:.4g} m",
        "noise": f"{result.noise:.4g} m (standard deviation of a value)",
        "reduced model": f"{result.order} displacements, {result.bases} bases",
        "reduction moves": f"at most {shifts['reduction']:.1g} of half an interval",
        "time step moves": f"at most {shifts['time step']:.1g} of half an interval" if moving else "-",
    }


def markdown_report(result: Identification) -> str:
    """Everything in Markdown."""
    parts = [
        f"# Identification of {result.scene.name}\n",
        markdown(PARAMETER_HEADING, parameter_rows(result)),
        "\n".join(f"- {name}: {text}" for name, text in summary_lines(result).items()) + "\n",
    ]
    names = [estimate.parameter.name for estimate in result.found]
    if len(names) > 1:
        correlations = [
            (name, *(f"{value:.3f}" for value in row)) for name, row in zip(names, result.correlations, strict=True)
        ]
        parts += ["Correlations of the errors:\n", markdown(("", *names), correlations)]
    if result.warnings:
        parts += ["Warnings:\n", "\n".join(f"- {message}" for message in result.warnings) + "\n"]
    return "\n".join(parts)


def residuals_csv(result: Identification) -> str:
    """Every value, measured and as the reduced and the full model have it, as CSV."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(
        ("file", "line", "marker", "time (s)", "measured (m)", "model (m)", "full order (m)", "residual (m)")
    )
    experiment = result.experiment
    times = [*map(repr, experiment.times.tolist()), *[""] * len(experiment.rows)]
    columns = np.stack([experiment.measured, result.predicted, result.full, experiment.measured - result.predicted])
    for place, time, values in zip(experiment.places, times, columns.T.tolist(), strict=True):
        file, line, marker = place
        writer.writerow((file, line, marker, time, *(f"{value:.9g}" for value in values)))
    return text.getvalue()
