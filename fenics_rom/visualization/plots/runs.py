"""Plots of runs, several over one another: the energy account, the outputs, the forces of obstacles."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from fenics_rom.io.units import prefixed
from fenics_rom.trajectory.trajectory import Trajectory
from fenics_rom.visualization.figure import DASHES, Panel

Array = np.ndarray
Runs = Mapping[str, Trajectory]

LEDGER_LABELS = {
    "energy": "stored",
    "supplied": "supplied",
    "dissipated": "dissipated",
    "lost_in_switching": "lost in switching",
}
CONTACT_LEDGER_LABELS = {
    "obstacles": "supplied by obstacles",
    "contact": "dissipated in contact",
    "friction": "dissipated by friction",
}
AXES = "xyz"
UNDERLYING_LINE: dict[str, Any] = {"linestyle": "-", "linewidth": 3.0, "alpha": 0.35}
LONG_LABEL_LETTERS = 18  # three such labels are wider than a panel
MAX_MARKED_SWITCHES = 30


def run_panels(runs: Runs) -> dict[str, Panel]:
    """What there is to draw of runs, by name; runs that lack an output or an obstacle are left out of its panel."""
    outputs = dict.fromkeys(name for run in runs.values() for name, values in run.outputs.items() if values.size)
    panels: dict[str, Panel] = {"energy": partial(_draw_energy, runs=runs)}
    panels |= {f"output_{name}": partial(_draw_output, runs=runs, name=name) for name in outputs}
    if any(run.forces for run in runs.values()):
        panels["forces"] = partial(_draw_forces, runs=runs)
    return panels


def _draw_energy(figure: Any, runs: Runs) -> None:
    """All sums of the account against time."""
    axes = figure.subplots()
    accounts = [_account(run) for run in runs.values()]
    scale, unit = prefixed("J", max(np.abs(sums).max() for account in accounts for sums in account.values()))
    labels = LEDGER_LABELS | CONTACT_LEDGER_LABELS
    colours = {name: f"C{k}" for k, name in enumerate(labels)}
    time = _draw_time_axis(axes, runs)
    for line, run, account in zip(_line_styles(runs), runs.values(), accounts, strict=True):
        for name, sums in account.items():
            axes.plot(time * run.times, scale * sums, color=colours[name], **line)
    drawn = dict.fromkeys(name for account in accounts for name in account)
    _draw_legend(figure, axes, {labels[name]: colours[name] for name in drawn}, runs)
    axes.set(ylabel=f"energy ({unit})", title="energy account")


def _account(run: Trajectory) -> dict[str, Array]:
    """Its sums, in the order of their labels."""
    contact = {name: run.contact_account[name] for name in CONTACT_LEDGER_LABELS if name in run.contact_account}
    return {name: getattr(run, name) for name in LEDGER_LABELS} | contact


def _draw_output(figure: Any, runs: Runs, name: str) -> None:
    """The three components of an output; of several points their mean, and the range they are in."""
    axes = figure.subplots()
    shown = {label: run for label, run in runs.items() if name in run.outputs}
    scale, unit = prefixed("m", max(np.abs(run.outputs[name]).max() for run in shown.values()))
    time = _draw_time_axis(axes, shown)
    for line, run in zip(_line_styles(shown), shown.values(), strict=True):
        values = scale * run.outputs[name]
        for k in range(3):
            axes.plot(time * run.times, values[:, :, k].mean(axis=1), color=f"C{k}", **line)
            if values.shape[1] > 1:
                low, high = values[:, :, k].min(axis=1), values[:, :, k].max(axis=1)
                axes.fill_between(time * run.times, low, high, color=f"C{k}", alpha=0.2, linewidth=0)
    points = max(run.outputs[name].shape[1] for run in shown.values())
    of = f" (mean and range of {points} points)" if points > 1 else ""
    _draw_legend(figure, axes, {axis: f"C{k}" for k, axis in enumerate(AXES)}, shown)
    axes.set(ylabel=f"displacement ({unit})", title=f"output {name}{of}")


def _draw_forces(figure: Any, runs: Runs) -> None:
    """How strongly each obstacle pushes."""
    axes = figure.subplots()
    shown = {label: run for label, run in runs.items() if run.forces}
    names = dict.fromkeys(name for run in shown.values() for name in run.forces)
    lengths = {
        label: {name: np.linalg.norm(force, axis=1) for name, force in run.forces.items()}
        for label, run in shown.items()
    }
    scale, unit = prefixed("N", max(values.max() for of in lengths.values() for values in of.values()))
    time = _draw_time_axis(axes, shown)
    for line, (label, run) in zip(_line_styles(shown), shown.items(), strict=True):
        for k, name in enumerate(names):
            if name in lengths[label]:
                axes.plot(time * run.times, scale * lengths[label][name], color=f"C{k}", **line)
    _draw_legend(figure, axes, {name: f"C{k}" for k, name in enumerate(names)}, shown)
    axes.set(ylabel=f"force ({unit})", title="forces of obstacles on the body")


def _draw_time_axis(axes: Any, runs: Runs) -> float:
    """Prepares the abscissa, marks the instants at which the contact mode changes, and tells the scale of time."""
    scale, unit = prefixed("s", max(run.times[-1] for run in runs.values()))
    axes.set_xlabel(f"time ({unit})")
    first = next(iter(runs.values()))
    switches = first.times[np.flatnonzero(np.diff(first.contact)) + 1]
    if len(switches) <= MAX_MARKED_SWITCHES:
        for t in switches:
            axes.axvline(scale * t, color="0.6", linewidth=0.5, zorder=0)
    return scale


def _line_styles(runs: Runs) -> list[dict[str, Any]]:
    """The line of each run: of several the first is broad and pale, so that it can be seen under others."""
    styles = [{"linestyle": DASHES[k % len(DASHES)]} for k in range(len(runs))]
    return styles if len(runs) == 1 else [UNDERLYING_LINE, *styles[:-1]]


def _draw_legend(figure: Any, axes: Any, colours: Mapping[str, str], runs: Runs) -> None:
    """Below the axes: colours are quantities, lines are runs."""
    for words, colour in colours.items():
        axes.plot([], [], color=colour, label=words)
    if len(runs) > 1:
        for line, label in zip(_line_styles(runs), runs, strict=True):
            axes.plot([], [], color="0.5", label=label, **line)
    longest = max(len(line.get_label()) for line in axes.get_lines())
    figure.legend(loc="outside lower center", ncols=3 if longest < LONG_LABEL_LETTERS else 2)
