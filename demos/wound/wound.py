"""A finger of silicone that is wound with threads twists, stretches or bends with air in it.

    python demos/wound/wound.py              # some minutes
    python demos/wound/wound.py --quick      # the finger that twists, at full order

Threads of one direction twist it. How far, a closed form says for a thick-walled tube that keeps its volume (Connolly,
Polygerinos, Walsh & Bertoldi, 2015; Connolly, Walsh & Bertoldi, 2017). With r² = a² + (R² - A²)/λ, θ = Θ + τ Z, z = λ Z
the energy by length is stationary in the inner radius a, the stretch λ and the twist τ:

    Π = ∫ 2πR μ/2 (λ_r² + λ_θ² + λ² + (r τ)² - 3) dR + Σ 2πB k/2 (λ_f - 1)² - p π (a² λ - A²),   λ_θ = r/R = 1/(λ λ_r),
    λ_f² = (λ_θ cos α + r τ sin α)² + (λ sin α)²  at the outside, where R = B, of each family of threads.

The last term is of walls and of a closed end. Everything is written to demos/wound/out/. The checks at the end fail if
a claim does not hold.
"""

import argparse
import sys
from pathlib import Path
from time import process_time
from typing import Any, NamedTuple

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from scipy.ndimage import map_coordinates
from scipy.optimize import minimize

sys.path.append(str(Path(__file__).parents[1] / "poke"))

from touching import check

import fenics_rom as fr
from fenics_rom.io.markdown import markdown
from fenics_rom.visualization.plots.body import draw_body

HERE = Path(__file__).parent
INNER, OUTER, LENGTH = 6e-3, 8e-3, 0.06  # m
TABLES = {"twisting": "air.csv", "stretching": "air.csv", "bending": "bend.csv"}
OFF, REDUCED_OFF = 0.03, 0.03  # of the twist, at full order of the closed form, and reduced of the full order
GRID = 16, 10  # nodes around the outside, and rows of them along it
TURNS = 60  # points of a thread in a turn
VIEW = 8.0, -80.0  # elevation and azimuth, degrees

Array = np.ndarray


class Tube(NamedTuple):
    """A wound tube: radii, m, shear modulus, Pa, stiffness of each family of threads, N/m, and its angles, rad."""

    inner: float
    outer: float
    shear: float
    threads: float
    angles: tuple[float, ...]


class Shape(NamedTuple):
    """Of an inflated tube."""

    radius: float  # of its inside, m
    stretch: float
    twist: float  # by length, rad/m


def closed_form(tube: Tube, pressure: float) -> Shape:
    """Where the energy is stationary at a pressure, Pa."""
    A, B = tube.inner, tube.outer
    x, w = np.polynomial.legendre.leggauss(16)
    R, w = (B + A) / 2 + (B - A) / 2 * x, w * (B - A) / 2
    α = np.array(tube.angles)

    def energy(y: Array) -> float:  # mJ/m
        a, λ, τ = y[0] * A, y[1], y[2] / B
        r, outside = (np.sqrt(a**2 + (at**2 - A**2) / λ) for at in (R, B))
        wall = (w * np.pi * R * tube.shear * ((R / (r * λ)) ** 2 + (r / R) ** 2 + λ**2 + (r * τ) ** 2 - 3)).sum()
        stretch = np.hypot(outside / B * np.cos(α) + outside * τ * np.sin(α), λ * np.sin(α))
        wound = np.pi * B * tube.threads * ((stretch - 1) ** 2).sum()
        return float(1e3 * (wall + wound - pressure * np.pi * (a**2 * λ - A**2)))

    y = minimize(energy, [1.0, 1.0, 0.0], options={"gtol": 1e-11}).x
    return Shape(y[0] * A, y[1], y[2] / B)


class Finger(NamedTuple):
    """What became of a finger."""

    scene: fr.Scene
    run: fr.Trajectory
    seconds: float  # of processor time for a step

    @property
    def pressures(self) -> Array:
        """Of each step, Pa."""
        table: Array = np.loadtxt(HERE / TABLES[self.scene.name], delimiter=",", skiprows=1)
        return table[1:, 1]

    @property
    def shapes(self) -> list[Shape]:
        """In its middle after each step: radius of the marks, stretch and twist."""
        low, high = (self.marks(name) for name in ("low", "high"))
        apart = float(np.diff([self.scene.outputs[name].points[0][2] for name in ("low", "high")]).item())
        across = [(each[:, 0] - each[:, 1]) / 2 for each in (low, high)]
        turned = [np.arctan2(each[:, 1], each[:, 0]) for each in across]
        radius = np.mean([np.linalg.norm(each, axis=1) for each in across], axis=0)
        stretch = np.linalg.norm((high - low).mean(axis=1), axis=1) / apart
        return [Shape(*each) for each in zip(radius, stretch, (turned[1] - turned[0]) / apart, strict=True)]

    @property
    def bent(self) -> float:
        """By which its end has turned sideways at last, rad."""
        top = self.run.nodes[:, 2] > LENGTH - 1e-9
        places = (self.run.nodes + self.run.snapshots[-1])[top]
        normal = np.linalg.svd(places - places.mean(axis=0))[2][2]
        return float(np.arccos(min(1.0, abs(normal[2]))))

    def marks(self, name: str) -> Array:
        """Where the marks of an output are after each step, (S, 2, 3), m."""
        found: Array = np.array(self.scene.outputs[name].points) + self.run.outputs[name]
        return found[-len(self.run.snapshots) :]


