"""A ball pokes a soft cylinder at ten places: contact modes that follow an obstacle, and the force it feels.

    python demos/poke/poke.py                  # six minutes
    python demos/poke/poke.py --quick          # two pokes at one order

The paper's silicone cylinder, 0.6 m long and 1.5 cm thick, is held at both ends. Each of its ten contact modes has a
reduced model of its own; which one is active follows from the gaps, as the ball goes from place to place. The script

1. writes the motion of the ball, ball.csv, that the scene names;
2. runs the scene at full order, also at smaller steps and with the mesh turned about the axis of the cylinder, and at
   several reduced orders, also of balanced truncation, with and without residual compliance, and tables errors and
   rates, of the whole run and by poke;
3. tables pokes that each begin at rest, at three steps, and what a reduced step spends its time on;
4. draws the cylinder under each poke, to scale, and the force on it.

Everything else is written to demos/poke/out/. The checks at the end fail if a claim does not hold.
"""

import argparse
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from cases import compare_cases
from matplotlib.patches import Circle
from touching import (
    OUTLINE,
    Comparison,
    check,
    compare_orders,
    draw_from_side,
    errors,
    laws,
    table_of_parts,
    turned,
    within_linear,
)

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.io.markdown import markdown
from fenics_rom.mechanics.signals import Signal
from fenics_rom.scene.scene import Scene

HERE = Path(__file__).parent

POKES = 10
PLACES = 0.075 + 0.05 * np.arange(POKES)  # m along the cylinder
TOP, RADIUS, HIGH = 0.0075, 0.012, 0.0325  # of the cylinder; of the ball, and of its centre between pokes, m
EACH, RAMP, HOLD = 1.0, 0.32, 0.16  # s from one poke to the next; of going down, and of going up again; between them
MIDDLE = RAMP + HOLD / 2  # s into a poke
DEPTHS = 0.003 + 0.007 * np.sin(np.pi * PLACES / 0.6)  # m
SAMPLES = 20  # of the motion in a ramp
ORDERS = (20, 30, 60)  # and the scene's own is one of them
ANOTHER_MESH = {"full order, mesh turned by 1°": partial(turned, axis=0)}
STEPS = (4e-3, 2e-3, 1e-3)  # s, of pokes that begin at rest
MEASURES = ("shape", "force", "impulse")
STIFF = "without residual compliance"
QUICK = 2  # pokes, at the scene's own order

Array = np.ndarray


def main() -> None:
    """Runs the demo."""
    parser = argparse.ArgumentParser(description="A ball pokes a soft cylinder.")
    parser.add_argument("--quick", action="store_true", help="two pokes at one order")
    quick = parser.parse_args().quick
    out = HERE / "out" / "quick" if quick else HERE / "out"
    out.mkdir(parents=True, exist_ok=True)

    write_motion(HERE / "ball.csv")
    scene = fr.read_scene(HERE / "poke.toml")
    own = scene.reduction.order
    assert scene.run is not None
    assert own in ORDERS
    pokes, orders = (QUICK, (own,)) if quick else (POKES, ORDERS)
    run = replace(scene.run, duration=pokes * EACH)
    scene = replace(scene, run=replace(run, snapshots=round(run.duration / run.dt)))  # the shape of every step
    system = fr.assemble(scene)
    points = np.unique(np.concatenate(list(system.contact_points.values())))
    print(f"Cylinder: {system.size} unknowns, {len(system.contacts)} contact modes, {len(points)} contact points\n")

    rom, balanced = fr.reduce(system, order=orders[-1]), fr.reduce(system, method="balanced", order=orders[-1])
    roms, others = ({order: fr.truncate(whole, order) for order in orders} for whole in (rom, balanced))
    another = None if quick else ANOTHER_MESH
    runs = compare_orders(system, roms, sensitivity=another, others={"by balanced truncation": others})
    full, best = runs.full, runs.reduced[own]
    seconds = sum(stage.seconds for stage in rom.stages)

    runs.table(out / "accuracy.md")
    table_by_poke(runs, pokes, out / "pokes.md")
    ratios = table_from_rest(
        scene, roms, others[max(orders)], STEPS[: 1 if quick else None], pokes, out / "from_rest.md"
    )
    table_of_parts(best, out / "profile.md")
    picture(best, system.contact_points, pokes, out / "poke.png")
    poked, active = contact_modes(best)
    shape, force, impulse = by_poke(best, full, pokes)
    stiff_shape, _, _ = by_poke(runs.without[own], full, pokes)
    claims = {
        "under the first poke, from rest, by 0.1 % at most": shape[0] < 1e-3,
        "and by an eighth of what it is without residual compliance": shape[0] < stiff_shape[0] / 8,
        "and the force by 1.5 % at most, its impulse by 0.5 %": force[0] < 0.015 and impulse[0] < 5e-3,
        "all places are poked": set(poked) == set(range(pokes)),
        "whenever the ball pushes, the contact mode is the one that it pokes": bool((poked == active).all()),
        "nothing turned or strained beyond what a linear model can follow": within_linear(best) and within_linear(full),
        **laws(full, scene, points),
        **laws(best, scene, points),
    }
    if runs.step is not None:
        more = f"at order {own} the shape is off by less than the step itself makes"
        claims[more] = errors(best, full).shape < runs.step.shape
        half = f"of pokes from rest, {{}} is off by at most 1.2 times what order {orders[-1]} {STIFF} is"
        claims |= {half.format(what): ratio < 1.2 for what, ratio in ratios.items()}
    print(f"\nReduced in {seconds:.0f} s\n")
    check(claims)


