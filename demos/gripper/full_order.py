"""The grip of reduced fingers against that of fingers at full order: forces, and how the box moves.

    python demos/gripper/full_order.py             # some minutes, 3 GB of memory
    python demos/gripper/full_order.py --quick     # with elements of degree 1

A model in all modes of a finger is its full order in other coordinates: nothing is reduced, and the same world takes
the same steps with the same contact. Both grip the box and lift it. The checks at the end fail if a claim does not
hold.
"""

import argparse
import sys
from dataclasses import replace
from time import process_time

import numpy as np
from gripper import DT, HERE, LIFTED, SIDES, TENSION, gripper, rise

import fenics_rom as fr
from fenics_rom.world.recorder import WorldRecorder

ORDERS = (10, 20, 40)
LIMIT = 0.05  # of forces and motion at the last order

Array = np.ndarray


def main() -> None:
    """Runs the comparison; exits with 1 where a claim fails."""
    parser = argparse.ArgumentParser(description="A soft gripper against its full order.")
    parser.add_argument("--quick", action="store_true", help="with elements of degree 1")
    scene = fr.read_scene(HERE / "finger.toml")
    system = fr.assemble(replace(scene, degree=1) if parser.parse_args().quick else scene)
    rom = fr.reduce(system, order=system.elastic_size, method="modal")
    reference, rate = lift(rom)
    print(f"full order, {system.size} unknowns a finger: {rate:.1f} steps per s of processor time")
    print("| order | grip, left | grip, right | force on the ground | motion of the box | turn of the box | steps/s |")
    print("|---|---|---|---|---|---|---|")
    for order in ORDERS:
        run, rate = lift(fr.reduce(system, order=order))
        errors = [share(run.forces[name], reference.forces[name]) for name in NAMES]
        ours, theirs = (of.bodies["box"].pose for of in (run, reference))
        moved = share(ours[:, :3] - ours[0, :3], theirs[:, :3] - theirs[0, :3])
        turned = 2 * np.degrees(np.abs(ours[:, 4:] - theirs[:, 4:]).max())
        cells = " | ".join(f"{100 * error:.2g} %" for error in (*errors, moved))
        print(f"| {order} | {cells} | {turned:.1g}° | {rate:.0f} |")
        worst = max(*errors, moved)
    claims = [
        (f"at order {ORDERS[-1]} forces and motion are those of full order to {100 * LIMIT:g} %", worst < LIMIT),
        ("the account of full order closes to 1e-10", reference.balance_error < 1e-10),
    ]
    for claim, holds in claims:
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    sys.exit(0 if all(holds for _, holds in claims) else 1)


NAMES = [*(f"box-{side}_finger" for side in SIDES), "ground-box"]


def lift(rom: fr.Rom) -> tuple[fr.Trajectory, float]:
    """A run up to the lift, and its steps in a second of processor time."""
    world = gripper(rom)
    steps = round((LIFTED + 0.1) / DT)
    recorder = WorldRecorder(world, steps, snapshots=1)
    begin = process_time()
    for step in range(steps):
        pull = TENSION * rise(world.time, 0.1, 0.4)
        world.step({f"{side}_finger": {"flexor": [pull]} for side in SIDES})
        recorder.sample(step + 1)
    return recorder.record("lift"), steps / (process_time() - begin)


def share(ours: Array, theirs: Array) -> float:
    """How far off a history is, as a share of it, in the 2-norm."""
    return float(np.linalg.norm(ours - theirs) / np.linalg.norm(theirs))


if __name__ == "__main__":
    main()
