"""The gripper's fingers pick up a soft ball: soft on soft, with friction, beside the same at full order.

    python demos/gripper/ball.py             # some minutes
    python demos/gripper/ball.py --quick     # at one order, until the ball is lifted, without full order

Ball and fingers are reduced models; points of either meet triangles of the other. A model in all modes of a body is its
full order in other coordinates. Everything is written to demos/gripper/out/ball/. The checks at the end fail if a claim
does not hold.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from time import process_time

import numpy as np
from gripper import ASIDE, DT, FREQUENCY, GRAVITY, HEIGHT, HERE, PALM, SHAKE, SIDES, TENSION, hanging, rise, still

import fenics_rom as fr
from fenics_rom.world.recorder import WorldRecorder
from fenics_rom.world.shapes import Box, HalfSpace

RADIUS, LIFT = 0.015, 0.03  # m
CLOSED, LIFTED, END = 0.4, 0.8, 1.6  # s, when each is done; last it is shaken
ORDERS = (20, 40)
LIMIT = 0.05  # of forces and motion at the last order

Array = np.ndarray


def main() -> None:
    """Runs the demo; exits with 1 where a claim fails."""
    parser = argparse.ArgumentParser(description="A soft ball between two soft fingers.")
    parser.add_argument("--quick", action="store_true", help="at one order, without full order")
    quick = parser.parse_args().quick
    out = HERE / "out" / "ball" / ("quick" if quick else "")
    out.mkdir(parents=True, exist_ok=True)
    systems = [fr.assemble(coarse(HERE / f"{name}.toml")) for name in ("finger", "ball")]
    runs = {}
    for order in ORDERS[-1:] if quick else ORDERS:
        runs[order] = pick_up(*(fr.reduce(system, order=order) for system in systems), LIFTED if quick else END)
    run = runs[ORDERS[-1]]
    fr.write_trajectory(out / "ball.h5", run)
    fr.export(run, out / "ball.png", time=None if quick else LIFTED)
    fr.plot(run, out / "ball_forces.png", what=["energy", "forces"])
    claims = [
        ("the ball is lifted by 30 mm to 3 mm", abs(lifted(run) - LIFT) < 3e-3),
        ("the account closes to 1e-10", run.balance_error < 1e-10),
    ]
    print(f"lifted by {1e3 * lifted(run):.1f} mm of {1e3 * LIFT:g}; account: closes to {run.balance_error:.1e}")
    if not quick:
        held = run.times > LIFTED
        height = (run.bodies["ball"].pose - run.bodies["palm"].pose)[held, 2]
        print(f"shaken at {FREQUENCY:g} Hz with 0.4 g it moves by {1e3 * np.ptp(height):.3f} mm from the palm")
        claims.append(("shaken, it moves by less than 0.5 mm from the palm", float(np.ptp(height)) < 5e-4))
        is_near = compare(systems, runs)
        claims.append((f"at order {ORDERS[-1]} forces and motion are those of full order to 5 %", is_near))
    for claim, holds in claims:
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    sys.exit(0 if all(holds for _, holds in claims) else 1)


def coarse(file: Path) -> fr.Scene:
    """A scene with elements of degree 1, so that its full order is quickly there."""
    return replace(fr.read_scene(file), degree=1)


def compare(systems: list[fr.System], runs: dict[int, fr.Trajectory]) -> bool:
    """Tables runs beside that at full order; whether the last of them is near it."""
    whole = [fr.reduce(system, order=system.elastic_size, method="modal") for system in systems]
    full, finer = (pick_up(*whole, END, DT / n) for n in (1, 2))
    print("| order | grip, left | grip, right | force on the ground | motion of the ball | steps/s |")
    print("|---|---|---|---|---|---|")
    worst = np.inf
    for order, run in (("full, at half the step", finer), *runs.items(), ("full", full)):
        kept = slice(None, None, (len(run.times) - 1) // (len(full.times) - 1))  # at instants that full order has, too
        errors = [share(run.forces[name][kept], full.forces[name]) for name in NAMES]
        places = [of.bodies["ball"].pose[:, :3] - of.bodies["ball"].pose[0, :3] for of in (run, full)]
        errors.append(share(places[0][kept], places[1]))
        if run is not full:
            worst = max(errors)
        cells = " | ".join("" if run is full else f"{100 * error:.2g} %" for error in errors)
        print(f"| {order} | {cells} | {run.steps / run.settings['seconds']:.0f} |")
    return worst < LIMIT


NAMES = ["ball-left_finger", "ball-right_finger", "ground-ball"]


def pick_up(finger: fr.Rom, ball: fr.Rom, end: float, dt: float = DT) -> fr.Trajectory:
    """A run until the end, s, in steps of dt, s."""
    t = np.linspace(0, END, round(END / 0.01) + 1)
    up = LIFT * rise(t, CLOSED, LIFTED)
    fading = rise(t, LIFTED, LIFTED + 0.2) * (1 - rise(t, END - 0.2, END))
    shake = SHAKE * fading * np.sin(2 * np.pi * FREQUENCY * (t - LIFTED))
    positions = np.stack([0 * t, 0 * t, HEIGHT + PALM / 2 + up + shake], axis=1)
    palm = fr.BasePath(t, positions, np.tile([1.0, 0, 0, 0], (len(t), 1)))
    bodies: dict[str, fr.RigidBody | fr.SoftBody] = {
        "ground": fr.RigidBody(HalfSpace(), motion=still()),
        "palm": fr.RigidBody(Box((2 * ASIDE + 0.03, 0.03, PALM)), motion=palm),
        "ball": fr.SoftBody(ball, position=(0, 0, RADIUS)),
    }
    for side, sign in SIDES.items():
        place = (sign * ASIDE, 0, -PALM / 2)
        bodies[f"{side}_finger"] = fr.SoftBody(finger, on="palm", position=place, rotation=hanging(sign))
    hand = ["palm", *(f"{side}_finger" for side in SIDES)]
    apart = [hand, ["ground", *hand], ["ball", "palm"]]
    world = fr.World(bodies, dt, gravity=(0, 0, -GRAVITY), friction=0.8, apart=apart)
    steps = round(end / dt)
    recorder, begin = WorldRecorder(world, steps, snapshots=round(end / DT) // 10), process_time()
    for step in range(steps):
        pull = TENSION * rise(world.time, 0.1, CLOSED)
        world.step({f"{side}_finger": {"flexor": [pull]} for side in SIDES})
        recorder.sample(step + 1)
    return recorder.record("ball", {"seconds": process_time() - begin})


def lifted(run: fr.Trajectory) -> float:
    """How far the ball is up where the lift ends, m."""
    row = int(np.abs(run.times - LIFTED).argmin())
    return float(run.bodies["ball"].pose[row, 2] - run.bodies["ball"].pose[0, 2])


def share(ours: Array, theirs: Array) -> float:
    """How far off a history is, as a share of it, in the 2-norm."""
    return float(np.linalg.norm(ours - theirs) / np.linalg.norm(theirs))


if __name__ == "__main__":
    main()
