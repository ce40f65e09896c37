"""The picture of a study of amplitudes: error over the size of the motion, and over rate_of_run."""

from pathlib import Path
from typing import Any

from fenics_rom.studies.amplitudes import AmplitudeResults, AmplitudeRow
from fenics_rom.visualization.figure import figure_class, write_figure

STYLES = {  # colour, marker, line
    "linear, full order": ("tab:red", "s", "--"),
    "linear, reduced": ("tab:orange", "o", "-"),
    "nonlinear, full order": ("0.25", "s", "--"),
    "nonlinear, reduced, newton": ("tab:blue", "v", "-"),
    "nonlinear, reduced, linearly-implicit": ("tab:green", "o", "-"),
}


def draw(results: AmplitudeResults, folder: Path) -> None:
    """Writes amplitudes.png and .pdf."""
    figure = figure_class()(figsize=(10.5, 4.6), layout="constrained")
    over_size, over_speed = figure.subplots(1, 2, sharey=True)
    for model, style in STYLES.items():
        rows = [row for row in results.rows if row.model == model]
        _line(over_size, [1e3 * row.displacement for row in rows], rows, style, model)
        _line(over_speed, [row.real_time for row in rows], rows, style, model)
        for row in rows:
            if row.share == 1.0:
                over_speed.plot(row.real_time, row.error, style[1], color=style[0], markersize=11, fillstyle="none")
    over_size.set(xscale="log", yscale="log", xlabel="largest displacement (mm)", ylabel="error of the whole shape")
    over_speed.set(xscale="log", xlabel="seconds simulated in a second")
    over_speed.axvline(1.0, color="0.6", linewidth=0.8)
    over_speed.annotate(
        "real time",
        (1.0, 0.02),
        xycoords=("data", "axes fraction"),
        xytext=(4, 0),
        textcoords="offset points",
        fontsize=8,
        color="0.4",
    )
    over_speed.set_title("ringed: the whole load", fontsize=9, loc="right")
    for axes in (over_size, over_speed):
        axes.grid(True, which="major", color="0.9")
    over_size.legend(fontsize=8)
    for ending in ("png", "pdf"):
        write_figure(figure, folder / f"amplitudes.{ending}", dpi=150)


def _line(axes: Any, x: list[float], rows: list[AmplitudeRow], style: tuple[str, str, str], label: str) -> None:
    colour, marker, line = style
    axes.plot(x, [row.error for row in rows], line, marker=marker, color=colour, markersize=5, label=label)
