"""Two soft robots that people know, pulled by cables: the diamond and the trunk, at full order and reduced.

    python demos/robots/robots.py              # a minute
    python demos/robots/robots.py --quick      # the diamond alone

Their dimensions are those published with SOFA's SoftRobots (README.md says where), their meshes are made by
meshes/robots.py. Cables pull in a way that the reduced models were not trained with. The script tables errors and
rates, and draws both robots, to scale. Everything is written to demos/robots/out/. The checks at the end fail if a
claim does not hold.
"""

import argparse
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "poke"))

from touching import check

import fenics_rom as fr
from fenics_rom.io.markdown import markdown
from fenics_rom.runtime.simulate import rate as fastest
from fenics_rom.visualization.plots.body import draw_body
from fenics_rom.visualization.tendon_routing import TendonRouting

HERE = Path(__file__).parent
MOVED = {"diamond": "top", "trunk": "tip"}  # what is looked at
RUNS = 5  # of which the fastest counts
FINER = 20  # times shorter steps, which tell what steps make
VIEWS = {"diamond": (22.0, -35.0), "trunk": (8.0, -20.0)}  # elevation and azimuth, degrees
STEPPER = "linearly-implicit"  # however long steps are beside the slowest period: see the error
ERROR, FASTER = 0.02, 20
PULLED, SLACK = "#b91c1c", "0.35"


@dataclass(frozen=True)
class Robot:
    """A robot's runs."""

    scene: fr.Scene
    full: fr.Trajectory
    rom: fr.Rom
    reduced: fr.Trajectory
    finer: fr.Trajectory  # reduced, in shorter steps
    rate: float  # steps per second of the reduced model

    @property
    def error(self) -> float:
        """Of the whole shape over the whole run, in the mass norm."""
        return fr.compare(self.reduced, self.full)["shape"].relative

    @property
    def step_error(self) -> float:
        """Of the same, by the size of the steps alone."""
        return fr.compare(self.reduced, self.finer)["shape"].relative

    @property
    def full_rate(self) -> float:
        """Steps per second at full order."""
        return self.full.steps / self.full.settings["seconds"]

    @property
    def travel(self) -> float:
        """Largest displacement of what is looked at from where the run begins, m."""
        path = self.full.outputs[MOVED[self.scene.name]][:, 0]
        return float(np.linalg.norm(path - path[0], axis=1).max())


def main() -> None:
    """Runs the demo; exits with 1 where a claim fails."""
    parser = argparse.ArgumentParser(description="The diamond and the trunk.")
    parser.add_argument("--quick", action="store_true", help="the diamond alone")
    quick = parser.parse_args().quick
    out = HERE / "out" / "quick" if quick else HERE / "out"
    out.mkdir(parents=True, exist_ok=True)
    robots = [run_robot("diamond", out, 5, 1)] if quick else [run_robot(name, out) for name in MOVED]
    table(out / "robots.md", robots)
    draw(out / "robots.png", robots)
    claims = {}
    for robot in robots:
        name, dt = robot.scene.name, robot.full.settings["dt"]
        balance = max(gap(robot.full), gap(robot.reduced))
        claims |= {
            f"{name}: error below {ERROR:g} ({robot.error:.1e})": robot.error < ERROR,
            f"{name}: the energy account closes to 1e-10 ({balance:.0e})": balance < 1e-10,
        }
        if not quick:
            claims |= {
                f"{name}: at least {FASTER} times as fast ({robot.rate / robot.full_rate:.0f})": robot.rate
                > FASTER * robot.full_rate,
                f"{name}: faster than real time ({robot.rate * dt:.1f})": robot.rate * dt > 1,
            }
    if not quick:
        far = robots[1].travel
        claims[f"the trunk's tip moves by a quarter of its length ({1e3 * far:.0f} mm)"] = far > 0.195 / 4
    check(claims)


