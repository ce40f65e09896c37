"""The paper's sections IV-B and IV-C: a silicone cylinder pulled at one place, then at another; how fast, how exact.

    python demos/cylinder/cylinder.py           # some minutes
    python demos/cylinder/cylinder.py --quick   # a coarse mesh and short loops, to see that it works

A cylinder, 0.6 m long and 1.5 cm thick, is held at both ends. A thread pulls it down at one place, lets go at 11 s, and
pulls it sideways at another. The script

1. tables the error of reduced models against their order, of a push and its release at one place;
2. runs the 20 s at full order and reduced, and tables the same when the contact moves;
3. prints the paper's Tables II and III beside ours. The data of the paper's experiment are not public, so that ours is
   the difference between reduced and full order at four markers;
4. draws the markers against time and the bent cylinder, as the paper's Figs. 4 and 5.

Everything but the tables of forces is written to demos/cylinder/out/, with --quick to out/quick/. The checks at the end
fail if a claim does not hold; rates are not judged with --quick.
"""

import argparse
import os
import sys
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from trajectories import (
    Instants,
    Trajectory,
    at_full_order,
    full_steps,
    gaps,
    instants,
    marker_errors,
    on_nodes,
    rates,
    reduced,
    reduced_rollout,
    reduced_steps,
    relative,
    with_run,
    write_mesh,
)

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.io.markdown import markdown
from fenics_rom.mechanics.environment import AppliedLoad
from fenics_rom.mechanics.signals import Signal
from fenics_rom.reduction.common_basis import pad_rows
from fenics_rom.reduction.methods.balanced import balanced
from fenics_rom.reduction.problem import RankedBasis, ReductionProblem
from fenics_rom.rom.rom import Rom
from fenics_rom.scene.scene import Scene
from fenics_rom.visualization.plots.body import draw_body

HERE = Path(__file__).parent
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

# The paper's Tables II and III.
PAPER_NODES, PAPER_STATES = 3842, 11526
PAPER_ORDERS = {"first": 164, "second": 181}
PAPER_FULL_RATE, PAPER_RATE = 5.2, 420.0  # steps per second
EXPERIMENT_AGAINST_FULL = (0.34, 1.08, 1.34, 0.56)  # cm
EXPERIMENT_AGAINST_REDUCED = (0.38, 1.11, 1.38, 0.58)  # cm

# Relative errors of push and release as measured earlier on a mesh of 10,773 unknowns: by order, of each of MODELS.
MODELS = ("balanced, energy-orthogonal", "the paper's selection of eigenvectors", "lowest eigenvectors")
EARLIER = {
    10: (9.2e-4, 1.6e-3, 1.6e-3),
    20: (2.0e-5, 4.5e-4, 4.6e-4),
    40: (1.3e-8, 6.3e-5, 1.1e-4),
    80: (2.4e-9, 1.2e-5, 2.2e-5),
}
ORDERS = tuple(EARLIER)
ORDER = 40  # ours, in Tables II and III
SHARE = 1 - 1.2e-10  # of the trace: selections a little larger than the paper's

PUSHES = {"first": (0.0, 0.0, -0.02), "second": (0.0, 0.02, 0.0)}  # N, of push and release
PULL, RAMP, SWING, PERIOD = 0.3, 3.0, 0.25, 4.0  # N; s; share of the pull, and s, of a slow swing
BEGINS, MOVES, ENDS = 0.0, 11.0, 18.0  # s
SHOWN = {"first": 8.0, "second": 15.0}  # s, of the pictures of shapes
QUICK_FACTOR, QUICK_STEP = 2.6, 4e-3

# Models of the run in which the contact moves.
OURS = f"balanced, order {ORDER}"
HOLDING = f"{OURS}, after the other contact's shapes at rest"
THEIRS = "the paper's selection, of its size"

Array = np.ndarray
Errors = Mapping[int, Mapping[str, tuple[float, ...]]]  # by order and contact mode, of each model


