"""A soft finger closes on three objects and lets go: tendons, air, contact and friction in one reduced model.

    python demos/finger/finger.py              # under a minute
    python demos/finger/finger.py --quick      # it closes only, at one order

A silicone finger, 10 cm long, is fixed at its root. A tendon along its lower side closes it on a ball, a rod and a
block; air in a closed chamber presses it on; the ball is taken away; a tendon along its upper side opens it. The
contact mode follows the objects. The script

1. runs the scene at full order, also at smaller steps and on a mesh whose nodes are a little elsewhere, and at several
   reduced orders, also of balanced truncation, with and without residual compliance, and tables errors and rates;
2. tables what a reduced step spends its time on;
3. draws the finger at four instants, to scale, and what it feels.

Everything is written to demos/finger/out/. The checks at the end fail if a claim does not hold.
"""

import argparse
import sys
import warnings
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.patches import Circle, Polygon, Rectangle

sys.path.append(str(Path(__file__).parents[1] / "poke"))

from touching import (
    DEGREE,
    OUTLINE,
    Errors,
    check,
    compare_orders,
    draw_from_side,
    errors,
    laws,
    slid,
    table_of_parts,
    true_to_scale,
    within_linear,
)

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.mechanics.obstacles import Box, Capsule
from fenics_rom.scene.scene import Scene

HERE = Path(__file__).parent

ORDERS = (10, 20, 40)  # and the scene's own is one of them
BALANCED = (20, 40, 100)  # of balanced truncation, with and without residual compliance
WAY = 0.01 * DEGREE  # m, as far as the surface of a body as thick moves when it is turned
ANOTHER_MESH = {"full order, nodes 0.17 mm along": partial(slid, axis=0, ends=(0.01, 0.09), way=WAY)}  # of the chamber
CLOSED = 0.8  # s, until which it closes
INSTANTS = {0.33: "the flexor pulls", 0.87: "and air presses", 1.14: "the ball is gone", 2.34: "the extensor opens it"}
COLOURS = {"ball": "#c2410c", "rod": "#15803d", "block": "#1d4ed8"}
MODES = {"proximal": "#f0b48c", "middle": "#9fd3a9", "distal": "#a9c1f2"}  # of the contact mode next to each
AIR, CABLES, SLACK = "#38bdf8", {"flexor": "#b91c1c", "extensor": "#7c3aed"}, "#8a8478"
CHAMBER = [0.05, -0.006, 0.0025]  # m


def main() -> None:
    """Runs the demo."""
    parser = argparse.ArgumentParser(description="A soft finger closes on three objects.")
    parser.add_argument("--quick", action="store_true", help="it closes only, at one order")
    quick = parser.parse_args().quick
    out = HERE / "out" / "quick" if quick else HERE / "out"
    out.mkdir(parents=True, exist_ok=True)

    scene = fr.read_scene(HERE / "finger.toml")
    assert scene.run is not None
    own, run = scene.reduction.order, scene.run
    assert own in ORDERS
    orders = ORDERS
    if quick:
        closing = tuple(replace(load, stop=CLOSED) for load in run.loads if load.actuator != "extensor")
        orders, run = (own,), replace(run, duration=CLOSED, loads=closing)
    scene = replace(scene, run=replace(run, snapshots=round(run.duration / run.dt)))  # the shape of every step
    system = fr.assemble(scene)
    points = np.unique(np.concatenate(list(system.contact_points.values())))
    print(f"Finger: {system.size} unknowns, {len(system.contacts)} contact modes, {len(points)} contact points\n")

    of_balanced = orders if quick else BALANCED
    rom, balanced = fr.reduce(system, order=orders[-1]), fr.reduce(system, method="balanced", order=of_balanced[-1])
    roms, others = (
        {order: fr.truncate(whole, order) for order in several}
        for whole, several in ((rom, orders), (balanced, of_balanced))
    )
    another = None if quick else ANOTHER_MESH
    runs = compare_orders(system, roms, sensitivity=another, others={"by balanced truncation": others})
    full, best = runs.full, runs.reduced[own]
    runs.table(out / "accuracy.md")
    table_of_parts(best, out / "profile.md")
    if not quick:
        picture(best, scene, out / "finger.png")
    forces = [np.linalg.norm(each, axis=1) for each in best.forces.values()]
    pressed = np.abs(system.actuators["air"]).sum()
    resultant = [np.abs(system.actuators["air"][axis::3].sum()) / pressed for axis in range(3)]
    close = errors(best, full)
    claims = {
        f"at order {own} no node is ever off by 1 % of the largest displacement": close.node < 0.01,
        f"at order {own} every force is right to 2 %": max(close.forces.values()) < 0.02,
        "there is an instant at which all three objects are touched": bool(np.min(forces, axis=0).max() > 0),
        "pressure on the closed chamber has no resultant": max(resultant) < 1e-12,
        "nothing turned or strained beyond what a linear model can follow": within_linear(best) and within_linear(full),
        **laws(full, scene, points),
        **laws(best, scene, points),
    }
    if runs.step is not None:
        few, many = ORDERS[0], BALANCED[-1]
        least, before = errors(runs.reduced[few], full), errors(runs.without[many], full)
        claims |= {
            "the contact mode follows the objects": len(np.unique(best.contact)) > 1,
            f"at order {few} shape and forces are off by a fifth of what the step itself makes": is_within(
                least, runs.step, 0.2
            ),
            f"and by a quarter of what order {many} of balanced truncation is without residual compliance": is_within(
                least, before, 0.25
            ),
        }
    print(f"\nReduced in {sum(stage.seconds for stage in rom.stages):.0f} s\n")
    check(claims)