def main() -> None:
    """Runs the demo; exits with 1 where a claim fails."""
    parser = argparse.ArgumentParser(description="A finger that is wound with threads.")
    parser.add_argument("--quick", action="store_true", help="the finger that twists, at full order")
    quick = parser.parse_args().quick
    out = HERE / "out" / "quick" if quick else HERE / "out"
    out.mkdir(parents=True, exist_ok=True)
    fingers, systems = {}, {}
    for name in [*TABLES][:1] if quick else TABLES:
        scene = fr.read_scene(HERE / f"{name}.toml")
        systems[name] = fr.assemble(scene)
        begin = process_time()
        run = fr.simulate(systems[name])
        fr.write_trajectory(out / f"{name}-full.h5", run)
        fingers[name] = Finger(scene, run, (process_time() - begin) / run.steps)
        print(f"{name}: {systems[name].size:,} unknowns, {fingers[name].seconds:.3g} s of processor time for a step")
    reduced = None if quick else reduced_run(fingers["twisting"].scene, systems["twisting"], out)
    claims = table(out / "wound.md", fingers["twisting"], reduced)
    if not quick:
        claims |= others(out / "fingers.md", fingers)
        draw(out / "wound.png", fingers)
    check(claims)


def reduced_run(scene: fr.Scene, system: fr.System, out: Path) -> Finger:
    """The reduced model's run, once it is compiled."""
    rom = fr.reduce(system)
    fr.write_rom(out / "twisting.h5", rom)
    fr.simulate(rom)
    begin = process_time()
    run = fr.simulate(rom)
    finger = Finger(scene, run, (process_time() - begin) / run.steps)
    fr.write_trajectory(out / "twisting-reduced.h5", run)
    return finger


def tube_of(scene: fr.Scene) -> Tube:
    """The tube of a scene."""
    (material,) = scene.materials.values()
    threads = scene.effects.membranes["threads"]
    assert threads.helix is not None
    angles = (threads.helix.angle, -threads.helix.angle)[: 2 if threads.helix.both else 1]
    shear = material.young / (2 * (1 + material.poisson))
    return Tube(INNER, OUTER, shear, threads.stiffness, angles)


def table(file: Path, full: Finger, reduced: Finger | None) -> dict[str, bool]:
    """Twist and stretch beside the closed form; and what is claimed of them."""
    heading = ["pressure, kPa", "twist, rad/m", "closed form", "off", "stretch", "closed form"]
    rows, off, reduced_off = [], 0.0, 0.0
    if reduced is not None:
        heading += ["twist, reduced", "off the full order"]
    for k, pressure in enumerate(full.pressures):
        found, exact = full.shapes[k], closed_form(tube_of(full.scene), pressure)
        share = found.twist / exact.twist - 1
        row = [f"{1e-3 * pressure:g}", f"{found.twist:.3f}", f"{exact.twist:.3f}", f"{100 * share:.1f} %"]
        row += [f"{found.stretch:.4f}", f"{exact.stretch:.4f}"]
        off = max(off, abs(share))
        if reduced is not None:
            share = reduced.shapes[k].twist / found.twist - 1
            reduced_off = max(reduced_off, abs(share))
            row += [f"{reduced.shapes[k].twist:.3f}", f"{100 * share:.1f} %"]
        rows.append(row)
    text = markdown(heading, rows)
    claims = {f"the twist is within {100 * OFF:g} % of the closed form ({100 * off:.1f} %)": off < OFF}
    if reduced is not None:
        faster = full.seconds / reduced.seconds
        text += f"\nA step: {full.seconds:.3g} s at full order, {1e3 * reduced.seconds:.3g} ms reduced.\n"
        claims |= {
            f"reduced it is within {100 * REDUCED_OFF:g} % of the full order ({100 * reduced_off:.1f} %)": reduced_off
            < REDUCED_OFF,
            f"a reduced step is at least 10 times as fast ({faster:,.0f})": faster > 10,
        }
    file.write_text(text)
    print(text)
    return claims


