"""Plots of what touches bodies of runs: pressure, area and normal force against time, and a map of the pressure."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.io.units import prefixed
from fenics_rom.trajectory.trajectory import Trajectory
from fenics_rom.visualization.contact_fields import ContactFields
from fenics_rom.visualization.figure import Panel
from fenics_rom.visualization.plots.run_lines import draw_legend, draw_time_axis, line_styles

AXES = "xyz"
QUANTITIES = {"largest pressure": "Pa", "area of pushed nodes": "m2", "normal force": "N"}


def contact_panels(runs: Mapping[str, Trajectory]) -> dict[str, Panel]:
    """Those of the runs that keep what touches their bodies, where something does."""
    pushed = {
        label: run
        for label, run in runs.items()
        if run.touched is not None and len(run.triangles) and run.touched.pressing.any()
    }
    if not pushed:
        return {}
    return {"pressure": partial(_draw_pressure, runs=pushed), "pressure_map": partial(_draw_map, runs=pushed)}


def _draw_pressure(figure: Any, runs: Mapping[str, Trajectory]) -> None:
    """The largest pressure, the area of all nodes that something pushes, and the sum of normal forces, of each body."""
    all_axes, values = figure.subplots(len(QUANTITIES), 1, sharex=True), [_pressures(run) for run in runs.values()]
    bodies = dict.fromkeys(name for of_run in values for name in of_run)
    for k, (axes, (words, unit)) in enumerate(zip(all_axes, QUANTITIES.items(), strict=True)):
        scale, shown_unit = prefixed(unit, max(of[k].max() for of_run in values for of in of_run.values()))
        time = draw_time_axis(axes, runs)
        for line, run, of_run in zip(line_styles(runs), runs.values(), values, strict=True):
            for number, name in enumerate(bodies):
                if name in of_run:
                    axes.plot(
                        time * run.snapshot_times, scale * of_run[name][k], color=f"C{number}", marker=".", **line
                    )
        axes.set(title=f"{words} ({shown_unit})", ylim=(0, None))
        axes.label_outer()
    if len(runs) > 1 or len(bodies) > 1:
        names = {name: f"C{number}" for number, name in enumerate(bodies)} if len(bodies) > 1 else {}
        draw_legend(figure, all_axes[-1], names, runs)


def _pressures(run: Trajectory) -> dict[str, Array]:
    """Of each soft body, by name, that of each shape, (3, s): Pa, m² and N."""
    fields, touched, found = ContactFields(run), run.touched, dict[str, Array]()
    assert touched is not None
    pressures = np.array([fields.pressure(row) for row in range(len(run.snapshots))])
    for name, nodes in _nodes_of_bodies(run).items():
        of_body = (touched.nodes >= nodes.start) & (touched.nodes < nodes.stop)
        pressing = touched.pressing[:, of_body]
        areas = (pressing > 0) @ fields.areas[touched.nodes[of_body]]
        found[name] = np.stack([pressures[:, nodes].max(axis=1), areas, pressing.sum(axis=1)])
    return found


def _nodes_of_bodies(run: Trajectory) -> dict[str, slice]:
    """Of the soft bodies, by name."""
    if not run.bodies:
        return {"": slice(0, len(run.nodes))}
    return {name: track.nodes for name, track in run.bodies.items() if track.kind == "soft"}


def _draw_map(figure: Any, runs: Mapping[str, Trajectory]) -> None:
    """The pressure of the first run when it is largest, on the body where it is, along the axis that sees it best."""
    axes, (label, run) = figure.subplots(), next(iter(runs.items()))
    fields = ContactFields(run)
    row = int(np.argmax([fields.pressure(row).max() for row in range(len(run.snapshots))]))
    pressure, places = fields.pressure(row), run.nodes + run.snapshots[row]
    name, nodes = next(
        each for each in _nodes_of_bodies(run).items() if each[1].start <= pressure.argmax() < each[1].stop
    )
    first = run.triangles[:, 0]
    triangles = run.triangles[fields.touchable & (first >= nodes.start) & (first < nodes.stop)]
    a, b, c = places[triangles].swapaxes(0, 1)
    normals = np.cross(b - a, c - a)
    pushed = pressure[triangles].mean(axis=1) @ normals
    axis = int(np.abs(pushed).argmax())
    facing = triangles[normals[:, axis] * pushed[axis] > 0]
    across = [k for k in range(3) if k != axis]
    (scale, unit), (length, length_unit) = prefixed("Pa", pressure.max()), prefixed("m", np.ptp(places[nodes], 0).max())
    shown, facing = np.unique(facing, return_inverse=True)
    (x, y), facing = length * places[shown][:, across].T, facing.reshape(-1, 3)
    drawn = axes.tripcolor(x, y, facing, scale * pressure[shown], shading="gouraud", cmap="viridis", vmin=0)
    axes.triplot(x, y, facing, color="white", linewidth=0.2, alpha=0.5)
    figure.colorbar(drawn, ax=axes, label=f"pressure ({unit})")
    time, time_unit = prefixed("s", run.times[-1])
    of = [each for each in (label if len(runs) > 1 else "", name) if each]
    on = f"pressure on {', '.join(of)}" if of else "pressure"
    axes.set(
        aspect="equal",
        xlabel=f"{AXES[across[0]]} ({length_unit})",
        ylabel=f"{AXES[across[1]]} ({length_unit})",
        title=f"{on} at {time * run.snapshot_times[row]:.3g} {time_unit}, along {AXES[axis]}",
    )
    axes.grid(visible=False)
