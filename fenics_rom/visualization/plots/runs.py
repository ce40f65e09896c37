"""Plots of runs, several over one another: energies, outputs, inputs, reactions, moving frames, readings, obstacles."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.io.units import prefixed
from fenics_rom.mechanics.base_path import with_nearest_signs
from fenics_rom.mechanics.reactions import REACTION
from fenics_rom.mechanics.readings import COMPONENTS, READING_WORDS
from fenics_rom.mechanics.touch import TOUCH
from fenics_rom.trajectory.series import FRAME_SERIES, ReadingSeries
from fenics_rom.trajectory.trajectory import Trajectory
from fenics_rom.visualization.figure import Panel
from fenics_rom.visualization.plots.contact import contact_panels
from fenics_rom.visualization.plots.run_lines import draw_legend, draw_time_axis, line_styles
from fenics_rom.visualization.plots.touch import touch_panels

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
NUMERICAL_LABEL = {"numerical": "numerical"}  # of steps without inertia
AXES = "xyz"
ERROR_BANDS = {"bound": 0.15, "estimate": 0.4}  # how opaque


def run_panels(runs: Runs) -> dict[str, Panel]:
    """What there is to draw of runs, by name; runs that lack an output or an obstacle are left out of its panel."""
    outputs = dict.fromkeys(name for run in runs.values() for name, values in run.outputs.items() if values.size)
    panels: dict[str, Panel] = {"energy": partial(_draw_energy, runs=runs)}
    panels |= {f"output_{name}": partial(_draw_output, runs=runs, name=name) for name in outputs}
    if any(run.forces for run in runs.values()):
        panels["forces"] = partial(_draw_forces, runs=runs)
    panels |= contact_panels(runs)
    if any(_with_norm(run) for run in runs.values()):
        panels["error"] = partial(_draw_error, runs=runs)
    inputs = dict.fromkeys(  # but for what is the same in all steps, as gravity
        name for run in runs.values() for name, u in run.inputs.items() if (u.values[1:] != u.values[1]).any()
    )
    panels |= {f"input_{name}": partial(_draw_input, runs=runs, name=name) for name in inputs}
    reactions = dict.fromkeys(name for run in runs.values() for name in run.reactions)
    panels |= {f"reaction_{name}": partial(_draw_reaction, runs=runs, name=name) for name in reactions}
    frames = dict.fromkeys(name for run in runs.values() for name in run.frame_series)
    panels |= {name.replace(" ", "_"): partial(_draw_frame, runs=runs, name=name) for name in frames}
    readings = dict.fromkeys(name for run in runs.values() for name in run.readings)
    panels |= {f"reading_{name}": partial(_draw_reading, runs=runs, name=name) for name in readings}
    return panels | touch_panels(runs)


def _draw_energy(figure: Any, runs: Runs) -> None:
    """All sums of the account against time."""
    axes = figure.subplots()
    accounts = [_account(run) for run in runs.values()]
    scale, unit = prefixed("J", max(np.abs(sums).max() for account in accounts for sums in account.values()))
    labels = LEDGER_LABELS | CONTACT_LEDGER_LABELS | NUMERICAL_LABEL
    colours = {name: f"C{k}" for k, name in enumerate(labels)}
    time = draw_time_axis(axes, runs)
    for line, run, account in zip(line_styles(runs), runs.values(), accounts, strict=True):
        for name, sums in account.items():
            axes.plot(time * run.times, scale * sums, color=colours[name], **line)
    drawn = dict.fromkeys(name for account in accounts for name in account)
    draw_legend(figure, axes, {labels[name]: colours[name] for name in drawn}, runs)
    axes.set(ylabel=f"energy ({unit})", title="energy account")


def _account(run: Trajectory) -> dict[str, Array]:
    """Its sums, in the order of their labels."""
    contact = {name: run.contact_account[name] for name in CONTACT_LEDGER_LABELS if name in run.contact_account}
    numerical = {"numerical": run.numerical} if run.numerical.any() else {}
    return {name: getattr(run, name) for name in LEDGER_LABELS} | contact | numerical


def _draw_output(figure: Any, runs: Runs, name: str) -> None:
    """The three components of an output, and bands of what a run states of its error."""
    shown = {label: run for label, run in runs.items() if name in run.outputs}
    values = [run.outputs[name] for run in shown.values()]
    bands = [
        {kind: of.outputs[name] for kind, of in run.errors.items() if name in of.outputs} for run in shown.values()
    ]
    _draw_values(figure, shown, values, "m", AXES, "displacement", f"output {name}", bands)


def _draw_error(figure: Any, runs: Runs) -> None:
    """What runs state of their error in the energy norm, as a share of the largest that each had."""
    axes = figure.subplots()
    shown = {label: run for label, run in runs.items() if _with_norm(run)}
    time, colours = draw_time_axis(axes, shown), {kind: f"C{k}" for k, kind in enumerate(ERROR_BANDS)}
    for line, run in zip(line_styles(shown), shown.values(), strict=True):
        scale = np.sqrt(2 * run.energy.max()) or 1.0
        for kind, norm in _with_norm(run).items():
            axes.semilogy(time * run.times, np.where(norm > 0, norm / scale, np.nan), color=colours[kind], **line)
    draw_legend(figure, axes, colours, shown)
    axes.set(ylabel="error, of largest energy norm (1)", title="error that the run states")


def _with_norm(run: Trajectory) -> dict[str, Array]:
    """Errors in the energy norm, as far as they are known."""
    return {kind: stated.norm for kind, stated in run.errors.items() if stated.norm is not None}


def _draw_input(figure: Any, runs: Runs, name: str) -> None:
    """What acted in the steps: three columns as components of a force, of others each as one of many."""
    shown = {label: run for label, run in runs.items() if name in run.inputs}
    series = [run.inputs[name] for run in shown.values()]
    is_force = all(one.values.shape[1] == len(AXES) for one in series)
    values = [one.values[:, None] if is_force else one.values[:, :, None] for one in series]
    _draw_values(figure, shown, values, series[0].unit, AXES if is_force else "", "input", f"input {name}")


def _draw_reaction(figure: Any, runs: Runs, name: str) -> None:
    """The force of an actuator whose stroke is given."""
    shown = {label: run for label, run in runs.items() if name in run.reactions}
    series = [run.reaction_series[name] for run in shown.values()]
    words = "tension" if series[0].unit == "N" else "pressure"
    _draw_values(
        figure, shown, [one.values[:, :, None] for one in series], series[0].unit, "", words, f"reaction {name}"
    )


def _draw_frame(figure: Any, runs: Runs, name: str) -> None:
    """Where a moving frame is, what its base exerts, and the momenta."""
    shown = {label: run for label, run in runs.items() if name in run.frame_series}
    series = [run.frame_series[name] for run in shown.values()]
    components = next(parts[name][1] for parts in FRAME_SERIES.values() if name in parts)
    values = [with_nearest_signs(one.values) if name == "rotation" else one.values for one in series]
    title = f"{name} in world axes"
    _draw_values(figure, shown, [one[:, None] for one in values], series[0].unit, components, name, title)


def _draw_reading(figure: Any, runs: Runs, name: str) -> None:
    """A reading; of strain the largest principal one at each place; of a marker, stress and forces all.

    With bands of what a run states of its error.
    """
    shown = {label: run for label, run in runs.items() if name in run.readings}
    readings = [run.readings[name] for run in shown.values()]
    components: Sequence[str] = {"marker": "xyz", REACTION: "xyz", "stress": COMPONENTS, TOUCH: "xyz"}.get(
        readings[0].quantity, ""
    )

    def drawn(reading: ReadingSeries) -> Array:
        if reading.quantity == TOUCH:
            return reading.by_point
        values, count = reading.values, len(reading.values)
        if components:
            return values.reshape(count, -1, values.shape[-1])[:, :, : len(components)]
        return reading.sizes.reshape(count, -1, 1)

    values = [drawn(reading) for reading in readings]
    bands = [
        {kind: drawn(of.readings[name]) for kind, of in run.errors.items() if name in of.readings}
        for run in shown.values()
    ]
    words = READING_WORDS[readings[0].quantity] if components else readings[0].words
    words = "force" if readings[0].quantity == TOUCH else words
    _draw_values(figure, shown, values, readings[0].unit, components, words, f"reading {name}", bands)


def _draw_values(
    figure: Any,
    runs: Runs,
    values: list[Array],
    unit: str,
    components: Sequence[str],
    words: str,
    title: str,
    bands: Sequence[Mapping[str, Array]] = (),
) -> None:
    """Values (S, points, components) of each run against time; of several points their mean, and their range.

    `bands`: of each run, by ERROR_BANDS, how far off they may be, like the values.
    """
    axes = figure.subplots()
    scale, shown_unit = prefixed(unit, max(np.abs(of_run).max() for of_run in values))
    time = draw_time_axis(axes, runs)
    for line, run, of_run in zip(line_styles(runs), runs.values(), values, strict=True):
        for k, component in enumerate(scale * of_run.transpose(2, 0, 1)):
            axes.plot(time * run.times, component.mean(axis=1), color=f"C{k}", **line)
            if component.shape[1] > 1:
                low, high = component.min(axis=1), component.max(axis=1)
                axes.fill_between(time * run.times, low, high, color=f"C{k}", alpha=0.2, linewidth=0)
    low, high = axes.get_ylim()
    for run, of_run, of_bands in zip(runs.values(), values, bands or [{}] * len(values), strict=True):
        for kind, off in of_bands.items():
            for k, component in enumerate(scale * of_run.mean(axis=1).T):
                band = scale * np.abs(off).mean(axis=1)[:, k]
                edges = component - band, component + band
                axes.fill_between(time * run.times, *edges, color=f"C{k}", alpha=ERROR_BANDS[kind], linewidth=0)
    axes.set_ylim(*np.clip(axes.get_ylim(), low - (high - low), high + (high - low)))
    for kind in dict.fromkeys(kind for of_bands in bands for kind in of_bands):
        axes.fill_between([], [], color="0.5", alpha=ERROR_BANDS[kind], linewidth=0, label=f"± {kind}")
    points = max(of_run.shape[1] for of_run in values)
    of = f" (mean and range of {points} points)" if points > 1 else ""
    if components or len(runs) > 1:
        draw_legend(figure, axes, {axis: f"C{k}" for k, axis in enumerate(components)}, runs)
    axes.set(ylabel=f"{words} ({shown_unit})" if shown_unit else words, title=title + of)


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
    time = draw_time_axis(axes, shown)
    for line, (label, run) in zip(line_styles(shown), shown.items(), strict=True):
        for k, name in enumerate(names):
            if name in lengths[label]:
                axes.plot(time * run.times, scale * lengths[label][name], color=f"C{k}", **line)
    draw_legend(figure, axes, {name: f"C{k}" for k, name in enumerate(names)}, shown)
    axes.set(
        ylabel=f"force ({unit})",
        title="forces between bodies"
        if any(run.bodies for run in runs.values())
        else "forces of obstacles on the body",
    )
