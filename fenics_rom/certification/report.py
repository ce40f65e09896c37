"""A certificate as a page (PDF, or a picture): what was found, what it covers, and beside which limits."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fenics_rom.certification.certificate import MOST_CORNERS, Certificate
from fenics_rom.certification.certify import Strikes
from fenics_rom.certification.impacts import QUANTITIES
from fenics_rom.certification.search import SAFETY
from fenics_rom.errors import FileError
from fenics_rom.io.units import prefixed
from fenics_rom.visualization.figure import LIGHT, figure_class, write_figure
from fenics_rom.visualization.plots.plot import FORMATS

PAGE = (8.27, 11.69)  # inches: A4
HEADING = ("", "largest run", "bound", "+ reduction", "+ step", "= certified", "limit", "")
MOST_PANELS = 4  # of parameters
MOST_LINES = 13  # above the plots


def finding_rows(certificate: Certificate) -> list[tuple[str, ...]]:
    """Cells of a row for each quantity, under HEADING."""
    rows = []
    for name, found in certificate.findings.items():
        factor, unit = prefixed(QUANTITIES[name], max(found.certified, found.limit or 0.0))
        numbers = (found.largest, found.bound, found.reduction, found.time_step, found.certified)
        limit = "none" if found.limit is None else f"{factor * found.limit:.3g}"
        verdict = {None: "", True: "kept", False: "EXCEEDED"}[found.is_kept]
        rows.append((f"{name} ({unit})", *(f"{factor * number:.3g}" for number in numbers), limit, verdict))
    return rows


def coverage_lines(certificate: Certificate) -> list[str]:
    """What was varied and looked at, in sentences."""
    cover = certificate.cover
    return [
        *(f"{each.name}: {each.low:g} to {each.high:g} {each.unit}" for each in certificate.parameters),
        f"{len(certificate.peaks)} runs: {len(cover.middles)} boxes cover all of these ranges, the narrowest "
        f"{cover.widths.min():.2g} of a range; {_corners(certificate)}.",
        f"The bound holds if nothing changes faster than {SAFETY:g} times what was seen between neighbouring runs.",
        f"Errors are the largest of {len(certificate.compared)} runs, with finer models and with half of the "
        "step. Both are added to the bound.",
    ]


def _corners(certificate: Certificate) -> str:
    """How many of the ranges' corners were run."""
    count = len(certificate.parameters)
    if count <= MOST_CORNERS:
        return f"all {len(certificate.corners)} corners"
    return (
        f"none of the {2**count} corners, as of more than {MOST_CORNERS} ranges these are too many: there, where the "
        "worst often is, the bound rests on the slopes alone"
    )


def check_report(file: Path) -> None:
    """What is worth asking before long work: MissingPackageError without Matplotlib, FileError of another ending."""
    figure_class()
    if file.suffix not in FORMATS:
        raise FileError(f"{file}: use a file that ends in {', '.join(FORMATS)}")


def write_report(file: Path, certificate: Certificate) -> None:
    """Writes the page in the format of the file's ending; runs the worst impact once more to draw it.

    Raises:
        MissingPackageError: without Matplotlib.
        FileError: it cannot be written, or has another ending.
    """
    check_report(file)
    from matplotlib import rc_context

    with rc_context(LIGHT.settings):
        figure = figure_class()(figsize=PAGE)
        _draw_words(figure, certificate)
        _draw_time(figure.add_axes((0.1, 0.42, 0.83, 0.15)), certificate)
        shown = _shown(certificate)
        width = 0.83 / len(shown)
        for panel, k in enumerate(shown):
            axes = figure.add_axes((0.1 + panel * width, 0.1, 0.8 * width, 0.24))
            _draw_parameter(axes, certificate, k)
            axes.set_ylabel("largest force (N)" if panel == 0 else "")
            if panel == 0:
                axes.legend(loc="lower right")
        if len(shown) < len(certificate.parameters):
            said = f"The {len(shown)} of {len(certificate.parameters)} ranges along which the force changes most."
            figure.text(0.1, 0.05, said, fontsize=7.5)
        write_figure(figure, file, dpi=150)


def _shown(certificate: Certificate) -> list[int]:
    """Parameters that are drawn, in their order: those along which the force changes most."""
    slopes = certificate.cover.slopes[:, 0]
    return sorted(np.argsort(-slopes, kind="stable")[:MOST_PANELS].tolist())


def _draw_words(figure: Any, certificate: Certificate) -> None:
    table = certificate.scene.file.certificate
    assert table is not None
    figure.text(0.08, 0.95, f"Impact: {certificate.scene.file.name}", fontsize=15, weight="bold")
    about = f"{' and '.join(table.by)} on {table.body}"
    if certificate.limits is not None:
        about += f"; limits of {certificate.limits.region} ({certificate.limits.source})"
    figure.text(0.08, 0.928, about, fontsize=9)
    axes = figure.add_axes((0.08, 0.79, 0.85, 0.12))
    axes.set_axis_off()
    drawn = axes.table(cellText=finding_rows(certificate), colLabels=HEADING, loc="upper center", edges="horizontal")
    drawn.auto_set_font_size(False)
    drawn.set_fontsize(7.5)
    drawn.scale(1, 1.6)
    said, ranges = coverage_lines(certificate), len(certificate.parameters)
    lines = ["; ".join(said[:ranges]), *said[ranges:], *(f"Told: {text}" for text in certificate.warnings)]
    figure.text(0.08, 0.775, "\n".join(_wrapped(lines)), fontsize=7.5, va="top", linespacing=1.5)


def _wrapped(lines: Sequence[str]) -> list[str]:
    from textwrap import wrap

    parts = [part for line in lines for part in wrap(line, 120)]
    return parts if len(parts) <= MOST_LINES else [*parts[: MOST_LINES - 1], "And more: see what the command printed."]


def _draw_time(axes: Any, certificate: Certificate) -> None:
    """Force over time in the worst run."""
    run = certificate.scene.file.run
    assert run is not None
    strikes = Strikes(certificate.scene, certificate.roms, run.dt)
    worst = certificate.points[certificate.peaks[:, 0].argmax()]
    impact = strikes.impact(worst)
    axes.plot(1e3 * impact.times, impact.felt[:, 0])
    axes.set(xlabel="time (ms)", ylabel="force (N)", title=f"The run with the largest force: {strikes.where(worst)}")


def _draw_parameter(axes: Any, certificate: Certificate, k: int) -> None:
    """Largest forces of all runs over one parameter, and what is certified and allowed."""
    parameter, found = certificate.parameters[k], certificate.findings["force"]
    at = [parameter.at(float(share)) for share in certificate.points[:, k]]
    axes.plot(at, certificate.peaks[:, 0], "o", markersize=3)
    axes.axhline(found.certified, color=LIGHT.colours[1], label=f"certified: {found.certified:.3g} N")
    if found.limit is not None and found.limit < 3 * found.certified:
        axes.axhline(found.limit, color="black", linestyle="--", label=f"limit: {found.limit:.3g} N")
    axes.set(xlabel=f"{parameter.name} ({parameter.unit})", ylim=(0, None))