def run_robot(name: str, out: Path, finer_by: int = FINER, runs: int = RUNS) -> Robot:
    """Runs a robot at full order and reduced."""
    scene = fr.read_scene(HERE / f"{name}.toml")
    assert scene.run is not None
    scene = replace(scene, run=replace(scene.run, snapshots=round(scene.run.duration / scene.run.dt)))
    system = fr.assemble(scene)
    print(f"{name}: {system.size:,} unknowns, {system.body.node_mass.sum():.3f} kg")
    full, rom = fr.simulate(system), fr.reduce(system)
    fr.write_rom(out / f"{name}.h5", rom)
    fine = replace(scene, run=replace(scene.run, dt=scene.run.dt / finer_by))
    reduced, finer = (fr.simulate(rom, scene=each, stepper=STEPPER) for each in (scene, fine))
    return Robot(scene, full, rom, reduced, finer, fastest(rom, scene=scene, stepper=STEPPER, runs=runs))


def gap(run: fr.Trajectory) -> float:
    """What the energy account misses, as a share of the most that was stored."""
    missing = run.energy - run.energy[0] - run.supplied + run.dissipated + run.lost_in_switching
    return float(np.abs(missing).max() / np.abs(run.energy).max())


def table(file: Path, robots: list[Robot]) -> None:
    """Errors and rates."""
    heading = (
        "robot",
        "moves by",
        "model",
        "order",
        "error",
        "steps per second",
        "times real time",
        "times full order",
    )
    rows = []
    for robot in robots:
        dt = robot.full.settings["dt"]
        models = (("full order", robot.full, robot.full_rate), ("reduced", robot.reduced, robot.rate))
        for model, run, speed in models:
            rows.append(
                (
                    robot.scene.name,
                    f"{1e3 * robot.travel:.0f} mm",
                    model,
                    f"{run.settings['order']:,.0f}",
                    "-" if run is robot.full else f"{100 * robot.error:.1f} %",
                    f"{speed:,.3g}",
                    f"{speed * dt:.2g}",
                    f"{speed / robot.full_rate:,.3g}",
                )
            )
    text = markdown(heading, rows)
    for robot in robots:
        assert robot.rom.deformation is not None
        kept, of = len(robot.rom.deformation.weights), robot.rom.deformation.points_of
        step = f"{100 * robot.step_error:.1f} %"
        text += f"\n{robot.scene.name}: {kept} of {of:,} points kept; the size of the steps makes {step}.\n"
    file.write_text(text)
    print(text)


def draw(file: Path, robots: list[Robot]) -> None:
    """Each robot at three instants, reduced, coloured by displacement, with its cables."""
    figure = plt.figure(figsize=(10.5, 4.3 * len(robots)), layout="constrained")
    for row, robot in enumerate(robots):
        run = robot.reduced
        moved = np.linalg.norm(run.snapshots, axis=2).max(axis=1)
        places = []
        for column, at in enumerate((0, int(moved.argmax()), len(moved) - 1)):
            axes: Any = figure.add_subplot(len(robots), 3, 3 * row + column + 1, projection="3d")
            surface = draw_body(axes, run.nodes, run.triangles, run.snapshots[at], largest=float(moved.max()))
            surface.set(alpha=0.5, linewidth=0.05)
            for name, points in run.tendons.items():
                pulled = name in run.inputs
                cable = TendonRouting(run.nodes, points).moved(run.snapshots[at])
                axes.plot(*cable.T, color=PULLED if pulled else SLACK, linewidth=1.6 if pulled else 0.7, clip_on=False)
            axes.text2D(0.0, 1.0, f"{robot.scene.name}, {run.snapshot_times[at]:.2f} s", transform=axes.transAxes)
            axes.view_init(*VIEWS[robot.scene.name])
            places.append(axes)
        figure.colorbar(surface, ax=places, label="displacement (m)", shrink=0.6)
    figure.savefig(file, dpi=110)


if __name__ == "__main__":
    main()