def main() -> None:
    """Runs the demo."""
    parser = argparse.ArgumentParser(description="The paper's cylinder.")
    parser.add_argument("--quick", action="store_true", help="a coarse mesh and short loops; rates are not judged")
    quick = parser.parse_args().quick
    if not ONE_THREAD.items() <= os.environ.items():  # read when NumPy is loaded, so it takes another start
        os.execve(sys.executable, [sys.executable, *sys.argv], os.environ | ONE_THREAD)
    out = HERE / "out" / "quick" if quick else HERE / "out"
    out.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore", FenicsRomWarning)  # these tetrahedra lock, which is no matter here

    write_pulls()
    scene = fr.read_scene(HERE / "cylinder.toml")
    if quick:
        write_mesh(out / "cylinder.msh", QUICK_FACTOR)
        scene = with_run(replace(scene, mesh_file=out / "cylinder.msh"), dt=QUICK_STEP)
    system = fr.assemble(scene)
    nodes = len(system.body.nodes)
    print(f"Cylinder: {nodes:,} nodes, {system.size:,} unknowns, contact modes {', '.join(system.contacts)}\n")

    orders = ORDERS
    models = {
        MODELS[0]: fr.reduce(system, order=orders[-1]),
        MODELS[1]: fr.reduce(system, order=orders[-1], method="eigenvector-selection", share=SHARE),
        MODELS[2]: fr.reduce(system, order=orders[-1], method="modal"),
    }
    errors = push_and_release(system, scene, models, orders, out)

    ours, theirs = fr.truncate(models[MODELS[0]], ORDER), of_the_papers_size(models[MODELS[1]])
    held = fr.reduce(system, order=ORDER + 3, method=holding_what_was)
    kept = instants(scene)
    full = at_full_order(system, scene, kept)
    compared = {OURS: ours, HOLDING: held, THEIRS: theirs}
    runs = {name: reduced(rom, scene, kept) for name, rom in compared.items()}
    by_order = {f"balanced, order {order}": fr.truncate(models[MODELS[0]], order) for order in (10, 20, ORDER, 60, 80)}
    moved = when_the_contact_moves(system, scene, by_order | compared, full, kept, out)

    speedups = table_2(system, scene, theirs, ours, quick, out)
    table_3(runs, full, out)
    picture_of_markers(full, runs[OURS], scene, out / "markers.png")
    picture_of_shapes(system, scene, full, runs[OURS], kept, out / "shapes.png")
    check(nodes, errors, moved, runs, full, speedups, quick)


def write_pulls() -> None:
    """Forces of the thread: up smoothly, then a slow swing; let go at once."""
    for name, begins, ends, direction in (("first", BEGINS, MOVES, (0, 0, -1)), ("second", MOVES, ENDS, (0, 1, 0))):
        t = np.round(np.linspace(0, ends - begins, round(10 * (ends - begins)) + 1), 6)
        ramp, begun = ((1 - np.cos(np.pi * np.clip(part, 0, 1))) / 2 for part in (t / RAMP, (t - RAMP) / 2))
        force = PULL * ramp * (1 + SWING * begun * np.sin(2 * np.pi * (t - RAMP) / PERIOD))
        rows = np.column_stack([t + begins, np.outer(force, direction)]) + 0.0  # + 0.0: no "-0"
        lines = [",".join(f"{value:.6g}" for value in row) for row in rows]
        (HERE / f"{name}.csv").write_text("\n".join(["time,x,y,z", *lines]) + "\n")


def of_the_papers_size(rom: Rom) -> Rom:
    """The paper's selection, with as many eigenvectors for each contact mode as in its Table II, if there are."""
    return replace(
        rom,
        contact_models={
            name: fr.truncate(rom, min(m, rom.contact_models[name].order)).contact_models[name]
            for name, m in PAPER_ORDERS.items()
        },
    )


def holding_what_was(problem: ReductionProblem) -> Iterator[tuple[str, RankedBasis]]:
    """Balanced directions after the other contact mode's shapes at rest, so that a switch does not lose these."""
    for name, found in balanced(problem):
        forces = np.hstack([problem.system.forces(other) for other in problem.system.contacts if other != name])
        at_rest = problem.space.add(problem.factor.solve(forces))
        yield name, RankedBasis(np.hstack([at_rest, pad_rows(found.coordinates, len(at_rest))]))


