"""The energy account of a world over many steps with impacts, friction, switches and joints.

    python demos/account/account.py --few --steps 100000      # 5 min
    python demos/account/account.py                     # 20,000 of them, 5 min
    python demos/account/account.py --quick             # a thousand

Boxes and a ball are thrown about in a shallow pit whose four walls are shaken, a pendulum of two boxes on hinges
swings, and a ball on rails strikes a soft plate now in its middle, now at its tip. The check at the end fails if the
account does not close. With --few there is one box, on one wall, which lies flat.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

import fenics_rom as fr
from fenics_rom.world.joints import hinge
from fenics_rom.world.records import RigidBody, SoftBody
from fenics_rom.world.shapes import Box, HalfSpace, Sphere
from fenics_rom.world.world import World

HERE = Path(__file__).parent
DT, STEPS, QUICK = 2e-3, 20_000, 1_000  # s
SLOPE, SHAKEN, FREQUENCY = 0.06, 0.02, 4.0  # rad, of the walls; m and Hz
RADIUS, STRUCK = 0.3, 0.002  # m: of the ball on rails, and how deep it goes into the plate

Array = np.ndarray


def main() -> None:
    """Runs the demo; exits with 1 where the account does not close."""
    parser = argparse.ArgumentParser(description="The account of a long run.")
    parser.add_argument("--quick", action="store_true", help="a thousand steps")
    parser.add_argument("--steps", type=int, default=STEPS, help="how many")
    parser.add_argument("--few", action="store_true", help="fewer bodies")
    options = parser.parse_args()
    steps = QUICK if options.quick else options.steps
    world = make_world(options.few)
    plate, start, modes, most, worst = world.simulator("plate"), balance(world), 0, 0, 0.0
    mode = plate.contact
    print("steps       account, of what was dissipated   dissipated (J)  by friction  in impacts  switches")
    for step in range(1, steps + 1):
        world.step()
        modes, mode, most = modes + (plate.contact != mode), plate.contact, max(most, world.touching)
        if step % 500:
            continue
        account = world.ledger
        gap = abs(balance(world) - start) / account.dissipated
        worst = max(worst, gap)
        if step == QUICK or step % 10_000 == 0:
            by = f"{account.friction:11.4g}  {account.contact:10.4g}"
            print(f"{step:7d}  {gap:34.1e}  {account.dissipated:14.4g}  {by}  {modes:8d}", flush=True)
    print(f"at most {most} points pushed; the largest that the account was off: {worst:.1e}")
    for text in world.warnings:
        print(text)
    holds = worst < 1e-10 and modes > 1
    print(f"  {'holds' if holds else 'FAILS'}: the account closes to 1e-10 of what was dissipated, with switches")
    sys.exit(0 if holds else 1)


def balance(world: World) -> float:
    """What is to stay as it is, J."""
    account = world.ledger
    gone = account.dissipated + account.lost_in_switching + account.numerical
    return world.energy - account.supplied + gone


def make_world(few: bool = False) -> World:
    """The world where it begins."""
    bodies: dict[str, RigidBody | SoftBody] = {
        "plate": SoftBody(fr.reduce(fr.assemble(fr.read_scene(HERE / "plate.toml"))), position=(2.0, 0, 0)),
        "striker": RigidBody(Sphere(RADIUS), motion=strikes),
        "box": RigidBody(Box((0.1, 0.08, 0.06)), density=500, position=(0, 0, 0.3), angular_velocity=(1, 2, 3)),
        "heavy": RigidBody(Box((0.1, 0.1, 0.1)), density=8000, position=(0.15, 0, 0.45), angular_velocity=(2, 0, 1)),
        "ball": RigidBody(Sphere(0.05), density=100, position=(-0.15, 0.05, 0.4)),
        "upper": RigidBody(Box((0.05, 0.05, 0.3)), density=700, position=(-3.0, 0, 1.85), angular_velocity=(0, 2, 0)),
        "lower": RigidBody(Box((0.05, 0.05, 0.3)), density=700, position=(-3.0, 0, 1.55)),
    }
    if few:
        del bodies["heavy"], bodies["ball"]
    walls, half = [], 0.0 if few else SLOPE / 2
    for k in range(1 if few else 4):
        angle = k * np.pi / 2
        # z of a wall leans towards the middle of the pit
        lean = np.array([np.cos(half), -np.sin(half) * np.sin(angle), np.sin(half) * np.cos(angle), 0])
        bodies[f"wall{k}"] = RigidBody(HalfSpace(), motion=lambda t, lean=lean: shaken(t, lean))
        walls.append(f"wall{k}")
    others = {"plate", "striker", "upper", "lower"}
    apart = [walls, *([name, other] for name in bodies for other in others if {name, other} != {"plate", "striker"})]
    return World(
        bodies,
        DT,
        gravity=(0, 0, -9.81),
        friction=0.4,
        restitution=0.3,
        joints=[
            hinge("upper", "world", (-3.0, 0, 2.0), (0, 0.1, 0)),
            hinge("upper", "lower", (-3, 0, 1.7), (0.1, 0, 0)),
        ],
        apart=apart,
    )


def shaken(time: float, lean: Array) -> fr.BaseState:
    """A wall, up and down."""
    rate = 2 * np.pi * FREQUENCY
    place, velocity = SHAKEN * np.sin(rate * time), SHAKEN * rate * np.cos(rate * time)
    return fr.BaseState(np.array([0, 0, place]), lean, np.array([0, 0, velocity]), np.zeros(3))


def strikes(time: float) -> fr.BaseState:
    """The ball on rails: to and fro along the plate, up and down upon it."""
    along, down = 2 * np.pi * 0.31, 2 * np.pi * 1.7
    x, z = 2.35 + 0.12 * np.sin(along * time), 0.01 + RADIUS - STRUCK + 0.02 * (1 + np.cos(down * time))
    velocity = np.array([0.12 * along * np.cos(along * time), 0, -0.02 * down * np.sin(down * time)])
    return fr.BaseState(np.array([x, 0.1, z]), np.array([1.0, 0, 0, 0]), velocity, np.zeros(3))


if __name__ == "__main__":
    main()
