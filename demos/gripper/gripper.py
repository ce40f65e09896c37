"""Two soft fingers on a palm pick up a free box, lift it, shake it, turn it by 90 degrees, and put it down.

    python demos/gripper/gripper.py             # some minutes
    python demos/gripper/gripper.py --quick     # up to the lift

Each finger is a reduced model of order 40 with a tendon, carried by the palm; the box is rigid and free, and nothing
but friction holds it. Everything is written to demos/gripper/out/. The checks at the end fail if a claim does not hold.
"""

import argparse
import cProfile
import pstats
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import process_time

import numpy as np

import fenics_rom as fr
from fenics_rom.mechanics.frame_motion import quaternion_of, quaternion_of_vector
from fenics_rom.world.recorder import WorldRecorder
from fenics_rom.world.records import RigidBody, SoftBody
from fenics_rom.world.shapes import Box, HalfSpace
from fenics_rom.world.world import World

HERE = Path(__file__).parent
DT = 2e-3  # s
EDGE, DENSITY, GRAVITY = 0.03, 400.0, 9.81  # m, kg/m3, m/s2
HEIGHT, ASIDE = 0.108, EDGE / 2 + 0.0115  # m: of the fingers' roots; of their axes from the middle, 1.5 mm of air
PALM = 0.012  # m, thick
TENSION = 4.0  # N
CLOSED, LIFTED, SHAKEN, TURNED, BACK, DOWN, OPENED, END = 0.4, 0.9, 1.7, 2.3, 2.9, 3.4, 3.7, 4.0  # s, when each is done
LIFT, SHAKE, FREQUENCY = 0.08, 0.004, 5.0  # m, m, Hz: 0.4 g
SIDES = {"left": -1.0, "right": 1.0}

Array = np.ndarray


def main() -> None:
    """Runs the demo; exits with 1 where a claim fails."""
    parser = argparse.ArgumentParser(description="A soft gripper.")
    parser.add_argument("--quick", action="store_true", help="up to the lift")
    quick = parser.parse_args().quick
    out = HERE / "out" / "quick" if quick else HERE / "out"
    out.mkdir(parents=True, exist_ok=True)
    rom_file = HERE / "out" / "finger.h5"
    if not rom_file.is_file():
        fr.write_rom(rom_file, fr.reduce(fr.assemble(fr.read_scene(HERE / "finger.toml"))))
    rom = fr.read_rom(rom_file)
    steps = round((LIFTED + 0.1 if quick else END) / DT)
    world = gripper(rom)
    recorder = WorldRecorder(world, steps, snapshots=steps // 10)
    spent, touching, sweeps = 0.0, [], []
    for step in range(steps):
        begin = process_time()
        pull = TENSION * rise(world.time, 0.1, CLOSED) * (1 - rise(world.time, DOWN, OPENED))
        world.step({f"{side}_finger": {"flexor": [pull]} for side in SIDES})
        spent += process_time() - begin
        touching.append(world.touching)
        sweeps.append(world.sweeps)
        recorder.sample(step + 1)
    run = recorder.record("gripper", {"seconds": spent})
    print(f"{steps} steps of {1e3 * DT:g} ms: {steps / spent:.0f} steps per s of processor time")
    print(f"at most {max(touching)} points push; {np.mean(sweeps):.1f} sweeps a step, at most {max(sweeps)}")
    fr.write_trajectory(out / "gripper.h5", run)
    fr.export(run, out / "gripper.gif", seconds=run.times[-1])
    fr.export(run, out / "gripper.png", time=None if quick else TURNED)
    fr.plot(run, out / "account.png", what=["energy", "forces"])
    if not quick:
        measure_rates(rom)
    report(run, quick)


def gripper(rom: fr.Rom) -> World:
    """The world where it begins."""
    bodies: dict[str, RigidBody | SoftBody] = {
        "ground": RigidBody(HalfSpace(), motion=still()),
        "palm": RigidBody(Box((2 * ASIDE + 0.03, 0.03, PALM)), motion=path()),
        "box": RigidBody(Box((EDGE, EDGE, EDGE)), density=DENSITY, position=(0, 0, EDGE / 2)),
    }
    for side, sign in SIDES.items():
        place = (sign * ASIDE, 0, -PALM / 2)
        bodies[f"{side}_finger"] = SoftBody(rom, on="palm", position=place, rotation=hanging(sign))
    fingers = [f"{side}_finger" for side in SIDES]
    return World(
        bodies,
        DT,
        gravity=(0, 0, -GRAVITY),
        friction=0.8,
        apart=[["palm", *fingers], ["ground", *fingers], ["box", "palm"]],
    )


def hanging(sign: float) -> Array:
    """How a finger is turned whose axis x hangs down, and whose lower side, -z, looks at the other one."""
    return quaternion_of(np.array([[0, 0, sign], [0, sign, 0], [-1, 0, 0]], dtype=float))


def rise(time: float | Array, begin: float, end: float) -> Array:
    """From 0 to 1, smoothly."""
    s = np.clip((np.asarray(time) - begin) / (end - begin), 0, 1)
    return s**3 * (10 - 15 * s + 6 * s**2)


def path() -> fr.BasePath:
    """Of the palm."""
    t = np.linspace(0, END, round(END / 0.01) + 1)
    up = LIFT * rise(t, CLOSED, LIFTED) * (1 - rise(t, BACK, DOWN))
    fading = rise(t, LIFTED, LIFTED + 0.2) * (1 - rise(t, SHAKEN - 0.2, SHAKEN))
    shake = SHAKE * fading * np.sin(2 * np.pi * FREQUENCY * (t - LIFTED))
    angle = np.pi / 2 * rise(t, SHAKEN, TURNED) * (1 - rise(t, TURNED, BACK))
    positions = np.stack([0 * t, 0 * t, HEIGHT + PALM / 2 + up + shake], axis=1)
    return fr.BasePath(t, positions, np.array([quaternion_of_vector((a, 0, 0)) for a in angle]))


def still() -> fr.BaseState:
    """At the origin."""
    return fr.BaseState(np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))


