"""A hand throws a soft bar by one end: it tumbles, keeps its momenta to round-off, and falls on a floor.

    python demos/spin/spin.py             # two minutes
    python demos/spin/spin.py --quick     # a part of the flight

It turns about nearly the middle one of its axes. One reduced model of order 20

1. flies without weight and floor: what becomes of energy and momenta after the hand has let go, beside the same at full
   order for the first 0.3 s;
2. falls on the floor of the scene, at full order, too, until it has landed for the first time.

Everything is written to demos/spin/out/. The checks at the end fail if a claim does not hold.
"""

import argparse
import sys
import time
import warnings
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np

import fenics_rom as fr
from fenics_rom.compilation import numpy_alone
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.trajectory.comparison import Difference
from fenics_rom.visualization.figure import figure_class

HERE = Path(__file__).parent
THROWN, COMPARED = 0.05, 0.3  # s: when the hand lets go, and how long it is compared with full order
LANDED = 0.4  # s: as far as the fall is

Array = np.ndarray


def main() -> None:
    """Runs the demo; exits with 1 where a claim fails."""
    parser = argparse.ArgumentParser(description="A hand throws a soft bar.")
    parser.add_argument("--quick", action="store_true", help="a part of the flight")
    quick = parser.parse_args().quick
    out = HERE / "out" / "quick" if quick else HERE / "out"
    out.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore", FenicsRomWarning)
    scene = fr.read_scene(HERE / "spin.toml")
    assert scene.run is not None
    rom = fr.reduce(fr.assemble(scene))
    weightless = replace(scene, effects=replace(scene.effects, contact=None, gravity=None))
    flight = fr.simulate(rom, scene=shortened(weightless, 0.3 if quick else 3.0))
    fr.write_trajectory(out / "flight.h5", flight)
    claims = [
        ("flight: account closes to 1e-13", flight.balance_error < 1e-13),
        ("flight: momentum is kept to 1e-13 after the throw", changes(flight.momentum[:, :3], flight.times) < 1e-13),
        ("flight: angular momentum is kept to 1e-13", changes(flight.momentum[:, 3:], flight.times) < 1e-13),
    ]
    if not quick:
        brief = shortened(weightless, COMPARED)
        full, finer = (fr.simulate(brief, dt=scene.run.dt / n) for n in (1, 2))
        differences = beside(full, finer, fr.simulate(rom, scene=brief), ("shape", "elastic shape", "rotation"))
        claims.append(("elastic shape is right to 1 %", differences["elastic shape"].relative < 0.01))
        for detail, dt in (("full", 1e-3), ("full", 1e-2), ("quasi-rigid", 1e-3)):
            found, off = rates(rom, weightless, detail, dt)
            print(f"{detail}, steps of {1e3 * dt:g} ms: {words_of_rates(found, off)}")
            claims.append(
                (f"{detail}, steps of {1e3 * dt:g} ms: in NumPy and compiled, the same to 1e-10", off <= 1e-10)
            )
        landing = shortened(scene, LANDED)
        full, finer = (fr.simulate(landing, dt=scene.run.dt / n) for n in (1, 2))
        names = "shape", "peak force of floor", "impulse of floor"
        differences = beside(full, finer, fr.simulate(rom, scene=landing), names)
        print(f"account of the fall at full order: {full.balance_error:.0e}")
        claims += [
            ("fall at full order: account closes to 1e-11", full.balance_error < 1e-11),
            ("the floor's impulse is right to 10 %", differences["impulse of floor"].relative < 0.1),
        ]
        fall = fr.simulate(rom)
        fr.write_trajectory(out / "fall.h5", fall)
        fr.export(fall, out / "spin.gif", seconds=2.5, scale=4.0)
        lowest = (fall.nodes + fall.snapshots)[:, :, 2].min(axis=1)
        claims += [
            ("fall: account closes to 1e-12", fall.balance_error < 1e-12),
            ("fall: at last it lies on the floor, to 1 cm", abs(lowest[-1] + 0.1) < 0.01),
        ]
    draw(out / "spin.png", flight)
    for claim, holds in claims:
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    sys.exit(0 if all(holds for _, holds in claims) else 1)