def others(file: Path, fingers: dict[str, Finger]) -> dict[str, bool]:
    """What each finger does at the largest pressure; and what is claimed of it."""
    heading = (
        "finger",
        "threads",
        "pressure, kPa",
        "twist, rad/m",
        "closed form",
        "stretch",
        "closed form",
        "bends by",
    )
    rows = []
    for name, finger in fingers.items():
        tube, found = tube_of(finger.scene), finger.shapes[-1]
        exact = closed_form(tube, finger.pressures[-1])
        wound = ", ".join(f"{angle:g}" for angle in tube.angles) + " rad" + ", a sheet" * (name == "bending")
        known = ("-", "-") if name == "bending" else (f"{round(exact.twist, 2) + 0.0:.2f}", f"{exact.stretch:.4f}")
        row = [
            name,
            wound,
            f"{1e-3 * finger.pressures[-1]:g}",
            f"{found.twist:.2f}",
            known[0],
            f"{found.stretch:.4f}",
            known[1],
        ]
        rows.append([*row, f"{np.degrees(finger.bent):.1f}°"])
    text = markdown(heading, rows)
    file.write_text(text)
    print(text)
    stretching, bending = fingers["stretching"], fingers["bending"]
    exact = closed_form(tube_of(stretching.scene), stretching.pressures[-1])
    share = (stretching.shapes[-1].stretch - 1) / (exact.stretch - 1) - 1
    turned, bent = (np.degrees(angle) for angle in (LENGTH * abs(stretching.shapes[-1].twist), bending.bent))
    return {
        f"threads of both directions stretch it as the closed form says, to 3 % ({100 * share:.1f} %)": abs(share)
        < 0.03,
        f"and do not twist it ({turned:.2g}°)": turned < 0.1,
        f"with a sheet on one side it bends by more than 20° ({bent:.0f}°)": bent > 20,
    }


def draw(file: Path, fingers: dict[str, Finger]) -> None:
    """A finger at rest, and each at its largest pressure, with the threads on the side that is seen."""
    figure = plt.figure(figsize=(9.6, 4.6), layout="constrained")
    largest = max(float(np.linalg.norm(finger.run.snapshots[-1], axis=1).max()) for finger in fingers.values())
    first = fingers["twisting"]
    shown = [("at rest", first, np.zeros_like(first.run.nodes))]
    for name, finger in fingers.items():
        shown.append((f"{name}, {1e-3 * finger.pressures[-1]:g} kPa", finger, finger.run.snapshots[-1]))
    places = []
    for column, (title, finger, displacement) in enumerate(shown, start=1):
        axes: Any = figure.add_subplot(1, len(shown), column, projection="3d", computed_zorder=False)
        surface = draw_body(axes, finger.run.nodes, finger.run.triangles, displacement, largest=largest)
        surface.set(edgecolor="face", linewidth=0.1)
        outside = Outside(finger.run.nodes, displacement)
        for angle in tube_of(finger.scene).angles:
            pitch = 2 * np.pi * OUTER * abs(np.tan(angle))
            for start in np.arange(4) * np.pi / 2:
                z = np.linspace(0.0, LENGTH, int(TURNS * LENGTH / pitch))
                axes.plot(
                    *outside.seen(start + z / (OUTER * np.tan(angle)), z).T, color="white", linewidth=0.7, clip_on=False
                )
        z = np.linspace(0.0, LENGTH, TURNS)
        axes.plot(*outside.seen(np.full(TURNS, np.radians(VIEW[1])), z).T, color="crimson", linewidth=2, clip_on=False)
        low, high = finger.run.nodes.min(axis=0), finger.run.nodes.max(axis=0)
        limits = np.stack([np.subtract(low, [0.004, 0.004, 0]), np.add(high, [0.02, 0.004, 0.008])], axis=1)
        axes.set(xlim=limits[0], ylim=limits[1], zlim=limits[2])
        axes.set_box_aspect(limits[:, 1] - limits[:, 0], zoom=1.8)
        axes.view_init(*VIEW)
        axes.text2D(0.4, 1.25, title, transform=axes.transAxes, horizontalalignment="center")
        places.append(axes)
    figure.colorbar(surface, ax=places, label="displacement (m)", shrink=0.7)
    figure.savefig(file, dpi=110)


class Outside:
    """The moved outside: displacements (N, 3) of its nodes (N, 3), interpolated by splines."""

    def __init__(self, nodes: Array, displacement: Array):
        on = np.flatnonzero(np.abs(np.hypot(nodes[:, 0], nodes[:, 1]) - OUTER) < 1e-3 * OUTER)
        turn = np.round(np.arctan2(nodes[on, 1], nodes[on, 0]) / (2 * np.pi) * GRID[0]) % GRID[0]
        order = on[np.lexsort((np.round(nodes[on, 2] / LENGTH * GRID[1]), turn))]
        moved = displacement[order].reshape(GRID[0], GRID[1] + 1, 3)
        self._moved, self._middle = np.tile(moved, (3, 1, 1)), moved.mean(axis=0)

    def seen(self, angles: Array, heights: Array) -> Array:
        """Places (P, 3) of those at angles, rad, and heights, m, at rest; no numbers for those that look away."""
        at = np.stack([GRID[0] + angles / (2 * np.pi) * GRID[0] % GRID[0], heights / LENGTH * GRID[1]])
        out = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))])
        shift, middle = (
            np.column_stack([map_coordinates(of[..., k], places, order=3, mode="nearest") for k in range(3)])
            for of, places in ((self._moved, at), (self._middle, at[1:]))
        )
        elevation, azimuth = np.radians(VIEW)
        towards = np.cos(elevation) * np.array([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)])
        places = OUTER * out + np.array([0.0, 0.0, 1.0]) * heights[:, None] + shift
        places[(OUTER * out + shift - middle) @ towards < 0] = np.nan
        return places


if __name__ == "__main__":
    main()