def write_motion(file: Path) -> None:
    """Displacement of the ball: down and up at each place, along at the top, each smoothly."""
    smooth = (1 - np.cos(np.pi * np.linspace(0, 1, SAMPLES + 1))) / 2
    rows = [(0.0, PLACES[0], 0.0, 0.0)]
    for k, (place, depth) in enumerate(zip(PLACES, DEPTHS, strict=True)):
        start, down = k * EACH, TOP - depth + RADIUS - HIGH
        for ramp, begins in ((smooth, start), (smooth[::-1], start + RAMP + HOLD)):
            rows += [(begins + RAMP * s / SAMPLES, place, 0.0, down * ramp[s]) for s in range(1, SAMPLES + 1)]
        if k + 1 < POKES:
            begins, lasts, way = start + 2 * RAMP + HOLD, EACH - 2 * RAMP - HOLD, PLACES[k + 1] - place
            rows += [(begins + lasts * s / SAMPLES, place + way * smooth[s], 0.0, 0.0) for s in range(1, SAMPLES + 1)]
    lines = [",".join(f"{value:.6g}" for value in row) for row in rows]
    file.write_text("\n".join(["time,x,y,z", *lines]) + "\n")


def by_poke(run: fr.Trajectory, full: fr.Trajectory, pokes: int) -> tuple[Array, Array, Array]:
    """Relative errors of the shape, in mass, of the force and of its impulse, 2-norms over each poke, (pokes,) each."""

    def mean_force(of: fr.Trajectory) -> Array:
        """Over the steps of full order, (pokes, steps, 3)."""
        return of.forces["ball"][1:].reshape(full.steps, -1, 3).mean(axis=1).reshape(pokes, -1, 3)

    def weighted(of: fr.Trajectory) -> Array:
        shapes = np.sqrt(full.node_mass)[:, None] * of.snapshots
        return shapes.reshape(pokes, -1)

    def norm(values: Array) -> Array:
        return np.linalg.norm(values.reshape(pokes, -1), axis=1)

    def impulse(of: fr.Trajectory) -> Array:
        return mean_force(of).mean(axis=1)

    shape, force, whole = (norm(of(run) - of(full)) / norm(of(full)) for of in (weighted, mean_force, impulse))
    return shape, force, whole


def table_by_poke(runs: Comparison, pokes: int, file: Path) -> None:
    """Errors of the first poke, which is from rest, and of a usual one: stick and slip have a history in later ones."""
    rows = []
    for name, order, run in runs.rows:
        cells = (f"{of(each):.1e}" for of in (lambda one: one[0], np.median) for each in by_poke(run, runs.full, pokes))
        rows.append((name, order, *cells))
    heading = (f"{whose} {what}" for whose in ("first poke:", f"median of {pokes} pokes:") for what in MEASURES)
    table = markdown(("model", "order", *heading), rows)
    file.write_text(table)
    print(f"By poke, 2-norms over each\n\n{table}")


def table_from_rest(
    scene: Scene, roms: Mapping[int, fr.Rom], stiff: fr.Rom, steps: Sequence[float], pokes: int, file: Path
) -> dict[str, float]:
    """Errors of pokes that each begin at rest, at several steps; those of the scene's own model by those of the last.

    That is the largest without residual compliance. A poke at rest has no history, and many tell more than one.
    """
    assert scene.run is not None
    largest = max(roms)
    models = {("reduced", order): (rom, True) for order, rom in roms.items()}
    models |= {(STIFF, largest): (stiff, False)}
    rows, parts = [], []
    for dt in steps:
        run = replace(scene.run, dt=dt, duration=EACH, snapshots=round(EACH / dt))
        alone = (replace(from_rest(scene, k), run=run) for k in range(pokes))
        parts.append(compare_cases(alone, models, lambda one, full: tuple(error[0] for error in by_poke(one, full, 1))))
        rows += [(f"{1e3 * dt:g} ms", *cells) for cells in parts[-1].medians]
    table = markdown(("step", "model", "order", *MEASURES), rows)
    file.write_text(table)
    print(f"Each of {pokes} pokes from rest, medians\n\n{table}")
    own, whole = scene.reduction.order, sum(parts[1:], parts[0])
    return whole.ratios(("reduced", own), (STIFF, largest), MEASURES)


