"""Plots of a sense of touch: the taxels where it feels most, and how near each patch of contact is to slipping."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from fenics_rom.io.units import prefixed
from fenics_rom.mechanics.touch import TOUCH
from fenics_rom.trajectory.series import ReadingSeries
from fenics_rom.trajectory.trajectory import Trajectory
from fenics_rom.visualization.figure import Panel
from fenics_rom.visualization.plots.run_lines import draw_legend, draw_time_axis, line_styles

PARTS = {"margin": "margin to slip", "sliding": "slides already"}  # of the patch that presses most


def touch_panels(runs: Mapping[str, Trajectory]) -> dict[str, Panel]:
    """What there is to draw of runs by name: taxels of the first that has them, and slip of all."""
    found: dict[str, dict[str, tuple[Trajectory, ReadingSeries]]] = {}
    for label, run in runs.items():
        for name, reading in run.readings.items():
            if reading.quantity == TOUCH:
                found.setdefault(name, {})[label] = run, reading
    panels: dict[str, Panel] = {}
    for name, felt in found.items():
        run, reading = next(iter(felt.values()))
        if reading.taxels is not None and len(reading.taxels.areas):
            panels[f"taxels_{name}"] = partial(_draw_taxels, run=run, reading=reading, name=name)
        panels[f"slip_{name}"] = partial(_draw_slip, felt=felt, name=name)
    return panels


def _draw_taxels(figure: Any, run: Trajectory, reading: ReadingSeries, name: str) -> None:
    """Pressures at the instant of the largest normal force."""
    axes, touch, taxels = figure.subplots(), reading.touch, reading.taxels
    assert taxels is not None
    instant = int(touch.normal_force.argmax())
    pressures = touch.pressures[instant]
    scale, unit = prefixed("Pa", float(np.abs(pressures).max()))
    there = taxels.areas.reshape(pressures.shape) > 0
    drawn = axes.imshow(scale * np.where(there, pressures, np.nan), origin="lower", cmap="viridis", aspect="equal")
    figure.colorbar(drawn, ax=axes, label=f"pressure ({unit})")
    axes.set(xlabel="column", ylabel="row", title=f"taxels of {name} at {run.times[instant]:.4g} s")


def _draw_slip(figure: Any, felt: Mapping[str, tuple[Trajectory, ReadingSeries]], name: str) -> None:
    """Margin to slip of the patch that presses most, and which part of its normal force slides."""
    axes, runs = figure.subplots(), {label: run for label, (run, _) in felt.items()}
    time = draw_time_axis(axes, runs)
    for line, (run, reading) in zip(line_styles(runs), felt.values(), strict=True):
        patches = reading.touch.patches
        there = np.where(patches.normal_force[:, 0] > 0, 1.0, np.nan)
        for k, part in enumerate(PARTS):
            axes.plot(time * run.times, there * getattr(patches, part)[:, 0], color=f"C{k}", **line)
    draw_legend(figure, axes, {words: f"C{k}" for k, words in enumerate(PARTS.values())}, runs)
    axes.set(ylabel="share (1)", ylim=(-0.05, 1.05), title=f"slip of {name}")
