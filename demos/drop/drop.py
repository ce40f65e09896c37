"""A soft ring that nothing holds falls on a slope, touches down, and leaves it again.

    python demos/drop/drop.py                 # two minutes
    python demos/drop/drop.py --quick         # two variants at one order, to see that it works

The ring, 8 cm across, has its six rigid motions, and 1,200 unknowns at full order. Each variant is the scene but for a
line: with another restitution or friction, without friction, without damping. All of them run on one reduced model. The
script

1. tables what accuracy costs: errors and rate against the order, with and without residual compliance, and what the
   step itself and the mesh, turned about the axis of the ring, make at full order, and drops from other heights;
2. compares every variant at full order and reduced: shapes, rebound, and what became of the energy;
3. draws the ring to scale, the way of its centre, and its energy.

Restitution is of every point of the surface, and a point has little mass. The ring as a whole leaves the ground by its
elasticity, and how fast is a matter of damping: with restitution 0 it bounces nearly as high as with 1.

Everything is written to demos/drop/out/, with --quick to out/quick/. The checks at the end fail if a claim does not
hold.
"""

import argparse
import sys
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from math import hypot, sqrt
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import PolyCollection
from numpy.linalg import norm

sys.path.append(str(Path(__file__).parents[1] / "poke"))

from cases import compare_cases
from touching import Comparison, compare_orders, errors, turned

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.io.markdown import markdown
from fenics_rom.mechanics.linearity import SurfaceGauges, measure_peaks
from fenics_rom.scene.contact import Friction

HERE = Path(__file__).parent
OUT = HERE / "out"

ORDERS = (20, 50, 100)  # and the scene's own is one of them
ANOTHER_MESH = {"full order, mesh turned by 1°": partial(turned, axis=1, centre=(0.0, 0.0, 0.04))}
OWN, LOSSLESS = "as in the scene", "no losses"
VARIANTS: dict[str, dict[str, float | None]] = {  # what differs from the scene; None: not there
    OWN: {},
    "little friction": {"friction": 0.02},
    "no friction": {"friction": None},
    "no friction, restitution 0": {"friction": None, "restitution": 0.0},
    "no friction, restitution 1": {"friction": None, "restitution": 1.0},
    LOSSLESS: {"friction": None, "restitution": 1.0, "damping": None},
}
HEIGHTS = (OWN, "no friction, restitution 0", "no friction, restitution 1", LOSSLESS)  # what is drawn where
WAYS = (OWN, "little friction", "no friction")
GAPS = np.linspace(0.010, 0.018, 12)  # m, between the ring and the ground
LANDING = 120  # steps from the first touch on
MEASURES = {  # of many drops, and the most that errors may be of those of the largest order that is stiff
    "shape": 0.6,
    "force": 1.3,
    "force in the first 6 ms": 1.5,
    "impulse in the first 6 ms": 0.6,
}
STIFF = "without residual compliance"
APART = 0.1  # m between the pictures of the ring
OBLIQUE = (0.35, 0.25)  # where the third direction points
LIGHT = np.array([0.3, -0.8, 0.9]) / sqrt(1.54)

Array = np.ndarray


@dataclass(frozen=True)
class Fall:
    """A variant at full order and reduced."""

    scene: fr.Scene
    full: fr.Trajectory
    run: fr.Trajectory

    @property
    def fastest(self) -> float:
        """Of any node at full order, m/s."""
        between = np.diff(self.full.snapshots, axis=0) / np.diff(self.full.snapshot_times)[:, None, None]
        return float(np.linalg.norm(between, axis=2).max())

    @property
    def error(self) -> float:
        """Largest error of any node at any kept instant, as a share of the largest displacement."""
        return errors(self.run, self.full).node


