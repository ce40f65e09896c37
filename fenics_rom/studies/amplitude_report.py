"""What a study of amplitudes leaves for people to read: a table, and a picture of error over size and over speed."""

from pathlib import Path

from fenics_rom.io.atomic_write import write_whole
from fenics_rom.io.markdown import markdown
from fenics_rom.studies.amplitudes import AmplitudeResults
from fenics_rom.trajectory.comparison import FORCE_MEASURES
from fenics_rom.visualization.figure import figure_class, write_figure

FILES = ("amplitudes.md", "amplitudes.png", "amplitudes.pdf")
TABLE_HEADING = ("load", "largest displacement", "model", "step", "error", "steps per second", "times real time")
STYLES = {  # colour, marker, line
    "linear, full order": ("tab:red", "s", "--"),
    "linear, reduced": ("tab:orange", "o", "-"),
    "nonlinear, full order": ("0.25", "s", "--"),
    "nonlinear, reduced, newton": ("tab:blue", "v", "-"),
    "nonlinear, reduced, linearly-implicit": ("tab:green", "o", "-"),
}


def write_amplitude_report(folder: Path, results: AmplitudeResults, command: str) -> None:
    """Writes amplitudes.md, .png and .pdf; the command is the one that made them."""
    write_whole(folder / "amplitudes.md", markdown_report(results, command).encode())
    _draw(results, folder)


def markdown_report(results: AmplitudeResults, command: str) -> str:
    """The study as Markdown."""
    offline = ", ".join(f"{name} {seconds:.0f} s" for name, seconds in results.offline.items())
    validation = "was not measured" if results.validation is None else f"is {results.validation:.1e}"
    return "\n\n".join(
        [
            f"# What large deformation costs: {results.name}",
            f"Made by `{command}`.",
            f"{results.unknowns:,} unknowns; reductions: {offline}. The error of the nonlinear ROM on a run that it "
            f"was not trained on {validation}. Errors are of the whole shape over the run, in the mass norm, against "
            "the nonlinear full order, whose own error is estimated from twice its step.",
            markdown(TABLE_HEADING, table_rows(results)),
            *_forces(results),
            *(f"- {note}" for note in results.notes),
        ]
    )


def table_rows(results: AmplitudeResults) -> list[tuple[str, ...]]:
    """Every model at every load, under TABLE_HEADING."""
    return [
        (
            f"{row.share:.3g}",
            f"{1e3 * row.displacement:.3g} mm",
            f"{row.model}, order {row.order:,}" if "reduced" in row.model else row.model,
            f"{1e3 * row.dt:.3g} ms",
            f"{row.error:.1e}",
            f"{row.rate:,.0f}" if row.rate >= 10 else f"{row.rate:.1f}",
            f"{row.real_time:.3g}",
        )
        for row in results.rows
    ]


def _forces(results: AmplitudeResults) -> list[str]:
    """Errors of contact forces of every model at every load, of those obstacles that anything touches."""
    rows = [
        (f"{row.share:.3g}", name, row.model, *(f"{error:.1e}" for error in errors))
        for row in results.rows
        for name, errors in row.forces.items()
        if any(errors)
    ]
    return ["Contact forces:", markdown(("load", "obstacle", "model", *FORCE_MEASURES), rows)] if rows else []


def _draw(results: AmplitudeResults, folder: Path) -> None:
    figure = figure_class()(figsize=(10.5, 4.6), layout="constrained")
    over_size, over_speed = figure.subplots(1, 2, sharey=True)
    for model, (colour, marker, line) in STYLES.items():
        rows = [row for row in results.rows if row.model == model]
        errors = [row.error for row in rows]
        style = {"linestyle": line, "marker": marker, "color": colour, "markersize": 5, "label": model}
        over_size.plot([1e3 * row.displacement for row in rows], errors, **style)
        over_speed.plot([row.real_time for row in rows], errors, **style)
        for row in rows:
            if row.share == 1.0:
                over_speed.plot(row.real_time, row.error, marker, color=colour, markersize=11, fillstyle="none")
    over_size.set(xscale="log", yscale="log", xlabel="largest displacement (mm)", ylabel="error of the whole shape")
    over_size.legend(fontsize=8)
    over_speed.set(xscale="log", xlabel="seconds simulated in a second")
    over_speed.set_title("ringed: the whole load", fontsize=9, loc="right")
    over_speed.axvline(1.0, color="0.6", linewidth=0.8)
    at_line = {"xycoords": ("data", "axes fraction"), "xytext": (4, 0), "textcoords": "offset points"}
    over_speed.annotate("real time", (1.0, 0.02), **at_line, fontsize=8, color="0.4")
    for axes in (over_size, over_speed):
        axes.grid(True, which="major", color="0.9")
    for ending in ("png", "pdf"):
        write_figure(figure, folder / f"amplitudes.{ending}", dpi=150)