def push_and_release(
    system: fr.System, scene: Scene, models: Mapping[str, Rom], orders: tuple[int, ...], out: Path
) -> Errors:
    """Errors of the whole shape against the order, of 1,500 steps of 1 ms at one contact, pushed for the first 0.5 s.

    What is left of it at order 80 is round-off in the lowest eigenvalue of the reduced stiffness, and no truncation.
    """
    errors: dict[int, dict[str, tuple[float, ...]]] = {order: {} for order in orders}
    for name, push in PUSHES.items():
        load = AppliedLoad(contact=name, actuator=None, start=0.0, stop=0.5, signal=Signal(np.array(push, dtype=float)))
        asked = with_run(scene, dt=1e-3, duration=1.5, snapshots=300, loads=(load,))
        full = fr.simulate(replace(system, scene=asked))
        for order in orders:
            runs = [fr.simulate(fr.truncate(rom, order), scene=asked) for rom in models.values()]
            errors[order][name] = tuple(fr.compare(run, full)["shape"].relative for run in runs)
    rows = [
        (
            model,
            order,
            *(f"{errors[order][name][k]:.1e}" for name in PUSHES),
            f"{EARLIER[order][k]:.1e}",
            f"{errors[order]['first'][k] / EARLIER[order][k]:.2g}",
        )
        for order in orders
        for k, model in enumerate(models)
    ]
    heading = ("model", "order", *(f"pushed at the {name}" for name in PUSHES), "10,773 unknowns", "first / that")
    title = "Push and release, one contact mode, 1,500 steps of 1 ms: relative error of the whole shape"
    publish(title, markdown(heading, rows), out / "accuracy.md")
    return errors


def when_the_contact_moves(
    system: fr.System, scene: Scene, roms: Mapping[str, Rom], full: Trajectory, kept: Instants, out: Path
) -> dict[str, float]:
    """Errors of the whole shape over the 20 s, in the middle of which the contact moves."""
    assert scene.run is not None
    last = kept.of(round(MOVES / scene.run.dt))
    rows: list[tuple[object, ...]] = []
    errors = {}
    for name, model in roms.items():
        run = reduced(model, scene, kept)
        gap, size = gaps(system, run, full)
        errors[name] = relative(gap, size, kept)
        before = relative(gap[: last + 1], size[: last + 1], Instants(kept.steps[: last + 1], kept.share[: last + 1]))
        after = [gap[last + k] / size.max() for k in (1, 10, 100)]
        lost = max(model_lost(model))
        shown = "/".join(str(n) for n in dict.fromkeys(mode.order for mode in model.contact_models.values()))
        rows.append((name, shown, *(f"{e:.1e}" for e in (errors[name], before, *after, lost))))
    steps = [f"{k} step{'s' * (k > 1)} after" for k in (1, 10, 100)]
    heading = ("model", "states", "whole run", "until it moves", *steps, "lost of the shape at rest")
    title = (
        f"The thread lets go at {MOVES:g} s and pulls elsewhere: relative error of the whole shape, {kept.steps[-1]:,} "
        f"steps of {1e3 * scene.run.dt:g} ms; after the move as a share of the largest shape"
    )
    publish(title, markdown(heading, rows), out / "moved.md")
    return errors


def model_lost(rom: Rom) -> list[float]:
    """Share of a contact mode's shape at rest that the other contact mode's basis cannot hold, in the energy norm."""
    κ, lost = rom.stiffness, []
    for name, axis in (("first", 2), ("second", 1)):
        mode = rom.contact_models[name]
        x = mode.coordinates @ (mode.inputs[:, axis] / mode.eigenvalues)
        for other, into in rom.contact_models.items():
            if other != name:
                left = x - into.coordinates @ ((into.coordinates.T @ (κ * x)) / into.eigenvalues)
                lost.append(float(np.sqrt((κ @ left**2) / (κ @ x**2))))
    return lost


def table_2(system: fr.System, scene: Scene, theirs: Rom, ours: Rom, quick: bool, out: Path) -> dict[str, float]:
    """The paper's Table II beside ours."""
    loops = {  # all of them some milliseconds, so that other work on the machine meets all alike
        "full order": full_steps(system, scene, 5),
        "theirs": reduced_steps(theirs, scene, 1000),
        "step": reduced_steps(ours, scene, 2500),
        "rollout": reduced_rollout(ours, scene, 3),
    }
    found = rates(loops, 2 if quick else 101)
    speedups = {name: rate / found["full order"] for name, rate in found.items()}
    states = {
        name: [mode.order for mode in rom.contact_models.values()] for name, rom in (("theirs", theirs), ("ours", ours))
    }

    def row(what: str, states: list[int], name: str) -> tuple[object, ...]:
        return (what, *(f"{n:,}" for n in states), f"{found[name]:,.0f}", f"{speedups[name]:,.0f}")

    rows = [
        ("full order, paper", *[f"{PAPER_STATES:,}"] * 2, PAPER_FULL_RATE, 1),
        ("reduced, paper", *PAPER_ORDERS.values(), f"{PAPER_RATE:,.0f}", "80"),
        row("full order, here", [system.size] * 2, "full order"),
        row("the paper's method, here", states["theirs"], "theirs"),
        row("balanced, energy-orthogonal, `step`", states["ours"], "step"),
        row("the same, `rollout`, all markers after every step", states["ours"], "rollout"),
    ]
    heading = ("", "states, first contact", "states, second contact", "steps per second", "times full order")
    title = "Table II: states and rates; here of one thread"
    publish(title, markdown(heading, rows), out / "table_2.md")
    return speedups


