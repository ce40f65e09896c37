"""A soft finger bends by more than 60 degrees and hooks around a rod: large deformation, at full order and reduced.

    python demos/bending/bending.py            # some minutes, most of them at full order
    python demos/bending/bending.py --quick    # of degree 1, half of the run; nothing is claimed of angles and rates
    python demos/bending/bending.py --large    # about 20,000 tetrahedra without the rod, 6 min

The finger of demos/finger, of softer silicone. A tendon along its lower side bends it around a rod, and air presses it
on. The scene names large_deformation; without that, a linear model swells where it should turn. The script

1. runs the scene at full order, nonlinear and linear;
2. reduces it (training runs, choice of points) and runs the reduced model with both steppers;
3. tables errors, rates and energy accounts, and draws linear and nonlinear side by side, to scale;
4. compares what presses on the rod with full order, at the order of the scene and at a larger one, and draws it.

Everything is written to demos/bending/out/. The checks at the end fail if a claim does not hold.
"""

import argparse
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.patches import Circle, Rectangle

sys.path.append(str(Path(__file__).parents[1] / "poke"))

from touching import draw_from_side, true_to_scale

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.io.markdown import markdown
from fenics_rom.mechanics.step import FINITE_STRAIN_STEPPERS
from fenics_rom.runtime.simulate import rate as fastest
from fenics_rom.scene.scene import Scene
from fenics_rom.visualization.figure import figure_class

HERE = Path(__file__).parent
GEOMETRY = HERE.parents[1] / "meshes" / "finger.geo"
FINE = 0.0021  # m, of the edges of the large mesh
INSTANTS = (0.15, 0.28, 0.8)  # s
RUNS = 5  # of which the fastest counts: whatever else a machine does can only slow a reduced model down
ERROR = 0.02  # that a reduced run may have
FORCE_ORDER, FORCE_ERROR, PEAK_ERROR = 40, 0.12, 0.04  # of contact forces, over the run, and their largest
FASTER = {False: 10, True: 50}  # than full order, at least; on the large mesh
Array = np.ndarray


def main() -> None:
    """Runs the demo; exits with 1 where a claim fails."""
    parser = argparse.ArgumentParser(description="A soft finger bends around a rod.")
    parser.add_argument("--quick", action="store_true", help="of degree 1, and half of the run")
    parser.add_argument("--large", action="store_true", help="about 20,000 tetrahedra of degree 1")
    choice = parser.parse_args()
    out = HERE / "out" / ("quick" if choice.quick else "large" if choice.large else "")
    out.mkdir(parents=True, exist_ok=True)

    scene = fr.read_scene(HERE / "bending.toml")
    assert scene.run is not None
    if choice.large:
        run = replace(scene.run, dt=2 * scene.run.dt)
        scene = replace(scene, mesh_file=large_mesh(out / "finger.msh"), degree=1, run=run)
        scene = without(scene, "contact")  # at full order, hundreds of contact points would take hours
    if choice.quick:
        scene = replace(scene, degree=1, run=replace(scene.run, duration=scene.run.duration / 2))
    system = fr.assemble(scene)
    assert system.deformation is not None
    print(f"Finger: {system.size:,} unknowns, {len(system.deformation.weights):,} points\n")

    full = fr.simulate(system)
    straight = fr.simulate(without(scene, "large_deformation"))
    rom = fr.reduce(system, checkpoint=out / "training")
    fr.write_rom(out / "bending.h5", rom)
    runs = {stepper: fr.simulate(rom, scene=scene, stepper=stepper) for stepper in FINITE_STRAIN_STEPPERS}
    turns = 1 if choice.quick else RUNS
    rates = {stepper: fastest(rom, scene=scene, stepper=stepper, runs=turns) for stepper in FINITE_STRAIN_STEPPERS}
    table(out / "bending.md", full, straight, runs, rates, rom)
    best = runs["linearly-implicit"]
    draw(out / "bending.png", scene, full, best, straight)

    errors = {stepper: wrong(run, full) for stepper, run in runs.items()}
    angle = np.degrees(tip_angle(full, scene)).max()
    tip = np.linalg.norm(full.outputs["tip"], axis=-1).max()
    off, balance = wrong(straight, full), max(map(gap, [full, *runs.values()]))
    claims = {
        f"the linear model is wrong by more than a tenth of the motion ({off:.2f})": off > 0.1,
        **{f"{stepper}: error below {ERROR:g} ({error:.1e})": error < ERROR for stepper, error in errors.items()},
        f"the energy account of all runs closes to 1e-10 ({balance:.0e})": balance < 1e-10,
    }
    if not choice.quick:
        faster, speed = FASTER[choice.large], rates["linearly-implicit"] / rate(full)
        real_time = rates["linearly-implicit"] * scene.run.dt
        claims |= {
            f"the tip turns by more than 60 degrees ({angle:.0f})": angle > 60,
            f"and moves by more than a third of the length ({1e3 * tip:.0f} mm)": tip > 0.1 / 3,
            f"reduced, it is at least {faster} times as fast ({speed:.0f})": speed > faster,
            f"and faster than real time ({real_time:.1f})": real_time > 1,
        }
    if "rod" in best.forces and not choice.quick:
        finer = fr.reduce(system, order=FORCE_ORDER, checkpoint=out / "training", resume=True)  # of the same runs
        pressing = {"full order": full, f"order {system.scene.reduction.order}": best}
        pressing[f"order {FORCE_ORDER}"] = pressed = fr.simulate(finer, scene=scene)
        draw_forces(out / "forces.png", pressing)
        force, peak = force_errors(pressed, full)
        held = np.linalg.norm(best.forces["rod"][-1])
        claims |= {
            f"it holds the rod ({held:.2f} N)": held > 0.05,
            f"order {FORCE_ORDER}: force over the run within {FORCE_ERROR:g} ({force:.3f})": force < FORCE_ERROR,
            f"and its peak within {PEAK_ERROR:g} ({peak:.3f})": peak < PEAK_ERROR,
        }
    for claim, holds in claims.items():
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    sys.exit(0 if all(claims.values()) else 1)