def beside(
    full: fr.Trajectory, finer: fr.Trajectory, reduced: fr.Trajectory, names: Sequence[str]
) -> Mapping[str, Difference]:
    """How far the reduced run is from full order; tabled beside what the step itself makes there."""
    differences, of_step = fr.compare(reduced, full), fr.compare(finer, full)
    for name in names:
        apart = f"{differences[name].relative:.1e} from full order, which is {of_step[name].relative:.1e} from itself"
        print(f"{name}: {apart} at half the step, in the first {full.times[-1]:g} s")
    return differences


def rates(rom: fr.Rom, scene: fr.Scene, detail: str, dt: float) -> tuple[dict[str, float], float]:
    """Steps per second of the flying bar, with its account, in NumPy and compiled where numba is.

    The best of some in turns, by processor time; and how far the two are apart after the first 200 steps, as a share of
    how far the bar is bent.
    """
    bodies, places = {}, []
    for way, made in (("NumPy", numpy_alone()), *((("compiled", nullcontext()),) if fr.compiled() else ())):
        with made:
            bodies[way] = fr.Simulator(rom, dt, scene=scene, detail=detail)
        bodies[way].place(bodies[way].pose._replace(angular_velocity=np.array([1.0, 6.0, 0.5])))
    best = dict.fromkeys(bodies, 0.0)
    for _ in range(20):
        for way, body in bodies.items():
            u, start = np.zeros(body.inputs), time.process_time()
            for _ in range(200):
                body.step(u)
            best[way] = max(best[way], 200 / (time.process_time() - start))
            places.append(body.displacement())
    return best, float(np.abs(places[len(bodies) - 1] - places[0]).max() / np.abs(places[0]).max())


def words_of_rates(found: dict[str, float], off: float) -> str:
    """What `rates` gives, in words."""
    return " and ".join(f"{rate:,.0f} {way}" for way, rate in found.items()) + f" steps per second, {off:.0e} apart"


def shortened(scene: fr.Scene, duration: float) -> fr.Scene:
    """The scene for another time."""
    assert scene.run is not None
    return replace(scene, run=replace(scene.run, duration=duration))


def changes(momentum: Array, times: Array, since: float = THROWN) -> float:
    """Largest change after the throw, as a share."""
    free = momentum[times > since + 1e-9]
    return float(np.linalg.norm(free - free[0], axis=1).max() / np.linalg.norm(free[0]))


def draw(file: Path, run: fr.Trajectory) -> None:
    """Attitude, energy account, and what of energy and momenta is lost to round-off."""
    figure = figure_class()(figsize=(13, 3.8), layout="constrained")
    attitude, account, kept = figure.subplots(1, 3)
    w, x, y, z = run.pose[:, 3:].T
    long = {"x": 1 - 2 * (y**2 + z**2), "y": 2 * (x * y + w * z), "z": 2 * (x * z - w * y)}
    for name, part in long.items():
        attitude.plot(run.times, part, label=name)
    attitude.set(xlabel="time (s)", ylabel="direction of its long axis", title="it tumbles")
    for name, sums in (("stored", run.energy), ("dissipated", run.dissipated), ("supplied", run.supplied)):
        account.plot(run.times, sums, label=name)
    account.set(xlabel="time (s)", ylabel="energy (J)", title="what the hand gave it")
    free = run.times > THROWN + 1e-9
    gap = np.abs(run.energy - run.energy[0] - run.supplied + run.dissipated) / run.energy.max()
    kept.semilogy(run.times, np.maximum(gap, 1e-18), label="energy account")
    for name, part in (("momentum", run.momentum[:, :3]), ("angular momentum", run.momentum[:, 3:])):
        change = np.linalg.norm(part[free] - part[free][0], axis=1) / np.linalg.norm(part[free][0])
        kept.semilogy(run.times[free], np.maximum(change, 1e-18), label=name)
    kept.set(xlabel="time (s)", ylabel="change, as a share", title="kept to round-off", ylim=(1e-18, 1e-12))
    for axes in (attitude, account, kept):
        axes.legend(fontsize="small")
    figure.savefig(file, dpi=150)


if __name__ == "__main__":
    main()