def table_3(runs: Mapping[str, Trajectory], full: Trajectory, out: Path) -> None:
    """The paper's Table III, and what the reduction costs in it, beside ours."""
    lost = np.subtract(EXPERIMENT_AGAINST_REDUCED, EXPERIMENT_AGAINST_FULL)
    rows: list[tuple[object, ...]] = [
        ("paper: experiment against full order", *EXPERIMENT_AGAINST_FULL),
        ("paper: experiment against reduced", *EXPERIMENT_AGAINST_REDUCED),
        ("paper: what reduction adds", *(f"{e:.2f}" for e in lost)),
    ]
    for what, run in runs.items():
        for how, errors in zip(("RMS", "largest"), marker_errors(run, full), strict=True):
            rows.append((f"{what}, {how}", *(f"{e:.1e}" for e in errors)))
    heading = ("error, cm", *(f"marker {k}" for k in range(1, 5)))
    publish(
        "Table III: errors at the markers, in cm; ours of reduced against full order",
        markdown(heading, rows),
        out / "table_3.md",
    )


def publish(title: str, table: str, file: Path) -> None:
    """Prints a table and writes it."""
    file.write_text(table)
    print(f"{title}\n\n{table}")


def picture_of_markers(full: Trajectory, run: Trajectory, scene: Scene, file: Path) -> None:
    """Displacement of the markers against time, as the paper's Fig. 4; and how far the two are apart."""
    assert scene.run is not None
    times = scene.run.dt * np.arange(len(full.markers))
    figure, grid = plt.subplots(3, 2, figsize=(11, 8), sharex=True, sharey="row", layout="constrained")
    colours = mpl.colormaps["viridis"](np.linspace(0.0, 0.88, full.markers.shape[1]))
    off = 100 * np.abs(run.markers - full.markers)
    for column, (axis, name) in enumerate(((2, "z"), (1, "y"))):
        displacement, reduced_displacement, apart = grid[:, column]
        for k, colour in enumerate(colours):
            label = f"marker {k + 1}"
            displacement.plot(times, 100 * full.markers[:, k, axis], color=colour, linewidth=1.2, label=label)
            reduced_displacement.plot(times, 100 * run.markers[:, k, axis], color=colour, linewidth=1.2)
            apart.semilogy(times[1:], off[1:, k, axis], color=colour, linewidth=0.8)
        apart.axhspan(0.02, 0.04, color="crimson", alpha=0.6, linewidth=0)
        for axes, title in zip(grid[:, column], ("full order", f"reduced, order {ORDER}", "difference"), strict=True):
            axes.set_title(f"{title}, along {name}", fontsize=10, loc="left")
            axes.axvline(MOVES, color="0.3", linewidth=0.8, linestyle=(0, (4, 3)))
            axes.grid(linewidth=0.3)
        apart.set(xlabel="time (s)", ylim=(1e-9, 1), xlim=(0, times[-1]), xticks=np.arange(0, times[-1] + 1, 2))
    grid[2, 0].text(0.3, 0.014, "what reduction adds in the paper, RMS", color="crimson", fontsize=9, va="top")
    grid[0, 0].text(MOVES - 0.2, 0.86 * grid[0, 0].get_ylim()[1], "the contact moves", fontsize=9, va="top", ha="right")
    grid[0, 1].legend(ncols=2, loc="upper left", frameon=False)
    for axes in grid[:, 0]:
        axes.set_ylabel("cm")
    figure.savefig(file, dpi=110)
    plt.close(figure)