def measure_rates(carried: fr.Rom) -> None:
    """Says how fast two fingers hold the box, and what a step of theirs consists of.

    Fingers that close from a distance touch with their tips; those that begin at the box lie on it with more points.
    """
    scene = fr.read_scene(HERE / "finger.toml")
    scene = replace(scene, frame="fixed", effects=replace(scene.effects, gravity=None))
    held = fr.reduce(fr.assemble(scene))
    print("| fingers | points that push | steps per s of processor time, best | median of 16 times 25 |")
    print("|---|---|---|---|")
    flat, waiting = EDGE / 2 + 0.0101, shaken(0.0)
    for name, rom, motion, aside, tension in (
        ("held, by their tips", held, None, ASIDE, TENSION),
        ("held, flat", held, None, flat, TENSION / 2),
        ("carried, flat", carried, lambda time: waiting, flat, TENSION / 2),
        ("carried and shaken, by their tips", carried, shaken, ASIDE, TENSION),
        ("carried and shaken, flat", carried, shaken, flat, TENSION / 4),
    ):
        world = grip(rom, motion, aside)

        def step(count: int, world: World = world, tension: float = tension) -> float:
            begin = process_time()
            for _ in range(count):
                pull = [tension * min(world.time / 0.2, 1.0)]
                world.step({f"{side}_finger": {"flexor": pull} for side in SIDES})
            return count / (process_time() - begin)

        step(350)
        touching, rates = list[int](), list[float]()
        for _ in range(16):
            rates.append(step(25))
            touching.append(world.touching)
        rates.sort()
        print(f"| {name} | {np.mean(touching):.0f} | {rates[-1]:.0f} | {rates[8]:.0f} |")
        profile = cProfile.Profile()
        profile.runcall(step, 200)
    spent = {f"{Path(file).stem}.{name}": row[3] for (file, _, name), row in pstats.Stats(profile).stats.items()}  # type: ignore[attr-defined]

    def seconds(*names: str) -> float:
        return sum(spent.get(name, 0.0) for name in names)

    parts = {
        "bodies begin": seconds("world._begin", "world_step.begin_step") - seconds("step_pairs.of_step"),
        "where they touch": seconds("step_pairs.of_step", "near.look_at_margins", "near.find_near"),
        "the forces of contact": seconds("contact_step.find_forces", "forces.find_forces"),
        "bodies end": seconds("soft.close", "soft.commit", "rigid.commit", "world_step.end_step", "soft.end_compiled"),
    }
    print(
        "of a step of the last: ",
        ", ".join(f"{name} {share / spent['world.step']:.0%}" for name, share in parts.items()),
    )


