"""Two fingers bend by 60 degrees round a ball, press it on the palm, and carry it through half a turn upside down.

    python demos/gripper/wrap.py             # some minutes
    python demos/gripper/wrap.py --quick     # until the ball is turned; without full order, and no rate is claimed

The fingers deform largely: models of order 30. What a ball and a rod do to such a finger that bends round them is
compared with full order; the rod while the palm turns round it. Everything is written to demos/gripper/out/wrap/, where
the model is kept. The checks at the end fail if a claim does not hold.
"""

import argparse
import sys
import warnings
from dataclasses import replace
from time import process_time

import numpy as np
from gripper import DT, GRAVITY, HERE, PALM, SIDES, hanging, rise

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.mechanics.frame_motion import quaternion_of_vector, rotation_matrix
from fenics_rom.world.recorder import WorldRecorder
from fenics_rom.world.shapes import Box, Sphere

RADIUS, DENSITY, ASIDE, TENSION = 0.03, 200.0, 0.058, 24.0  # m, kg/m3; m: of the fingers' axes from the middle; N
CLOSED, ALONE, BEGUN, TURNED, SETTLED, END = 0.5, 0.8, 0.9, 1.9, 2.5, 12.5  # s, when each is done
ANGLE, CREEP, FORCES, RATE = 60, 1e-6, 0.05, 300  # degrees, m in 10 s, share, steps a second
BLOCK = 50  # steps that are timed together

Array = np.ndarray


def main() -> None:
    """Runs the demo; exits with 1 where a claim fails."""
    parser = argparse.ArgumentParser(description="Soft fingers wrap round a ball.")
    parser.add_argument("--quick", action="store_true", help="until the ball is turned, without full order")
    quick = parser.parse_args().quick
    out = HERE / "out" / "wrap"
    out.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore", FenicsRomWarning)  # runs hold them
    scene = fr.read_scene(HERE / "wrap.toml")
    if not (out / "wrap.h5").is_file():
        fr.write_rom(out / "wrap.h5", fr.reduce(fr.assemble(scene)))
    rom = fr.read_rom(out / "wrap.h5")
    run, angles, places, rate = carried(rom, SETTLED if quick else END)
    fr.export(run, out / "wrap.png", time=TURNED)
    print(f"account: {run.balance_error:.0e}; {rate:.0f} steps per second of {1e3 * DT:g} ms")
    moved = np.linalg.norm(places[round(TURNED / DT) - 1] - places[round(BEGUN / DT) - 1])
    print(f"turned upside down, the ball has moved by {1e3 * moved:.2f} mm from the palm")
    claims = [
        (f"both tips turn by more than {ANGLE} degrees ({min(angles):.1f})", min(angles) > ANGLE),
        ("the ball is carried through half a turn, to 1 mm", bool(moved < 1e-3)),
        ("the account closes to 1e-12", run.balance_error < 1e-12),
    ]
    if not quick:
        creep = float(np.ptp(places[round(SETTLED / DT) :], axis=0).max())
        claims.append((f"it creeps by less than 1 um in 10 s ({creep:.0e} m)", creep < CREEP))
        claims.append((f"at least {RATE} steps per second", rate >= RATE))
        claims += [
            (f"{name}: the force over the run is within {FORCES:.0%} of full order ({error:.1%})", error < FORCES)
            for name, error in beside_full_order(rom, scene).items()
        ]
    for claim, holds in claims:
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    sys.exit(0 if all(holds for _, holds in claims) else 1)


def turning(center: Array, place: Array, end: float, begun: float, turned: float) -> fr.BasePath:
    """Of a base at a place that turns by half a turn about y round a centre."""
    t = np.linspace(0, end, round(end / 0.01) + 1)
    rotations = np.array([quaternion_of_vector((0, angle, 0)) for angle in np.pi * rise(t, begun, turned)])
    positions = np.array([center + rotation_matrix(rotation) @ (place - center) for rotation in rotations])
    return fr.BasePath(t, positions, rotations)