def is_within(error: Errors, other: Errors, share: float) -> bool:
    """Whether shape and all forces are off by less than a share of what something else is."""
    return error.shape < share * other.shape and all(
        error.forces[name] < share * other.forces[name] for name in other.forces
    )


def picture(run: fr.Trajectory, scene: Scene, file: Path) -> None:
    """The finger at a few instants, what it feels and what drives it."""
    figure = plt.figure(figsize=(10.5, 7.2), layout="constrained")
    grid = figure.add_gridspec(4, 2, height_ratios=(2.3, 2.3, 1.5, 1.0))
    for k, (instant, what) in enumerate(INSTANTS.items()):
        axes = figure.add_subplot(grid[k // 2, k % 2])
        draw_finger(axes, run, scene, int(np.abs(run.snapshot_times - instant).argmin()))
        axes.set_title(f"{instant:.2f} s  {what}", fontsize=10, loc="left")
    felt, driven = figure.add_subplot(grid[2, :]), figure.add_subplot(grid[3, :])

    for name, force in run.forces.items():
        felt.plot(run.times, np.linalg.norm(force, axis=1), color=COLOURS[name], label=name, linewidth=1.4)
    felt.set(ylabel="force (N)", xlim=(0, run.times[-1]), ylim=(-0.035, None))
    felt.set_xticklabels([])
    changes = np.flatnonzero(np.diff(run.contact)) + 1
    for first, last in zip([0, *changes], [*changes, run.steps], strict=True):
        name = run.contacts[run.contact[first]]
        start, lasts = run.times[first], run.times[last] - run.times[first]
        felt.add_patch(Rectangle((start, -0.035), lasts, 0.022, color=MODES[name], linewidth=0))
        if lasts > 0.15:
            felt.text(start + 0.01, -0.024, f"contact mode {name}", fontsize=7.5, va="center")
    felt.legend(frameon=False, ncols=3, fontsize=9, loc="upper right")

    for name, colour in {**CABLES, "air": AIR}.items():
        times, values = scene.tables[f"{name}.csv"].T
        unit, size = ("10 kPa", 1e4) if name == "air" else ("N", 1.0)
        driven.plot(times, values / size, color=colour, label=f"{name} ({unit})", linewidth=1.4)
    driven.set(xlabel="time (s)", xlim=(0, run.times[-1]))
    driven.legend(frameon=False, fontsize=8.5, loc="upper left", bbox_to_anchor=(0.0, 1.15))
    for axes in (felt, driven):
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    figure.savefig(file, dpi=100)
    plt.close(figure)


def draw_finger(axes: Any, run: fr.Trajectory, scene: Scene, row: int) -> None:
    """The finger from its side, with its objects, its tendons and its chamber, in a row of the kept shapes."""
    time, nodes = run.snapshot_times[row], run.nodes + run.snapshots[row]
    draw_objects(axes, scene, time)
    draw_from_side(axes, nodes, run.triangles)

    drive = {name: np.interp(time, *scene.tables[f"{name}.csv"].T) for name in ("flexor", "extensor", "air")}
    x, y, z = np.abs(run.nodes - CHAMBER).T  # from the middle of the chamber's wall at the front
    wall = np.flatnonzero((x < 0.0401) & (y < 1e-4) & (z < 0.0036))
    seen = nodes[run.triangles[np.isin(run.triangles, wall).all(axis=1)]][:, :, [0, 2]]
    faces = (*mpl.colors.to_rgb(AIR), 0.12 + 0.4 * drive["air"] / 1e4)
    axes.add_collection(PolyCollection(seen, facecolors=[faces], edgecolors="none", zorder=3))
    for name in ("flexor", "extensor"):
        cable = np.array(scene.outputs[name].points) + run.outputs[name][row + 1]
        pulled = drive[name] > 0
        colour = CABLES[name] if pulled else SLACK
        axes.plot(cable[:, 0], cable[:, 2], "o-", color=colour, linewidth=1 + pulled, markersize=2.5, zorder=4)
    axes.add_patch(Rectangle((-0.008, -0.015), 0.008, 0.03, color="0.45", linewidth=0))
    true_to_scale(axes, (-0.009, 0.113), (-0.0335, 0.0195))


def draw_objects(axes: Any, scene: Scene, time: float) -> None:
    """The objects from the side, where they are at a time, s."""
    style: dict[str, Any] = {"edgecolor": OUTLINE, "linewidth": 0.8}
    for name, moving in scene.environment.obstacles.items():
        obstacle: Any = moving.shape
        middle = obstacle.start if isinstance(obstacle, Capsule) else obstacle.center
        centre = (np.array(middle) + moving.displacement(time))[[0, 2]]
        if not isinstance(obstacle, Box):
            axes.add_patch(Circle((centre[0], centre[1]), obstacle.radius, facecolor=COLOURS[name], **style))
        else:
            x, z = np.array(obstacle.size)[[0, 2]] / 2
            c, s = np.cos(obstacle.rotation[1]), np.sin(obstacle.rotation[1])
            corners = np.array([(-x, -z), (x, -z), (x, z), (-x, z)]) @ [[c, -s], [s, c]] + centre
            axes.add_patch(Polygon(corners, facecolor=COLOURS[name], **style))


if __name__ == "__main__":
    warnings.simplefilter("ignore", FenicsRomWarning)  # records hold them
    main()
