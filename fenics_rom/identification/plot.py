"""A picture of a fit: what was measured, what the model says, and what is left."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.identification.result import Identification
from fenics_rom.visualization.figure import figure_class, write_figure

MAX_MARKERS = 5  # markers of a motion that are drawn, those that move most
PANELS_PER_ROW = 3  # panels side by side


def draw_fit(result: Identification, files: Sequence[Path]) -> None:
    """Draws the markers that move most over time, and all values at rest against the model's, each above its residuals.

    Each file gets it in the format of its ending; MissingPackageError where there is no Matplotlib.
    """
    figure_of = figure_class()
    panels = _motions(result)
    count = len(panels) + (len(result.experiment.measured) > len(result.experiment.times))
    high = math.ceil(count / PANELS_PER_ROW)
    wide = math.ceil(count / high)
    figure = figure_of(figsize=(4.2 * wide, 3.6 * high), layout="constrained")
    cells = figure.add_gridspec(high, wide)
    for number in range(count):
        pair = cells[number // wide, number % wide].subgridspec(2, 1, height_ratios=(3, 1), hspace=0.0)
        above, below = (figure.add_subplot(pair[k]) for k in range(2))
        if number < len(panels):
            (file, column), values = panels[number]
            _draw_motion(above, below, result, values, f"{column} ({Path(file).name})")
        else:
            _draw_rest(above, below, result)
        above.tick_params(labelbottom=False)
        below.axhline(0, color="black", linewidth=0.8)
        below.set_ylabel("residual (mm)", fontsize=8)
        above.legend(fontsize=8)
    for target in files:
        write_figure(figure, target, dpi=110)


def _motions(result: Identification) -> list[tuple[tuple[str, str], Array]]:
    """Which values are of which file and marker; those that move most first."""
    experiment = result.experiment
    series = [(file, column) for file, _, column in experiment.places[: len(experiment.times)]]
    groups = {name: np.flatnonzero([other == name for other in series]) for name in dict.fromkeys(series)}
    moved = sorted(groups.items(), key=lambda group: -np.ptp(experiment.measured[group[1]]))
    return moved[:MAX_MARKERS]


def _draw_motion(above: Any, below: Any, result: Identification, values: Array, title: str) -> None:
    t, measured, model = (
        array[values] for array in (result.experiment.times, result.experiment.measured, result.predicted)
    )
    above.plot(t, 1e3 * measured, ".", markersize=3, color="0.5", label="measured")
    above.plot(t, 1e3 * model, color="C0", linewidth=1.2, label="model")
    above.set_title(title, fontsize=9, loc="left")
    above.set_ylabel("displacement (mm)", fontsize=8)
    below.plot(t, 1e3 * (measured - model), ".", markersize=3, color="0.5")
    below.set_xlabel("time (s)", fontsize=8)
    below.sharex(above)


def _draw_rest(above: Any, below: Any, result: Identification) -> None:
    moving = len(result.experiment.times)
    measured, model = 1e3 * result.experiment.measured[moving:], 1e3 * result.predicted[moving:]
    ends = [min(model.min(), measured.min()), max(model.max(), measured.max())]
    above.plot(ends, ends, color="C0", linewidth=1.2, label="model")
    above.plot(model, measured, ".", markersize=4, color="0.5", label="measured")
    above.set_title("equilibria, all markers", fontsize=9, loc="left")
    above.set_ylabel("measured (mm)", fontsize=8)
    below.plot(model, measured - model, ".", markersize=4, color="0.5")
    below.set_xlabel("model (mm)", fontsize=8)
    below.sharex(above)