def without(scene: Scene, effect: str) -> Scene:
    """The scene without an effect."""
    return replace(scene, effects=replace(scene.effects, **{effect: None}))


def large_mesh(file: Path) -> Path:
    """The finger with about 20,000 tetrahedra."""
    import gmsh

    gmsh.initialize([], readConfigFiles=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.open(str(GEOMETRY))
    for name in ("MeshSizeMin", "MeshSizeMax"):
        gmsh.option.setNumber(f"Mesh.{name}", FINE)
    gmsh.model.mesh.generate(3)
    gmsh.write(str(file))
    gmsh.finalize()
    return file


def rate(run: fr.Trajectory) -> float:
    """Steps per second of a full-order run."""
    return run.steps / run.settings["seconds"]


def gap(run: fr.Trajectory) -> float:
    """What the energy account misses, as a share of the most that was supplied."""
    missing = run.energy - run.supplied + run.dissipated + run.lost_in_switching
    return float(np.abs(missing).max() / np.abs(run.supplied).max())


def wrong(run: fr.Trajectory, full: fr.Trajectory) -> float:
    """Relative error of the whole shape."""
    return fr.compare(run, full)["shape"].relative


def force_errors(run: fr.Trajectory, full: fr.Trajectory) -> tuple[float, float]:
    """Relative errors of what presses on the rod: over the whole run, and of the largest."""
    differences = fr.compare(run, full)
    return differences["force of rod"].relative, differences["peak force of rod"].relative


def tip_angle(run: fr.Trajectory, scene: Scene) -> Array:
    """By how much the last quarter of the upper side has turned (steps + 1,), rad."""
    line = np.array(scene.outputs["line"].points) + run.outputs["line"]
    last = line[:, -1] - line[:, -2]
    return np.arctan2(-last[:, 2], last[:, 0])


def table(
    file: Path,
    full: fr.Trajectory,
    straight: fr.Trajectory,
    runs: dict[str, fr.Trajectory],
    rates: dict[str, float],
    rom: fr.Rom,
) -> None:
    """Errors, rates and accounts."""
    assert rom.deformation is not None
    dt, models = (
        full.settings["dt"],
        [("nonlinear, full order", full, rate(full)), ("linear, full order", straight, rate(straight))],
    )
    models += [(f"nonlinear, reduced, {stepper}", run, rates[stepper]) for stepper, run in runs.items()]
    rows = [
        (
            model,
            f"{run.settings['order']:,.0f}",
            "-" if run is full else f"{wrong(run, full):.1e}",
            f"{speed:,.3g}",
            f"{speed * dt:.2g}",
            f"{speed / rate(full):,.3g}",
            f"{gap(run):.0e}",
        )
        for model, run, speed in models
    ]
    heading = ("model", "order", "error", "steps per second", "times real time", "times full order", "account")
    offline = sum(stage.seconds for stage in rom.stages)
    text = markdown(heading, rows)
    text += (
        f"\nReduced in {offline:.0f} s; {len(rom.deformation.weights)} of {rom.deformation.points_of:,} points kept, "
        f"error of their forces {rom.deformation.cubature_error:.1e}.\n"
    )
    file.write_text(text)
    print(text)


def draw(file: Path, scene: Scene, full: fr.Trajectory, reduced: fr.Trajectory, straight: fr.Trajectory) -> None:
    """Nonlinear, with the reduced model's outline over the full order, and linear, at a few instants."""
    figure = figure_class()(figsize=(10.5, 6.2), layout="constrained")
    instants = [t for t in INSTANTS if t <= full.snapshot_times[-1] + 1e-9]
    axes = figure.subplots(2, len(instants), sharey="row", squeeze=False)
    rod = None if scene.effects.contact is None else scene.effects.contact.obstacles.get("rod")
    for column, instant in enumerate(instants):
        for row, run in enumerate((full, straight)):
            ax: Any = axes[row, column]
            at = int(np.abs(run.snapshot_times - instant).argmin())
            if rod is not None:
                ax.add_patch(Circle((rod.start[0], rod.start[2]), rod.radius, facecolor="#1d4ed8", alpha=0.8))
            ax.add_patch(Rectangle((-0.008, -0.016), 0.008, 0.032, color="0.45", linewidth=0))
            draw_from_side(ax, run.nodes + run.snapshots[at], run.triangles)
            if run is full:
                outline(ax, reduced, scene, instant)
            true_to_scale(ax, (-0.009, 0.115), (-0.105, 0.024))
        axes[0, column].set_title(f"{instant:.2f} s", fontsize=10)
    axes[0, 0].set_ylabel("large deformation", fontsize=10)
    axes[1, 0].set_ylabel("linear", fontsize=10)
    for ax in axes[:, 0]:
        ax.set_axis_on()
        ax.set(xticks=[], yticks=[])
        for side in ax.spines.values():
            side.set_visible(False)
    figure.savefig(file, dpi=130)


def draw_forces(file: Path, runs: dict[str, fr.Trajectory]) -> None:
    """What presses on the rod, from its first touch on."""
    figure = figure_class()(figsize=(8, 3.2), layout="constrained")
    ax: Any = figure.subplots()
    for (name, run), color in zip(runs.items(), ("0.3", "#dc2626", "#1d4ed8"), strict=True):
        ax.plot(run.times, np.linalg.norm(run.forces["rod"], axis=1), color=color, label=name, linewidth=1.4)
    ax.set(xlim=(0.35, run.times[-1]), ylim=(0, None), xlabel="time, s", ylabel="force on the rod, N")
    ax.legend(frameon=False)
    figure.savefig(file, dpi=130)


def outline(ax: Any, run: fr.Trajectory, scene: Scene, instant: float) -> None:
    """The reduced model's upper side."""
    row = int(np.abs(run.times - instant).argmin())
    line = np.array(scene.outputs["line"].points) + run.outputs["line"][row]
    ax.plot(line[:, 0], line[:, 2], "o", color="#dc2626", markersize=5, zorder=6, label="reduced")


if __name__ == "__main__":
    warnings.simplefilter("ignore", FenicsRomWarning)  # records hold them
    main()