def main() -> None:
    """Runs the demo."""
    parser = argparse.ArgumentParser(description="Drops a soft ring on a slope.")
    parser.add_argument("--quick", action="store_true", help="two variants at one order")
    quick = parser.parse_args().quick
    out = OUT / "quick" if quick else OUT  # so that a test does not overwrite the whole
    out.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore", FenicsRomWarning)  # `fenics-rom info` lists them
    scene = fr.read_scene(HERE / "drop.toml")
    system = fr.assemble(scene)
    points = len(system.contact_points["tread"])
    print(f"Ring: {system.size:,} unknowns, 6 rigid motions, {points} points that can touch the ground\n")

    own = scene.reduction.order
    assert isinstance(own, int)
    orders = (own,) if quick else ORDERS
    assert own in orders
    roms = {order: fr.reduce(system, order=order) for order in orders}
    runs = compare_orders(system, roms, sensitivity=None if quick else ANOTHER_MESH)
    runs.table(out / "accuracy.md")
    ratios = None if quick else table_of_drops(scene, roms, out / "drops.md")
    fr.write_rom(out / "drop.h5", roms[own])
    falls = {OWN: Fall(scene, runs.full, runs.reduced[own])}
    falls |= {
        name: fall(scene, roms[own], change)
        for name, change in VARIANTS.items()
        if name == LOSSLESS or not (quick or name == OWN)
    }
    table_of_variants(falls, out)
    fr.write_trajectory(out / "full.h5", falls[OWN].full)
    fr.write_trajectory(out / "reduced.h5", falls[OWN].run)
    picture(falls, out)
    check(falls, runs, ratios)


def table_of_drops(scene: fr.Scene, roms: Mapping[int, fr.Rom], file: Path) -> dict[str, float]:
    """Errors of drops from several heights; those of the scene's own order by those of the largest order.

    That is without residual compliance. On which facet a ring lands, and what it does then, hangs on the height.
    """
    own, largest = scene.reduction.order, max(roms)
    models = {("reduced", order): (rom, True) for order, rom in roms.items()}
    models[STIFF, largest] = roms[largest], False
    cases = compare_cases((with_gap(scene, gap) for gap in GAPS), models, errors_of_drop)
    table = markdown(("model", "order", *MEASURES), cases.medians)
    file.write_text(table)
    print(f"{len(GAPS)} drops from other heights, medians\n\n{table}")
    return cases.ratios(("reduced", own), (STIFF, largest), MEASURES)


def errors_of_drop(run: fr.Trajectory, full: fr.Trajectory) -> tuple[float, float, float, float]:
    """Of the shape in mass and of the force, over the run; of the force and its impulse in the first 6 ms."""
    whole = errors(run, full)
    mean, there = (one.forces["ground"][1:].reshape(full.steps, -1, 3).mean(axis=1) for one in (run, full))
    first = int(np.flatnonzero(there.any(axis=1))[0])
    mean, there = (force[first : first + LANDING] for force in (mean, there))
    impulse = norm((mean - there).sum(axis=0)) / norm(there.sum(axis=0))
    return whole.shape, whole.forces["ground"], float(norm(mean - there) / norm(there)), float(impulse)


def with_gap(scene: fr.Scene, gap: float) -> fr.Scene:
    """The scene with the ground so far below the ring, m."""
    contact = scene.effects.contact
    ground = replace(contact.obstacles["ground"], point=(0.0, 0.0, -gap))
    return replace(scene, effects=replace(scene.effects, contact=replace(contact, obstacles={"ground": ground})))


def variant(scene: fr.Scene, changes: dict[str, float | None]) -> fr.Scene:
    """The scene but for a line or two."""
    effects = scene.effects
    for name, value in changes.items():
        if value is None:
            effects = replace(effects, **{name: None})
        elif name == "restitution":
            assert effects.contact is not None
            effects = replace(effects, contact=replace(effects.contact, restitution=value))
        else:
            effects = replace(effects, friction=Friction(value))
    return replace(scene, effects=effects)


def fall(scene: fr.Scene, rom: fr.Rom, changes: dict[str, float | None]) -> Fall:
    """Runs a variant at full order and reduced."""
    asked = variant(scene, changes)
    return Fall(asked, fr.simulate(asked), fr.simulate(rom, scene=asked))


def write(what: str, title: str, table: str, file: Path) -> None:
    """Prints and writes a table."""
    file.write_text(f"{title}\n\n{table}")
    print(f"{what}: {title}\n\n{table}")


def centre(run: fr.Trajectory) -> Array:
    """Displacement of the centre of mass at the kept instants, (shapes, 3), m."""
    return run.node_mass @ run.snapshots / run.node_mass.sum()


def drop(scene: fr.Scene) -> tuple[float, float, float]:
    """The gap, m; gravity against the ground and along it, m/s²."""
    x, _, z = scene.effects.gravity.acceleration
    return -scene.effects.contact.obstacles["ground"].point[2], -z, x


