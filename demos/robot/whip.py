"""The arm whips a soft finger through a quarter turn in 0.3 s and stops: it bends by more than half of its length.

    python demos/robot/whip.py             # some minutes, most of them to reduce the finger
    python demos/robot/whip.py --quick     # of degree 1, until the arm stops

The finger of demos/bending points outwards from the hand. MuJoCo moves the arm and feels the finger, a model of order
30; then the same way of the hand is run at full order. Everything is written to demos/robot/out/; the models are kept
there. The checks at the end fail if a claim does not hold.
"""

import argparse
import math
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from time import process_time

import mujoco
import numpy as np
from bridge import Bridge, Robot

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.visualization.figure import figure_class
from fenics_rom.world.shapes import Box

HERE = Path(__file__).parent
ROOT, LENGTH = (0.0, 0.0, -0.1), 0.1  # m: of the finger in the hand's axes; its length
MOUNT = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])  # the finger's x along the hand, its z up
STRIDE = 8  # steps of the arm in one of the finger, so that poses and twists fit
SETTLED = 1.0  # s that the arm has to come to rest under its weight
START, WHIP, TURN = 0.3, 0.3, math.pi / 2  # s, s, rad
LAG = 0.03  # s, that the motor is behind what it is told: kv / kp
BOUNDS = {"tip in the frame": 0.01, "base force": 0.02, "base torque": 0.02}
RATE, BLOCK = 3000, 100  # steps a second at least; steps that are timed together
DRAWN = (0.3, 0.4, 0.45, 0.5, 0.58)  # s

Array = np.ndarray


def main() -> None:
    """Runs the demo; exits with 1 where a claim fails."""
    parser = argparse.ArgumentParser(description="An arm whips a soft finger.")
    parser.add_argument("--quick", action="store_true", help="of degree 1, until the arm stops")
    quick = parser.parse_args().quick
    out = HERE / "out" / "quick" if quick else HERE / "out"
    out.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore", FenicsRomWarning)  # runs hold them
    scene = fr.read_scene(HERE / "whip.toml")
    assert scene.run is not None
    if quick:
        scene = replace(scene, degree=1, run=replace(scene.run, duration=START + WHIP + 0.1))
    system = fr.assemble(scene)
    print(f"{system.size} unknowns at full order")
    if not (out / "whip.h5").is_file():
        fr.write_rom(out / "whip.h5", fr.reduce(system))
    rom = fr.read_rom(out / "whip.h5")
    path, bridge = whipped(rom, scene.run.duration, scene.run.dt)
    run = fr.simulate(rom, scene=scene, signals={"base_path": path})
    full = full_order(system, path, out / "whip_full.h5")
    rate = 0.0 if quick else steps_per_second(rom, scene, path)
    draw(out / "whip.png", full, run)
    report(run, full, bridge, rate)


def whipped(rom: fr.Rom, duration: float, dt: float) -> tuple[fr.BasePath, Bridge]:
    """Where the finger's root goes as the arm whips it, and what went between the simulators."""
    model = mujoco.MjModel.from_xml_path(str(HERE / "arm.xml"))
    model.opt.timestep = dt / STRIDE
    data = mujoco.MjData(model)
    data.qpos[:] = data.ctrl[:] = joints(0.0)
    robot = Robot(model, data)
    robot.step(round(SETTLED / model.opt.timestep))
    root = robot.motion("hand", ROOT, MOUNT)
    bodies = {"hand": fr.RigidBody(Box((0.004, 0.02, 0.02)), motion=root), "finger": fr.SoftBody(rom, on="hand")}
    bridge = Bridge(robot, fr.World(bodies, dt, gravity=(0, 0, -9.81)), {"finger": "hand"})
    steps = round(duration / dt)
    states = [root(0.0)]
    for step in range(steps):
        data.ctrl[:] = joints((step + 1) * dt)
        bridge.step({})
        states.append(root(0.0))
    return fr.BasePath(dt * np.arange(steps + 1), *map(np.array, zip(*states, strict=True))), bridge


def joints(time: float) -> Array:
    """Angles (4,) that the motors are told so that the hand lies level and turns, rad."""
    s = min(max((time - START) / WHIP, 0.0), 1.0)
    turned, rate = 10 * s**3 - 15 * s**4 + 6 * s**5, 30 * s**2 * (1 - s) ** 2 / WHIP
    return np.array([TURN * (turned + LAG * rate), -0.9, 1.8, -0.9 - math.pi / 2])


def full_order(system: fr.System, path: fr.BasePath, file: Path) -> fr.Trajectory:
    """The run of the full model along a path; the one that is kept, if it is of that path."""
    if file.is_file():
        kept = fr.read_trajectory(file)
        assert kept.pose is not None
        if len(kept.pose) == len(path.times) and np.abs(kept.pose[:, :3] - path.positions).max() < 1e-12:
            return kept
    full = fr.simulate(system, signals={"base_path": path})
    fr.write_trajectory(file, full)
    return full


