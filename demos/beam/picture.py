"""The picture of the page: the fit, the moduli, and 52 g."""

from pathlib import Path
from typing import Any

import numpy as np
from moduli import Asked
from recordings import Recording
from relaxation import Falls, Law
from tables import Predictions

from fenics_rom.visualization.figure import figure_class, write_figure


def draw(
    file: Path,
    recorded: dict[str, Recording],
    falls: Falls,
    force: float,
    predictions: Predictions,
    moduli: list[Asked],
    level_error: float,
) -> None:
    """Three panels, side by side."""
    figure = figure_class()(figsize=(14, 4.2), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    draw_alone(left, [recorded["alone_a"], recorded["alone_b"]], falls, force)
    draw_moduli(middle, moduli, falls.law)
    draw_loaded(right, [recorded["weight52_a"], recorded["weight52_b"]], predictions, level_error)
    write_figure(figure, file, dpi=90)


def draw_recordings(axes: Any, recordings: list[Recording], size: float) -> None:
    """Both releases."""
    for name, recording, marker, grey in zip("ab", recordings, "ox", ("0.5", "0.7"), strict=True):
        style = {"color": grey, "markersize": size, "label": f"measured, {name}"}
        axes.plot(recording.times, 1e3 * recording.fall, marker, **style)


def draw_alone(axes: Any, recordings: list[Recording], falls: Falls, force: float) -> None:
    """The first second without a weight, and what comes after on a shorter scale."""
    times = np.linspace(0.0, 4.25, 4000)
    later = axes.inset_axes((0.42, 0.62, 0.56, 0.35))
    for panel, size in ((axes, 4), (later, 2)):
        draw_recordings(panel, recordings, size)
        panel.plot(times, 1e3 * falls.at(times, force), color="C0", linewidth=1.2, label="relaxing, fitted")
    axes.set(xlim=(-0.05, 1.4), xlabel="time (s)", ylabel="height of the tip (mm)", title="alone: found from this")
    later.set(xlim=(1.0, 4.25), ylim=(-6.7, -6.0))
    later.tick_params(labelsize=7)
    axes.legend(loc="lower right", fontsize=8)


def draw_moduli(axes: Any, moduli: list[Asked], law: Law) -> None:
    """Moduli over their time scales, and the law."""
    times = np.logspace(-2, 1, 200)
    vibrating = [law.vibrating(1 / (2 * np.pi * time)) / 1e3 for time in times]
    axes.semilogx(times, vibrating, "C0:", label="law, in vibration")
    axes.semilogx(times, [law.after(time) / 1e3 for time in times], "C0", label="law, under a load")
    for case, marker, colour in (("alone", "o", "C1"), ("52 g", "s", "C3")):
        mine = [one for one in moduli if one.case == case]
        at, level, below = np.array([(one.time, one.held_level / 1e3, one.held_below / 1e3) for one in mine]).T
        axes.semilogx(at, level, marker, color="0.6", fillstyle="none", label=f"{case}, held level")
        axes.semilogx(at, below, marker, color=colour, label=f"{case}, held below")
    axes.set(xlabel="time scale (s)", ylabel="Young's modulus (kPa)", title="the modulus that each number asks for")
    axes.legend(fontsize=8)


def draw_loaded(axes: Any, recordings: list[Recording], predictions: Predictions, level_error: float) -> None:
    """52 g: the recordings, and both laws."""
    draw_recordings(axes, recordings, 4)
    for name, colour in (("elastic", "C2"), ("relaxing", "C0")):
        told = predictions[name, "52 g"]
        heights = 1e3 * (told.heights - told.heights[0])
        axes.plot(told.run.times, heights, color=colour, linewidth=1.2, label=f"{name}, foretold")
        axes.plot([1.5, 1.8], [-1e3 * told.sag] * 2, color=colour, linewidth=2.5)
    rest = 1e3 * float(np.mean([one.at_rest[:, 2] for one in recordings]))
    axes.errorbar([1.65], [rest], yerr=1e3 * level_error, color="k", marker="o", capsize=4, label="measured after 5 s")
    axes.set(xlim=(-0.05, 1.85), xlabel="time (s)", ylabel="height of the tip (mm)", title="52 g: nothing fitted")
    axes.legend(fontsize=8, loc="upper right")