def landing(scene: fr.Scene) -> float:
    """When a body from rest has fallen through the gap, s."""
    gap, down, _ = drop(scene)
    return sqrt(2 * gap / down)


def rebound(run: fr.Trajectory) -> float:
    """Highest that the centre gets after it was lowest, above where it is when the ring touches the ground, m."""
    z = centre(run)[:, 2]
    lowest = int(z.argmin())
    return float(z[lowest:].max() - touchdown(run))


def touchdown(run: fr.Trajectory) -> float:
    """Height at which the centre is when the ring touches down, m."""
    touched = np.flatnonzero(run.forces["ground"].any(axis=1))[0]
    return float(np.interp(run.times[touched - 1], run.snapshot_times, centre(run)[:, 2]))


def table_of_variants(falls: dict[str, Fall], out: Path) -> None:
    """Each variant: error, rebound, and what became of the energy."""
    rows = []
    for name, f in falls.items():
        gap, _, _ = drop(f.scene)
        damping = f.full.dissipated - sum(f.full.contact_account.get(part, 0.0) for part in ("contact", "friction"))
        lost = [*(f.full.contact_account.get(part, [0.0])[-1] for part in ("contact", "friction")), damping[-1]]
        rows.append(
            (
                name,
                f"{f.error:.1e}",
                *(f"{rebound(run) / gap:.4f}" for run in (f.full, f.run)),
                *(f"{1e3 * centre(run)[-1, 0]:.3f}" for run in (f.full, f.run)),
                *(f"{1e6 * part:.3g}" if part > 1e-12 else "0" for part in lost),
                f"{1e6 * f.full.supplied[-1]:.5g}",
            )
        )
    sides = [f"{what}, {model}" for what in ("rebound / drop", "slid, mm") for model in ("full", "reduced")]
    heading = ("variant", "error", *sides, "lost in contact, µJ", "in friction", "in damping", "work of gravity")
    order = falls[OWN].scene.reduction.order
    write(
        "Variants",
        f"order {order}, of one reduced model; energies at full order",
        markdown(heading, rows),
        out / "variants.md",
    )


def picture(falls: dict[str, Fall], out: Path) -> None:
    """The ring to scale, the way of its centre, and its energy."""
    figure = plt.figure(figsize=(11, 7), layout="constrained")
    top, bottom = figure.subfigures(2, 1, height_ratios=[1.0, 1.15])
    picture_of_rings(top, falls[OWN])
    heights, ways, energy = bottom.subplots(1, 3)
    own = falls[OWN]
    times = np.linspace(0, landing(own.scene), 50)
    _, down, along = drop(own.scene)
    heights.plot(1e3 * times, -1e3 * down / 2 * times**2, color="0.75", linewidth=6, label="free fall")
    ways.plot(
        1e3 * own.full.snapshot_times,
        1e3 * along / 2 * own.full.snapshot_times**2,
        color="0.75",
        linewidth=6,
        label="free fall",
    )
    for k, (name, f) in enumerate(falls.items()):
        t, moved, exact = 1e3 * f.run.snapshot_times, 1e3 * centre(f.run), 1e3 * centre(f.full)
        for axes, row, shown in ((heights, 2, HEIGHTS), (ways, 0, WAYS)):
            if name in shown:
                axes.plot(t, exact[:, row], color="black", linewidth=0.7)
                axes.plot(t, moved[:, row], color=f"C{k}", linestyle=(0, (4, 3)), linewidth=2, label=name)
    heights.set(xlabel="time (ms)", ylabel="height of the centre (mm)")
    ways.set(xlabel="time (ms)", ylabel="way of the centre down the slope (mm)")
    picture_of_energy(energy, own)
    for axes in (heights, ways, energy):
        axes.legend(fontsize=7.5, frameon=False, handlelength=3.2, loc="best" if axes is heights else "upper left")
        axes.spines[["top", "right"]].set_visible(False)
    bottom.suptitle("Black: full order; dashed: reduced", fontsize=9, x=0.02, ha="left")
    figure.savefig(out / "drop.png", dpi=105)
    plt.close(figure)


