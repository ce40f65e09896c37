"""A PneuNet is inflated to 50 kPa and back: its chambers press upon one another, and bend it into a hook.

    python demos/pneunet/pneunet.py            # the finger
    python demos/pneunet/pneunet.py --quick    # two of its chambers, of a lower order

Everything is written to demos/pneunet/out/. The checks at the end fail if a claim does not hold.
"""

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import PolyCollection
from numpy import ndarray as Array

sys.path.append(str(Path(__file__).parents[1] / "poke"))

from mesh import planes, write
from touching import check

import fenics_rom as fr
from fenics_rom.compilation import numpy_alone
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.io.markdown import markdown
from fenics_rom.mechanics.environment import Environment
from fenics_rom.mechanics.load_history import LoadHistory
from fenics_rom.scene.scene import Scene

HERE = Path(__file__).parent
ERROR, ACCOUNT, FASTER, SAME = 0.02, 1e-10, 40, 1e-9  # that are claimed
STEPPER = "linearly-implicit"  # however long steps are beside the slowest period: see the error
QUICK_CHAMBERS, QUICK_ORDER, QUICK_DURATION = 2, 20, 1.0  # number, and s
SHOWN, TIMES = 4, 4  # instants, and runs of which the fastest counts


class Inflated(NamedTuple):
    """A run of the finger."""

    name: str
    tip: Array  # displacement (n, 3), m
    within: Array  # sum of the sizes of its forces on itself (n,), N
    shapes: Array  # of its nodes (n, N, 3), m
    account: float  # what energy balance misses, of the largest energy
    rate: float  # steps per second of processor time
    rolled: float  # the same in a rollout; nan where there is none
    apart: float  # how far its tip is from that of steps at most, m


def main() -> None:
    """Runs the demo; exits with 1 where a claim fails."""
    parser = argparse.ArgumentParser(description="A PneuNet is inflated and let go.")
    parser.add_argument("--quick", action="store_true", help="two chambers, a lower order")
    quick = parser.parse_args().quick
    out = HERE / "out" / "quick" if quick else HERE / "out"
    out.mkdir(parents=True, exist_ok=True)
    scene = fr.read_scene(HERE / "pneunet.toml")
    assert scene.run is not None
    if quick:
        scene = smaller(scene, out / "pneunet.msh")
    system = fr.assemble(scene)
    assert scene.run is not None
    print(f"{system.size:,} unknowns, {len(system.points_of_contact().coordinates)} points that may touch")

    rom = fr.reduce(system, checkpoint=out / "training", resume=True)
    fr.write_rom(out / "pneunet.h5", rom)
    assert rom.deformation is not None
    order, dt = len(rom.stiffness), scene.run.dt
    acting = scene.environment
    full = inflated(lambda: FullOrderSimulator(system, dt, acting), acting, "full order", 1)
    reduced = inflated(lambda: fr.Simulator(rom, dt, stepper=STEPPER), acting, f"order {order}")
    passing = replace(acting, self_contact=(), contact_law=None)
    alone = inflated(lambda: fr.Simulator(rom, dt, scene=passing, stepper=STEPPER), passing, "walls that pass")
    with numpy_alone():
        slow = inflated(lambda: fr.Simulator(rom, dt, stepper=STEPPER), acting, f"order {order}, NumPy")
    runs = [full, reduced, slow, alone]
    print(table(out / "pneunet.md", runs))
    print(f"{len(rom.deformation.weights)} of {rom.deformation.points_of:,} points kept")
    draw(out / "pneunet.png", rom, runs, dt)
    error, account, apart = off(reduced, full), max(run.account for run in runs), max(run.apart for run in runs)
    claims = {
        f"the tip is right to {ERROR:.0%} of its way over the whole run ({error:.2%})": error < ERROR,
        f"walls press upon one another ({full.within.max():.2f} N)": full.within.max() > 0.1,
        f"where they pass the tip goes elsewhere ({off(alone, full):.0%})": off(alone, full) > 2 * ERROR,
        f"energy accounts close to {ACCOUNT:g} ({account:.0e})": account < ACCOUNT,
        f"rollouts go where steps go ({1e3 * apart:.0e} mm)": apart < SAME * np.abs(full.tip).max(),
    }
    if not quick:
        bent, faster = np.linalg.norm(full.tip, axis=1).max(), reduced.rate / full.rate
        claims |= {
            f"the tip moves by a third of the length ({1e3 * bent:.0f} mm)": bent > 0.1 / 3,
            f"reduced, it is at least {FASTER} times as fast ({faster:.0f})": faster > FASTER,
        }
    check(claims)


def smaller(scene: Scene, mesh: Path) -> Scene:
    """The scene with few chambers, for a part of the time, to be reduced to a lower order."""
    assert scene.run is not None
    write(mesh, QUICK_CHAMBERS)
    run, reduction = replace(scene.run, duration=QUICK_DURATION), replace(scene.reduction, order=QUICK_ORDER)
    end = {"tip": replace(scene.outputs["tip"], points=((1e-3 * planes(QUICK_CHAMBERS)[0][-1], 0.0, 0.0),))}
    return replace(scene, mesh_file=mesh, run=run, reduction=reduction, outputs=end)