def from_rest(scene: Scene, k: int) -> Scene:
    """The scene with one of its pokes alone."""
    contact = scene.effects.contact
    ball = contact.obstacles["ball"]
    times, margin = ball.table.times - k * EACH, RAMP / SAMPLES / 4
    during = (times > -margin) & (times < 2 * RAMP + HOLD + margin)
    alone = replace(ball, table=Signal(ball.table.values[during], times[during]))
    return replace(scene, effects=replace(scene.effects, contact=replace(contact, obstacles={"ball": alone})))


def contact_modes(run: fr.Trajectory) -> tuple[Array, Array]:
    """Which place the ball is at and which contact mode is active, of each step in which the ball pushes."""
    pushes = np.flatnonzero(run.forces["ball"].any(axis=1))
    poked = ((run.times[pushes] - run.settings["dt"] / 2) // EACH).astype(int)
    names = np.array([int(name.removeprefix("at_")) for name in run.contacts])
    return poked, names[run.contact[pushes]]


def picture(run: fr.Trajectory, patches: Mapping[str, Array], pokes: int, file: Path) -> None:
    """The cylinder under each poke, and the force beside it; time goes down."""
    pitch, left, right = 0.045, -0.012, 0.612  # m, of the shapes
    inch = 13.0  # per m
    height, width = (pokes + 0.3) * pitch * inch, (right - left) * inch
    figure = plt.figure(figsize=(width + 3.6, height + 0.95))
    total_width, total_height = figure.get_size_inches()
    bottom = 0.5 / total_height
    shapes = figure.add_axes((0.7 / total_width, bottom, width / total_width, height / total_height))
    forces = figure.add_axes(((width + 0.95) / total_width, bottom, 2.4 / total_width, height / total_height))
    shapes.set(xlim=(left, right), ylim=(-(pokes - 0.32) * pitch, 0.62 * pitch))
    forces.set(ylim=(MIDDLE + (pokes - 0.32) * EACH, MIDDLE - 0.62 * EACH), xlabel="force of the ball (N)")

    colours = [mpl.colormaps["turbo"](0.06 + 0.88 * k / (POKES - 1)) for k in range(POKES)]
    size = np.linalg.norm(run.forces["ball"], axis=1)
    for k in range(pokes):
        colour, instant, lift = mpl.colors.to_hex(colours[k]), k * EACH + MIDDLE, -k * pitch
        step = int(np.abs(run.snapshot_times - instant).argmin())
        shapes.plot([0, 0.6], [lift, lift], color="0.8", linewidth=0.8, linestyle=(0, (6, 4)), zorder=0)
        moved = run.nodes + run.snapshots[step]
        draw_from_side(shapes, moved, run.triangles, coloured={colour: patches[f"at_{k}"]}, lift=lift)
        centre = PLACES[k], TOP - DEPTHS[k] + RADIUS + lift
        shapes.add_patch(Circle(centre, RADIUS, facecolor=colour, edgecolor=OUTLINE, linewidth=0.8, alpha=0.9))
        for end in (left, 0.6):
            shapes.add_patch(plt.Rectangle((end, lift - 0.0125), 0.012, 0.025, color="0.45", linewidth=0))
        shapes.text(left - 0.006, lift, f"{instant:.1f} s", ha="right", va="center", fontsize=9)
        span = slice(round(k * EACH / run.settings["dt"]), round((k + 1) * EACH / run.settings["dt"]) + 1)
        forces.fill_betweenx(run.times[span], size[span], color=colour, alpha=0.35, linewidth=0)
        forces.plot(size[span], run.times[span], color=colour, linewidth=1.2)
    shapes.set_axis_off()
    forces.set_xlim(left=0)
    forces.set_yticks(MIDDLE + EACH * np.arange(pokes), [])
    for side in ("top", "right"):
        forces.spines[side].set_visible(False)
    title = f"a soft cylinder, 0.6 m long, poked at {pokes} places; to scale, order {run.settings['order']}"
    figure.text(0.7 / total_width, 1 - 0.27 / total_height, title, fontsize=11)
    figure.savefig(file, dpi=80)
    plt.close(figure)


if __name__ == "__main__":
    warnings.simplefilter("ignore", FenicsRomWarning)  # records hold them
    main()