def picture_of_energy(axes: plt.Axes, f: Fall) -> None:
    """What became of the work of gravity."""
    run = f.run
    contact, friction = (run.contact_account[part] for part in ("contact", "friction"))
    parts = {
        "stored": run.energy,
        "lost in damping": run.dissipated - contact - friction,
        "lost in contact": contact,
        "lost in friction": friction,
    }
    axes.stackplot(
        1e3 * run.times,
        *(1e3 * part for part in parts.values()),
        labels=list(parts),
        colors=["#8fb8de", "#f2b880", "#c8553d", "#588157"],
    )
    axes.plot(1e3 * run.times, 1e3 * run.supplied, color="black", linewidth=1, label="work of gravity")
    axes.set(
        xlabel="time (ms)", ylabel="energy (mJ)", xlim=(0, 1e3 * run.times[-1]), ylim=(0, 1500 * run.supplied.max())
    )


def picture_of_rings(figure: plt.Figure, f: Fall) -> None:
    """The ring at some instants, to scale, pictures side by side."""
    run = f.run
    gap, down, along = drop(f.scene)
    z = centre(run)[:, 2]
    lowest, land = run.snapshot_times[z.argmin()], landing(f.scene)
    instants = [0.0, land, (land + lowest) / 2, lowest, 2 * lowest - land, run.times[-1]]
    axes = figure.subplots()
    slope = np.array([[down, along], [-along, down]]) / hypot(down, along)  # turns the ground so that weight is down
    strained = [deformation(run, at(run, t)) for t in instants]
    brightest = max(np.linalg.norm(u, axis=1).max() for u in strained)
    left, right, y = -0.06, 5 * APART + 0.06, 0.02
    ground = np.array([[left, -y, -gap], [right, -y, -gap], [right, y, -gap], [left, y, -gap]])
    below = ground[[0, 1, 1, 0]] - [[0, 0, 0], [0, 0, 0], [0, 0, 0.008], [0, 0, 0.008]]
    axes.add_patch(plt.Polygon(seen(ground) @ slope.T, facecolor="0.93", edgecolor="0.6", linewidth=0.6))
    axes.add_patch(plt.Polygon(seen(below) @ slope.T, facecolor="0.82", edgecolor="0.6", linewidth=0.6))
    for k, (t, u) in enumerate(zip(instants, strained, strict=True)):
        drawn = ring(axes, run, at(run, t) + np.array([k * APART, 0, 0]), np.linalg.norm(u, axis=1), brightest, slope)
        label = seen((run.nodes + at(run, t)).mean(axis=0) + np.array([k * APART, 0, 0])) @ slope.T
        axes.annotate(f"{1e3 * t:.0f} ms", label, ha="center", va="center", fontsize=9)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set_axis_off()
    figure.colorbar(drawn, ax=axes, label="deformation (mm)", shrink=0.6, pad=0.01)


def at(run: fr.Trajectory, time: float) -> Array:
    """The kept shape nearest to an instant, (N, 3), m."""
    return run.snapshots[np.abs(run.snapshot_times - time).argmin()] if time > 0 else np.zeros_like(run.snapshots[0])


def deformation(run: fr.Trajectory, u: Array) -> Array:
    """The displacement without the rigid motion in it, (N, 3), m."""
    x = run.nodes - run.nodes.mean(axis=0)
    motions = np.stack([np.broadcast_to(e, x.shape) for e in np.eye(3)] + [np.cross(e, x) for e in np.eye(3)])
    rigid = motions.reshape(6, -1).T
    return u - (rigid @ np.linalg.lstsq(rigid, u.ravel(), rcond=None)[0]).reshape(u.shape)


def seen(x: Array) -> Array:
    """Points (..., 3) in a cavalier projection, (..., 2): lengths along the slope and off it are true."""
    return x[..., [0, 2]] + x[..., 1:2] * OBLIQUE


