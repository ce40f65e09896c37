"""The pictures of a study: error against speed, error against order, and what the error is made of."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps

from fenics_rom.studies.method_configs import METHOD_CONFIGS
from fenics_rom.studies.pareto import format_step, largest_model, pareto_front, select_per_decade
from fenics_rom.studies.study_results import PICTURES, StudyResults
from fenics_rom.visualization.figure import figure_class, write_figure

COLOURS = dict(
    zip(METHOD_CONFIGS, ("tab:blue", "tab:red", "tab:green", "tab:orange", "tab:purple", "tab:blue"), strict=True)
)
MARKERS = dict(zip(METHOD_CONFIGS, "osv^DX", strict=True))
FIGURE_INCHES = (7.5, 4.8)
ORDER_LABEL = "order (displacements of a contact mode)"


def draw(results: StudyResults, folder: Path) -> None:
    """Writes the PICTURES, each as .png and .pdf."""
    for name, draw_axes in zip(PICTURES, (_draw_speed, _draw_orders, _draw_parts), strict=True):
        figure = figure_class()(figsize=FIGURE_INCHES, layout="constrained")
        axes = figure.add_subplot()
        draw_axes(axes, results)
        axes.grid(True, which="major", color="0.9")
        for ending in ("png", "pdf"):
            write_figure(figure, folder / f"{name}.{ending}", dpi=150)


def _draw_speed(axes: Any, results: StudyResults) -> None:
    """Error against speed; what is beaten in both is grey."""
    front = pareto_front(results.rows)
    for row in results.rows:
        colour, size, above = (COLOURS[row.method], 7, 3) if row in front else ("0.8", 4, 1)
        axes.plot(row.real_time, row.error, MARKERS[row.method], color=colour, markersize=size, zorder=above)
    axes.plot([row.real_time for row in front], [row.error for row in front], color="0.4", linewidth=1, zorder=2)
    note = {"textcoords": "offset points", "fontsize": 8}
    for _, row in select_per_decade(results.rows):
        label = f"order {row.order}, {format_step(row.dt)}"
        axes.annotate(label, (row.real_time, row.error), xytext=(8, -3), verticalalignment="top", **note)
    for method in _methods(results):
        axes.plot([], [], MARKERS[method], color=COLOURS[method], label=METHOD_CONFIGS[method].label)
    axes.axhline(results.reference_error, color="black", linewidth=0.8, linestyle=":")
    place = {"xy": (0.01, results.reference_error), "xycoords": ("axes fraction", "data"), "xytext": (0, 3)}
    axes.annotate(_own_error(results), **place, **note)
    axes.margins(x=0.2)
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="seconds simulated in a second",
        ylabel=f"{results.error_name} of the whole shape",
    )
    top = axes.secondary_xaxis("top", functions=(lambda x: x / results.dt, lambda x: x * results.dt))
    top.set_xlabel(f"steps per second, if all were of {format_step(results.dt)}")
    axes.legend(fontsize=8, loc="lower right")


def _draw_orders(axes: Any, results: StudyResults) -> None:
    """Error of the reduction against order, with what was known before any run: σ, and the validation."""
    first = results.rows[0].method
    for method in _methods(results):
        points = ((row.order, row.reduction) for row in results.rows if row.method == method)
        style = {"color": COLOURS[method], "label": METHOD_CONFIGS[method].label, "markersize": 5}
        _plot(axes, points, MARKERS[method] + "-", **style)
        bounds = [(row.order, row.bound) for row in results.rows if row.method == method and row.bound is not None]
        if bounds:
            _plot(axes, bounds, "--", color=COLOURS[method], linewidth=1)
    if any(row.bound is not None for row in results.rows):
        axes.plot([], [], "--", color="0.5", linewidth=1, label="bounds of these, in the energy norm")
    validated = [(row.order, row.transfer_error) for row in results.rows if row.method == first and row.transfer_error]
    if validated:
        label = f"validation of {METHOD_CONFIGS[first].label}: transfer error"
        _plot(axes, validated, "x", color="black", label=label)
    largest = max(row.order for row in results.rows)
    for name, σ in results.hankel.items():
        shown = np.array(σ[: largest + 1])
        once = "σ of each contact mode / σ_1" if name == next(iter(results.hankel)) else None
        axes.plot(np.arange(1, len(shown) + 1), shown / shown[0], color="0.6", linewidth=1, label=once, zorder=0)
    axes.set(yscale="log", xlabel=ORDER_LABEL, ylabel=f"{results.error_name} of the whole shape, reduction alone")
    axes.legend(fontsize=8)


def _draw_parts(axes: Any, results: StudyResults) -> None:
    """What the error is made of: the reduction falls with the order, the step and the mesh do not."""
    first = results.rows[0].method
    rows = [row for row in results.rows if row.method == first]
    label = f"reduction alone ({METHOD_CONFIGS[first].label})"
    _plot(axes, ((row.order, row.reduction) for row in rows), "o-", color="tab:blue", label=label)
    steps = largest_model(rows)
    shades = colormaps["plasma"](np.linspace(0.2, 0.85, len(steps)))
    for row, colour in zip(steps, shades, strict=True):
        total = ((other.order, other.error) for other in rows if other.dt == row.dt)
        _plot(axes, total, "-", color=colour, linewidth=1, label=f"all, step {format_step(row.dt)}")
        axes.axhline(row.time_step, color=colour, linewidth=0.8, linestyle="--")
    axes.plot([], [], color="0.5", linewidth=0.8, linestyle="--", label="step alone")
    if results.mesh_error is not None:
        axes.axhline(results.mesh_error, color="tab:green", linestyle="-.", label="mesh, at the outputs")
    axes.axhline(results.reference_error, color="black", linewidth=0.8, linestyle=":", label=_own_error(results))
    axes.set(yscale="log", xlabel=ORDER_LABEL, ylabel=f"{results.error_name} of the whole shape")
    axes.legend(fontsize=8, ncols=2)


def _own_error(results: StudyResults) -> str:
    """What the smallest step leaves unknown, in words."""
    step = f"steps of {format_step(results.reference_step)}"
    return f"error of {step}" if results.without_reference else "error of the reference"


def _methods(results: StudyResults) -> list[str]:
    """Those of the rows, in their order."""
    return list(dict.fromkeys(row.method for row in results.rows))


def _plot(axes: Any, points: Iterable[tuple[int, float]], line: str, **style: Any) -> None:
    """Points by order, each once."""
    axes.plot(*zip(*sorted(set(points)), strict=True), line, **style)