def carried(rom: fr.Rom, end: float) -> tuple[fr.Trajectory, list[float], Array, float]:
    """The run, angles of the tips (degrees), the ball in the palm's axes after each step, m, and steps a second.

    A post bears the ball until the fingers have closed.
    """
    t = np.linspace(0, end, round(end / 0.01) + 1)
    down = np.stack([0 * t, 0 * t, -RADIUS - 0.01 - 0.1 * rise(t, CLOSED + 0.1, ALONE)], axis=1)
    palm = turning(np.zeros(3), np.array([0, 0, RADIUS + PALM]), end, BEGUN, TURNED)
    post = fr.BasePath(t, down, np.tile([1.0, 0, 0, 0], (len(t), 1)))
    bodies: dict[str, fr.RigidBody | fr.SoftBody] = {
        "post": fr.RigidBody(Box((0.008, 0.02, 0.02)), motion=post),
        "palm": fr.RigidBody(Box((2 * ASIDE + 0.03, 0.03, PALM)), motion=palm),
        "ball": fr.RigidBody(Sphere(RADIUS), density=DENSITY),
    }
    fingers = [f"{side}_finger" for side in SIDES]
    for name, sign in zip(fingers, SIDES.values(), strict=True):
        place = (sign * ASIDE, 0, -PALM / 2)
        bodies[name] = fr.SoftBody(rom, on="palm", position=place, rotation=hanging(sign))
    hand = ["palm", *fingers]
    world = fr.World(bodies, DT, gravity=(0, 0, -GRAVITY), friction=0.8, apart=[hand, ["post", *hand]])
    steps = round(end / DT)
    recorder, places, spent = WorldRecorder(world, steps, snapshots=steps // 25), list[Array](), np.zeros(steps)
    for step in range(steps):
        pull, begin = TENSION * rise(world.time, 0.1, CLOSED), process_time()
        world.step({name: {"flexor": [pull]} for name in fingers})
        spent[step] = process_time() - begin
        recorder.sample(step + 1)
        ball, base = world.pose("ball"), world.pose("palm")
        places.append((ball.position - base.position) @ rotation_matrix(base.rotation))
    angles = [tip_angle(world.simulator(name)) for name in fingers]
    after = spent[round(ALONE / DT) :]
    rate = BLOCK / after[: len(after) // BLOCK * BLOCK].reshape(-1, BLOCK).sum(axis=1).min()
    return recorder.record("wrap", {"seconds": spent.sum()}), angles, np.array(places), float(rate)


def tip_angle(finger: fr.Simulator) -> float:
    """By how much the last quarter of the upper side has turned towards the palm's middle, degrees."""
    assert finger.pose is not None
    line = np.array([[0.075, 0, 0.01], [0.1, 0, 0.01]]) + finger.displacement("line")
    (x, _, z) = (line[1] - line[0]) @ rotation_matrix(finger.pose.rotation)
    return float(np.degrees(np.arctan2(-z, x)))


def beside_full_order(rom: fr.Rom, scene: fr.Scene) -> dict[str, float]:
    """How far the force over a run is off at order 30: of a ball in a hand that stands, of a rod in one that turns."""
    contact = scene.effects.contact
    assert contact is not None
    assert scene.run is not None
    ball = contact.obstacles["ball"]
    assert ball.center is not None
    x, _, z = center = np.array(ball.center)
    rod = replace(ball, shape="capsule", center=None, start=(x, -0.02, z), end=(x, 0.02, z))
    smooth = replace(scene.effects, friction=None, contact=replace(contact, obstacles={"ball": rod}))
    turned = replace(scene, effects=smooth, run=replace(scene.run, duration=1.6))
    path, errors = turning(center, np.zeros(3), 1.6, 0.5, 1.5), {}
    for name, of, signals in (("ball", scene, None), ("rod, turned", turned, {"base_path": path})):
        full, run = fr.simulate(of, signals=signals), fr.simulate(rom, scene=of, signals=signals)
        errors[name] = fr.compare(run, full)["force of ball"].relative
    return errors


if __name__ == "__main__":
    main()
