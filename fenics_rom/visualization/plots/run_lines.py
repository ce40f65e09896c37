"""What all plots of runs share: the axis of time, the line of each run, and the legend."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from fenics_rom.io.units import prefixed
from fenics_rom.trajectory.trajectory import Trajectory
from fenics_rom.visualization.figure import DASHES

UNDERLYING_LINE: dict[str, Any] = {"linestyle": "-", "linewidth": 3.0, "alpha": 0.35}
LONG_LABEL_LETTERS = 18  # three such labels are wider than a panel
MAX_MARKED_SWITCHES = 30


def draw_time_axis(axes: Any, runs: Mapping[str, Trajectory]) -> float:
    """Prepares the abscissa, marks the instants at which the contact mode changes, and tells the scale of time."""
    scale, unit = prefixed("s", max(run.times[-1] for run in runs.values()))
    axes.set_xlabel(f"time ({unit})")
    first = next(iter(runs.values()))
    switches = first.times[np.flatnonzero(np.diff(first.contact)) + 1]
    if len(switches) <= MAX_MARKED_SWITCHES:
        for t in switches:
            axes.axvline(scale * t, color="0.6", linewidth=0.5, zorder=0)
    exceeded = np.concatenate([[], *(run.tolerance.times for run in runs.values() if run.tolerance is not None)])
    for t in exceeded:
        axes.axvline(scale * t, color="C3", linewidth=1.0, linestyle="--", zorder=0)
    if len(exceeded):
        axes.plot([], [], color="C3", linewidth=1.0, linestyle="--", label="beyond error tolerance")
    return scale


def line_styles(runs: Mapping[str, Trajectory]) -> list[dict[str, Any]]:
    """The line of each run: of several the first is broad and pale, so that it can be seen under others."""
    styles = [{"linestyle": DASHES[k % len(DASHES)]} for k in range(len(runs))]
    return styles if len(runs) == 1 else [UNDERLYING_LINE, *styles[:-1]]


def draw_legend(figure: Any, axes: Any, colours: Mapping[str, str], runs: Mapping[str, Trajectory]) -> None:
    """Below the axes: colours are quantities, lines are runs."""
    for words, colour in colours.items():
        axes.plot([], [], color=colour, label=words)
    if len(runs) > 1:
        for line, label in zip(line_styles(runs), runs, strict=True):
            axes.plot([], [], color="0.5", label=label, **line)
    for label, run in runs.items():
        if run.beyond_training:
            axes.plot([], [], " ", label=f"{label}: beyond its training")
    longest = max(map(len, axes.get_legend_handles_labels()[1]))
    figure.legend(loc="outside lower center", ncols=3 if longest < LONG_LABEL_LETTERS else 2)