def steps_per_second(rom: fr.Rom, scene: fr.Scene, path: fr.BasePath) -> float:
    """Of the whipped finger, with its account; the best of many blocks, by processor time."""
    assert scene.run is not None
    dt = scene.run.dt
    body, bases, best = fr.Simulator(rom, dt, scene=scene), [path(time) for time in path.times[1:]], 0.0
    u = np.zeros(body.inputs)
    for _ in range(10):
        body.reset()
        for first in range(0, len(bases) - BLOCK + 1, BLOCK):
            start = process_time()
            for base in bases[first : first + BLOCK]:
                body.step(u, base=base)
            best = max(best, BLOCK / (process_time() - start))
    return best


def bent(run: fr.Trajectory) -> Array:
    """Where the tip is in the frame beside where it is at rest, (S, 3), m."""
    assert run.pose is not None
    rest = np.array([LENGTH, 0.0, 0.0])
    moved = rest + run.outputs["tip"][:, 0]
    return np.array([(x - p[:3]) @ rotation_matrix(p[3:]) for x, p in zip(moved, run.pose, strict=True)]) - rest


def draw(file: Path, full: fr.Trajectory, run: fr.Trajectory) -> None:
    """The finger as it is whipped, where the tip goes in the frame, and what the hand puts on the finger."""
    figure = figure_class()(figsize=(14, 4.4), layout="constrained")
    plan, tip, torque = figure.subplots(1, 3, width_ratios=[1.1, 1, 1])
    for k, time in enumerate(DRAWN):
        at = np.abs(full.snapshot_times - time).argmin()
        moved = 1e3 * (full.nodes + full.snapshots[at])
        plan.triplot(moved[:, 0], moved[:, 1], full.triangles, color=f"{0.75 - 0.15 * k:.2f}", linewidth=0.4)
        outline = 1e3 * (run.nodes + run.snapshots[at])
        plan.plot(outline[::19, 0], outline[::19, 1], ".", color="C3", markersize=3)
        plan.annotate(f"{time:g} s", moved[np.argmax(full.nodes[:, 0])][:2], fontsize=8)
    plan.set(xlabel="x (mm)", ylabel="y (mm)", title="full order from above; in red order 30", aspect="equal")
    there = bent(full), bent(run)
    for axis, name in ((1, "along the turn"), (2, "up")):
        tip.plot(full.times, 1e3 * there[0][:, axis], color=f"C{axis}", linewidth=4, alpha=0.35)
        tip.plot(run.times, 1e3 * there[1][:, axis], color=f"C{axis}", linewidth=1, label=name)
    tip.set(ylabel="mm", title="the tip in the hand's axes; broad: full order")
    assert full.base_wrench is not None
    assert run.base_wrench is not None
    torque.plot(full.times, 1e3 * full.base_wrench[:, 5], color="C0", linewidth=4, alpha=0.35, label="full order")
    torque.plot(run.times, 1e3 * run.base_wrench[:, 5], color="C0", linewidth=1, label="order 30")
    torque.set(ylabel="mN m", title="torque about the vertical at the finger's root")
    for axes in (tip, torque):
        axes.axvspan(START, START + WHIP, color="0.92", zorder=0)
        axes.set(xlabel="time (s)")
        axes.legend(fontsize="small")
    figure.savefig(file, dpi=130)


def report(run: fr.Trajectory, full: fr.Trajectory, bridge: Bridge, rate: float) -> None:
    """Says how it went, and exits."""
    moved, differences, account = bent(full), fr.compare(run, full), bridge.account
    errors = {"tip in the frame": float(np.linalg.norm(bent(run) - moved) / np.linalg.norm(moved))}
    errors |= {name: differences[name].relative for name in ("base force", "base torque")}
    most, farthest = np.abs(bent(run) - moved).max(), np.linalg.norm(moved, axis=1).max()
    print(f"{full.times[-1]:g} s in steps of {1e3 * run.settings['dt']:g} ms: the tip bends by {1e3 * farthest:.1f} mm")
    print(f"it is at most {1e3 * most:.2f} mm from full order")
    print(f"account: {run.balance_error:.0e}, at full order {full.balance_error:.0e}")
    print(
        f"the coupling passed {1e3 * account.passed:.0f} mJ, and its delay added {1e3 * account.added:.1f} mJ to them"
    )
    claims = [
        (f"{name}: {error:.2%} off, at most {BOUNDS[name]:.0%}", error <= BOUNDS[name])
        for name, error in errors.items()
    ]
    claims += [
        ("the account closes to 1e-12", run.balance_error < 1e-12),
        ("the tip bends by more than a third of the finger's length", farthest > LENGTH / 3),
    ]
    if rate:
        print(f"{rate:,.0f} steps per second")
        claims.append((f"at least {RATE:,} steps per second", rate >= RATE))
    for claim, holds in claims:
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    sys.exit(0 if all(holds for _, holds in claims) else 1)


if __name__ == "__main__":
    main()