def inflated(
    make: Callable[[], fr.Simulator | FullOrderSimulator], acting: Environment, name: str, times: int = TIMES
) -> Inflated:
    """Takes the pressures of the scene's run some times, among what acts; the fastest tells the rate."""
    history = [u for _, u in LoadHistory(acting, {"walls": 3}, {"air": 1})]
    run = max((_inflated_once(make(), history, name) for _ in range(times)), key=lambda run: run.rate)
    return max((_with_rollout(make(), history, run) for _ in range(times)), key=lambda run: run.rolled)


def _with_rollout(body: fr.Simulator | FullOrderSimulator, history: list[Array], run: Inflated) -> Inflated:
    """The same with a rollout under that history."""
    if isinstance(body, FullOrderSimulator):
        return run
    begun = time.process_time()
    tip = body.rollout(np.array(history))["tip"]
    rate = len(history) / (time.process_time() - begun)
    return run._replace(rolled=rate, apart=float(np.abs(tip.reshape(run.tip.shape) - run.tip).max()))


def _inflated_once(body: fr.Simulator | FullOrderSimulator, history: list[Array], name: str) -> Inflated:
    stepper, steps, spent = body.stepper if isinstance(body, FullOrderSimulator) else body.integrator, len(history), 0.0
    tip, within, shapes = np.zeros((steps, 3)), np.zeros(steps), []
    energy, missed, gone = np.zeros(steps), np.zeros(steps), body.ledger
    assert gone is not None
    for step, u in enumerate(history):
        begun = time.process_time()
        body.step(u)
        spent += time.process_time() - begun
        tip[step], contact = body.displacement("tip")[0], stepper.contact
        if contact is not None:
            within[step] = np.linalg.norm(contact.pair_forces, axis=1).sum()
        shapes.append(body.displacement())
        energy[step] = body.energy
        missed[step] = energy[step] - gone.supplied + gone.dissipated + gone.numerical + gone.lost_in_switching
    account = float(np.abs(missed).max() / energy.max())
    return Inflated(name, tip, within, np.array(shapes), account, steps / spent, np.nan, 0.0)


def off(run: Inflated, full: Inflated) -> float:
    """Largest distance of the tips over the run, as a share of how far it goes."""
    farthest = np.linalg.norm(full.tip, axis=1).max()
    return float(np.linalg.norm(run.tip - full.tip, axis=1).max() / farthest)


def table(file: Path, runs: list[Inflated]) -> str:
    """Errors, rates and accounts, beside full order, the first."""
    full = runs[0]
    heads = (
        "model",
        "error of the tip",
        "forces on itself, at most",
        "account",
        "steps per second",
        "in a rollout",
        "times full order",
    )
    rows = []
    for run in runs:
        error = "-" if run is full else f"{off(run, full):.2%}"
        rolled = "-" if run is full else f"{run.rolled:,.3g}"
        speed = f"{run.rate:,.3g}", rolled, f"{run.rate / full.rate:,.3g}"
        rows.append((run.name, error, f"{run.within.max():.2f} N", f"{run.account:.0e}", *speed))
    text = markdown(heads, rows)
    file.write_text(text)
    return text


def draw(file: Path, rom: fr.Rom, runs: list[Inflated], dt: float) -> None:
    """The plane of symmetry at some instants, the tip's way, and how hard the body presses on itself."""
    full, reduced, _, apart = runs
    figure = plt.figure(figsize=(10.5, 5.2), layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=(1.5, 1))
    in_front = np.isclose(rom.nodes[rom.triangles, 1], 0.0).all(axis=1)
    nodes = np.unique(rom.triangles[in_front])
    steps = len(full.tip)
    shown = np.linspace(0, int(0.75 * steps), SHOWN).astype(int)
    views = left.subplots(2, SHOWN // 2, sharex=True, sharey=True)
    for view, step in zip(views.flat, shown, strict=True):
        corners = 1e3 * (rom.nodes + full.shapes[step])[rom.triangles[in_front]][..., [0, 2]]
        view.add_collection(PolyCollection(corners, facecolor="#9ecae1", edgecolor="#3182bd", linewidth=0.3))
        there = 1e3 * (rom.nodes + reduced.shapes[step])[nodes]
        view.plot(there[:, 0], there[:, 2], ".", color="#cb181d", markersize=1.5)
        view.set_title(f"{(step + 1) * dt:.2f} s", fontsize=9)
        view.set_aspect("equal")
        view.autoscale_view()
    left.supxlabel("x (mm)", fontsize=9)
    left.supylabel("z (mm)", fontsize=9)
    way, force = right.subplots(2)
    styles = ((full, "0.3", "-"), (reduced, "#cb181d", "--"), (apart, "#fd8d3c", ":"))
    for run, color, line in styles:
        way.plot(1e3 * run.tip[:, 0], 1e3 * run.tip[:, 2], line, color=color, label=run.name)
        force.plot(dt * np.arange(1, steps + 1), run.within, line, color=color)
    way.set(xlabel="the tip moves by x (mm)", ylabel="by z (mm)")
    way.legend(fontsize=7, frameon=False)
    force.set(xlabel="time (s)", ylabel="forces on itself (N)")
    for axes in (way, force):
        axes.grid(alpha=0.3)
    figure.savefig(file, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    main()