def ring(
    axes: plt.Axes, run: fr.Trajectory, u: Array, colour: Array, brightest: float, slope: Array
) -> mpl.cm.ScalarMappable:
    """Draws the deformed ring, far triangles first; returns what a colour bar can be hung on."""
    x = run.nodes + u
    corners = x[run.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    flat = seen(corners) @ slope.T
    order = np.argsort(-(corners @ [-OBLIQUE[0], 1.0, -OBLIQUE[1]]).mean(axis=1))
    collection = PolyCollection(flat[order], linewidth=0.15)
    values = 1e3 * colour[run.triangles].mean(axis=1)[order]
    shade = 0.7 + 0.3 * np.abs(normals @ LIGHT)[order]
    face = plt.get_cmap("viridis")(values / (1e3 * brightest))
    face[:, :3] *= shade[:, None]
    collection.set_facecolor(face)
    collection.set_edgecolor((0, 0, 0, 0.25))
    axes.add_collection(collection)
    return mpl.cm.ScalarMappable(mpl.colors.Normalize(0, 1e3 * brightest), "viridis")


def check(falls: dict[str, Fall], orders: Comparison, ratios: dict[str, float] | None) -> None:
    """The claims of this page, measured."""
    own, lossless = falls[OWN], falls[LOSSLESS]
    runs = [run for f in falls.values() for run in (f.full, f.run)]
    close, stiff = (errors(run, own.full) for run in (own.run, orders.without[own.scene.reduction.order]))
    gap, down, along = drop(own.scene)
    gauges = SurfaceGauges(own.full.nodes, own.full.triangles)
    snapshots = (u for fall in falls.values() for u in fall.full.snapshots)
    rotation, strain = np.max([measure_peaks(gauges.components(u)) for u in snapshots], axis=0)
    flying = own.full.snapshot_times < landing(own.scene) - own.full.settings["dt"]
    parabola = own.full.snapshot_times[:, None] ** 2 / 2 * [along, 0.0, -down]
    first = [run.times[np.flatnonzero(run.forces["ground"].any(axis=1))[0]] for run in runs]
    heights = [(run.nodes[:, 2] + run.snapshots[:, :, 2]).min() + gap for run in runs]
    step = max(f.fastest for f in falls.values()) * own.full.settings["dt"]
    monotone = min(
        np.diff(run.contact_account[part]).min() / run.supplied.max()
        for run in runs
        for part in ("contact", "friction")
        if part in run.contact_account
    )
    kept, yielded = (
        np.abs(run.energy - run.supplied).max() / run.supplied.max() for run in (lossless.full, lossless.run)
    )
    slid = max(
        np.abs(centre(run) - parabola)[:, 0].max()
        for f in falls.values()
        if f.scene.effects.friction is None
        for run in (f.full, f.run)
    )
    sideways = max(np.abs(centre(run)[:, 1]).max() for run in runs)
    damped = {name: f.error for name, f in falls.items() if name != LOSSLESS}
    claims = {
        f"damped, the model of order {own.scene.reduction.order} is right to 1 %": (max(damped.values()), 1e-2),
        "without losses to 3 %": (lossless.error, 3e-2),
        "its error, of that without residual compliance": (close.node / stiff.node, 0.1),
        "rebounds differ, as a share of the drop": (
            max(abs(rebound(f.run) - rebound(f.full)) / gap for f in falls.values()),
            1e-2,
        ),
        "until it lands the ring follows the parabola, m": (
            max(np.abs(centre(run) - parabola)[flying].max() for run in (own.full, own.run)),
            3e-13,
        ),
        "it lands when it should, in steps": (
            max(abs(t - landing(own.scene)) for t in first) / own.full.settings["dt"],
            2.0,
        ),
        "without friction the way down the slope is the parabola's, m": (slid, 1e-12),
        "nothing drives the ring sideways, m": (sideways, 1e-11),
        "gap of the energy account": (max(run.balance_error for run in runs), 2e-12),
        "what contact and friction take never shrinks, as a share of the work": (-monotone, 1e-14),
        "without losses full order stores all work": (kept, 1e-11),
        "and reduced but what residual compliance takes in impacts": (yielded, 0.08),
        "penetration, in steps of the fastest node": (-min(heights) / step, 2.0),
        "rotation, rad": (rotation, 0.2),
        "strain": (strain, 0.1),
    }
    if orders.step is not None:
        claims["the shape is off by what the time step itself makes, times"] = close.shape / orders.step.shape, 1.5
    if ratios is not None:
        than = f"of drops from other heights, over order {max(ORDERS)} without residual compliance: "
        claims |= {f"{than}{what}": (ratio, MEASURES[what]) for what, ratio in ratios.items()}
    for claim, (value, bound) in claims.items():
        print(f"  {'holds' if value <= bound else 'FAILS'}: {claim}: {value:.2g}, at most {bound:g}")
    if not all(value <= bound for value, bound in claims.values()):
        sys.exit(1)


if __name__ == "__main__":
    main()