def grip(rom: fr.Rom, motion: Callable[[float], fr.BaseState] | None, aside: float) -> World:
    """Two fingers, held or on a palm that moves, and the box between them, without weight."""
    bodies: dict[str, RigidBody | SoftBody] = {
        "box": RigidBody(Box((EDGE,) * 3), density=DENSITY, position=(0, 0, EDGE / 2))
    }
    if motion is not None:
        bodies["palm"] = RigidBody(Box((2 * aside + 0.03, 0.03, PALM)), motion=motion)
    for side, sign in SIDES.items():
        on, height = ("palm", -PALM / 2) if motion is not None else (None, HEIGHT)
        bodies[f"{side}_finger"] = SoftBody(rom, on=on, position=(sign * aside, 0, height), rotation=hanging(sign))
    others = [name for name in bodies if name != "box"]
    return World(bodies, DT, friction=0.8, apart=[others] + [["box", "palm"]] * (motion is not None))


def shaken(time: float) -> fr.BaseState:
    """The palm at 5 Hz with 0.4 g, from rest on."""
    ω, still = 2 * np.pi * FREQUENCY, np.array([1.0, 0, 0, 0])
    height, speed = SHAKE * (1 - np.cos(ω * time)), SHAKE * ω * np.sin(ω * time)
    return fr.BaseState(np.array([0, 0, HEIGHT + PALM / 2 + height]), still, np.array([0, 0, speed]), np.zeros(3))


def report(run: fr.Trajectory, quick: bool) -> None:
    """Says how it went, and exits."""
    weight = DENSITY * EDGE**3 * GRAVITY
    box = run.bodies["box"].pose
    palm = run.bodies["palm"].pose
    held = (run.times > LIFTED) & (run.times < SHAKEN)
    height = box[:, 2] - palm[:, 2]
    grip = {side: run.forces[f"box-{side}_finger"] for side in SIDES}
    lifted = int(np.abs(run.times - LIFTED).argmin())
    print(f"the box weighs {weight:.4f} N; grip of each finger after the lift: {abs(grip['left'][lifted, 0]):.3f} N")
    print(f"lifted by {1e3 * (box[lifted, 2] - box[0, 2]):.1f} mm of {1e3 * LIFT:g}")
    print(f"account: closes to {run.balance_error:.1e}")
    claims = [
        ("the box is lifted by 80 mm to 3 mm", abs(box[lifted, 2] - box[0, 2] - LIFT) < 3e-3),
        ("account closes to 1e-10", run.balance_error < 1e-10),
    ]
    if not quick:
        slip = 1e3 * (height[held].max() - height[held].min())
        strength = SHAKE * (2 * np.pi * FREQUENCY) ** 2 / GRAVITY
        turn = 2 * np.degrees(np.arccos(abs(box[np.abs(run.times - TURNED).argmin(), 3])))
        print(f"shaken at {FREQUENCY:g} Hz with {strength:.2f} g: it moves by {slip:.3f} mm from the palm")
        print(f"turned by {turn:.1f} degrees")
        print(f"it began at {1e3 * box[0, :3]} mm, and lies at {1e3 * box[-1, :3]} mm")
        claims += [
            ("shaken, it moves by less than 0.1 mm from the palm", slip < 0.1),
            ("it turns with the palm to 5 degrees", abs(turn - 90) < 5),
            ("it is put down on its face to 1 mm", abs(box[-1, 2] - EDGE / 2) < 1e-3),
            ("and within 0.1 mm of where it was", np.linalg.norm(box[-1, :2] - box[0, :2]) < 1e-4),
        ]
    for claim, holds in claims:
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    sys.exit(0 if all(holds for _, holds in claims) else 1)


if __name__ == "__main__":
    main()
