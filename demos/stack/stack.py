"""Ten rigid boxes on one another and a soft block on top stay where they are for a minute.

    python demos/stack/stack.py             # some minutes
    python demos/stack/stack.py --quick     # half a second of it

Everything is written to demos/stack/out/. The checks at the end fail if a claim does not hold.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from time import process_time

import numpy as np

import fenics_rom as fr
from fenics_rom.world.records import RigidBody
from fenics_rom.world.shapes import Box, HalfSpace
from fenics_rom.world.world import World

HERE = Path(__file__).parent
GRAVITY = 9.81  # m/s2


def main() -> None:
    """Runs the demo; exits with 1 where a claim fails."""
    parser = argparse.ArgumentParser(description="Boxes on one another, and a soft block.")
    parser.add_argument("--quick", action="store_true", help="half a second of it")
    quick = parser.parse_args().quick
    out = HERE / "out" / "quick" if quick else HERE / "out"
    out.mkdir(parents=True, exist_ok=True)
    world = fr.read_world(HERE / "stack.toml")
    if quick:
        world = replace(world, file=replace(world.file, run=replace(world.file.run, duration=0.5)))
    run = fr.simulate(world, rate=True)
    fr.write_trajectory(out / "stack.h5", run)
    fr.export(run, out / "stack.png")
    fr.plot(run, out / "account.png", what=["energy", "forces"])

    moved, turned = 0.0, 0.0
    for name, body in run.bodies.items():
        if name.startswith("box"):
            moved = max(moved, float(np.linalg.norm(body.pose[:, :3] - body.pose[0, :3], axis=1).max()))
            turned = max(turned, float(2 * np.sqrt(max(0.0, 1 - (body.pose[:, 3:] @ body.pose[0, 3:]).min() ** 2))))
    block, top = run.bodies["block"], run.forces["box9-block"][-1]
    crept = float(np.linalg.norm(block.pose[len(run.times) // 2 :, :3] - block.pose[-1, :3], axis=1).max())
    weight = GRAVITY * run.node_mass[block.nodes].sum()
    boxes = 10 * 0.5 * GRAVITY
    print(f"{run.steps} steps of {1e3 * run.settings['dt']:g} ms: {run.steps / run.settings['seconds']:.0f} steps/s")
    print(f"boxes: moved by at most {moved:.1e} m and {turned:.1e} rad")
    print(f"block: in the second half it moved by at most {crept:.1e} m")
    print(f"ground carries {-run.forces['ground-box0'][-1, 2]:.6f} N of {boxes + weight:.6f} N")
    print(f"account: closes to {run.balance_error:.1e}")
    measure_boxes()
    claims = [
        ("boxes stay to 1e-9 m and 1e-6 rad", moved < 1e-9 and turned < 1e-6),
        ("the soft block is carried by its weight to 1e-3", abs(top[2] / weight + 1) < 1e-3 or quick),
        ("account closes to 1e-12", run.balance_error < 1e-12),
    ]
    for claim, holds in claims:
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    sys.exit(0 if all(holds for _, holds in claims) else 1)


def measure_boxes() -> None:
    """Says how fast ten boxes alone are, upright on one another."""
    ground = np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3)
    bodies = {"ground": RigidBody(HalfSpace(), motion=fr.BaseState(*ground))}
    for k in range(10):
        bodies[f"box{k}"] = RigidBody(Box((0.1, 0.1, 0.1)), density=500, position=(0, 0, 0.05 + 0.1 * k))
    world = World(bodies, 2e-3, gravity=(0, 0, -GRAVITY), friction=0.5)
    rates = []
    for _ in range(9):
        begin = process_time()
        for _ in range(50):
            world.step()
        rates.append(50 / (process_time() - begin))
    print(f"ten boxes alone, upright, {world.touching} points push, in steps of 2 ms:")
    print(f"  {max(rates):.0f} steps per s of processor time at best, {sorted(rates)[4]:.0f} as the median")


if __name__ == "__main__":
    main()