def picture_of_shapes(
    system: fr.System, scene: Scene, full: Trajectory, run: Trajectory, kept: Instants, file: Path
) -> None:
    """The bent cylinder, full and reduced, to scale, as the paper's Fig. 5: first from the front, then from the top."""
    assert scene.run is not None
    body = system.body
    views = {  # side, elevation and azimuth, where it is pulled and which way; the arrow's head as seen from there
        "first": ("front", (0, -90), 0.22, np.array([0, 0, -1]), "v"),
        "second": ("top", (90, -90), 0.38, np.array([0, 1, 0]), "^"),
    }
    sources = {"full order": full, f"reduced, order {ORDER}": run}
    shapes = {
        (name, what): on_nodes(system, source.snapshots[:, kept.of(round(SHOWN[name] / scene.run.dt))])
        for name in views
        for what, source in sources.items()
    }
    largest = max(np.linalg.norm(shape, axis=1).max() for shape in shapes.values())
    figure = plt.figure(figsize=(13, 4))
    for place, ((name, what), shape) in enumerate(shapes.items()):
        row, column = divmod(place, 2)
        side, (elevation, azimuth), along, way, head = views[name]
        axes = figure.add_axes(
            (0.01 + 0.46 * column, 0.46 - 0.48 * row, 0.45, 0.48), projection="3d", proj_type="ortho"
        )
        axes.view_init(elev=elevation, azim=azimuth)
        line = {"clip_on": False, "solid_capstyle": "butt"}
        axes.plot([0, 0.6], [0, 0], [0, 0], color="0.6", linewidth=0.8, linestyle=(0, (6, 4)), **line)
        for end in (-0.004, 0.604):
            axes.plot(*np.outer([end, 0, 0], [1, 1]) + np.outer(way, [-0.02, 0.02]), color="0.45", linewidth=6, **line)
        surface = draw_body(axes, body.nodes, body.triangles, shape, largest=largest)
        surface.set_linewidth(0.05)
        limits = [axes.get_xlim(), axes.get_ylim(), axes.get_zlim()]
        axes.set_box_aspect(np.ptp(limits, axis=1), zoom=3.2)  # it is thin
        near = np.linalg.norm(body.nodes - [along, 0, 0] - 0.0075 * way, axis=1).argmin()
        arrow = (body.nodes[near] + shape[near])[:, None] + np.outer(way, [0, 0.05])
        axes.plot(*arrow, color="crimson", linewidth=1.8, marker=head, markevery=[1], markersize=9, **line)
        title = f"{what}, {SHOWN[name]:g} s: {name} contact, from the {side}"
        figure.text(0.036 + 0.46 * column, 0.92 - 0.48 * row, title, fontsize=11)
    bar = figure.add_axes((0.935, 0.14, 0.011, 0.72))
    figure.colorbar(surface, cax=bar, label="displacement (cm)", format=lambda value, _: f"{100 * value:g}")
    figure.savefig(file, dpi=110)
    plt.close(figure)


def check(
    nodes: int,
    errors: Errors,
    moved: Mapping[str, float],
    runs: Mapping[str, Trajectory],
    full: Trajectory,
    speedups: Mapping[str, float],
    quick: bool,
) -> None:
    """The claims of this page, measured."""
    rms = {name: marker_errors(run, full)[0] for name, run in runs.items()}
    lost = np.subtract(EXPERIMENT_AGAINST_REDUCED, EXPERIMENT_AGAINST_FULL)
    claims = {
        f"at order {ORDER} push and release are right to 1e-6": max(e[0] for e in errors[ORDER].values()) < 1e-6,
        f"at order {ORDER} the balanced basis is 1,000 times closer than as many eigenvectors": all(
            1000 * e[0] < min(e[1:]) for e in errors[ORDER].values()
        ),
        "nothing turned or strained beyond what a linear model can follow": not any(
            run.warnings for run in runs.values()
        ),
        "the energy account is closed to 2e-12": all(run.balance_error < 2e-12 for run in runs.values()),
        f"at order {ORDER} no marker is off by more than 1e-4 cm (RMS), 200 times less than in the paper": bool(
            (rms[OURS] < 1e-4).all() and (200 * rms[OURS] < lost).all()
        ),
        "at a quarter of its states the whole run is closer than with the paper's method": moved[OURS] < moved[THEIRS],
        "the other contact's shapes at rest make it closer still": moved[HOLDING] < moved[OURS],
        "with them no marker is ever off by more than 1e-4 cm": marker_errors(runs[HOLDING], full)[1].max() < 1e-4,
    }
    if not quick:
        claims |= {
            "no error is more than twice what it was on our earlier mesh": all(
                e < 2 * earlier
                for order in errors
                for each in errors[order].values()
                for e, earlier in zip(each, EARLIER[order], strict=True)
            ),
            "the mesh has as many nodes as the paper's, to 1 %": abs(nodes / PAPER_NODES - 1) < 0.01,
            "at order 80 the whole run is right to 1e-6, although the contact moves": moved["balanced, order 80"]
            < 1e-6,
            "a step is 500 times faster than one of the full order; in the paper 80 times": speedups["step"] >= 500,
            "a rollout is 5,000 times faster": speedups["rollout"] >= 5000,
        }
    for claim, holds in claims.items():
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    if not all(claims.values()):
        sys.exit(1)


if __name__ == "__main__":
    main()
