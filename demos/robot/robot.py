"""An arm of MuJoCo's carries two soft fingers, which pick up a box; its joints feel the weight.

    python demos/robot/robot.py             # a minute
    python demos/robot/robot.py --quick     # up to the lift

MuJoCo moves the arm, by motors that follow a path; fenics_rom the fingers, the box and what touches; bridge.py hands
poses and twists one way and wrenches the other. Everything is written to demos/robot/out/. The checks at the end fail
if a claim does not hold.
"""

import argparse
import math
import sys
from pathlib import Path
from time import process_time
from typing import NamedTuple

import mujoco
import numpy as np
from bridge import Bridge, Robot

import fenics_rom as fr
from fenics_rom.world.recorder import WorldRecorder
from fenics_rom.world.shapes import Box, Capsule, HalfSpace

sys.path.append(str(Path(__file__).parents[1] / "gripper"))  # whose fingers they are
from gripper import ASIDE, EDGE, GRAVITY, SIDES, rise

HERE = Path(__file__).parent
GRIPPER = HERE.parent / "gripper"
DT = 2e-3  # s
DENSITY = 1000.0  # of the box, kg/m3
SHOULDER, UPPER_ARM, FOREARM, HAND = 0.3, 0.3, 0.25, 0.1  # m: its height; lengths, the last down to the fingers' roots
REACH, ABOVE, GRIP = 0.35, 0.188, 0.108  # m: of the box from the column; of the roots over the ground, before and then
TENSION = 6.0  # N
WAITED, DOWN, CLOSED, LIFTED, WEIGHED, TURNED, LOWERED, OPENED, END = 0.6, 1.1, 1.5, 2.0, 2.6, 3.6, 4.1, 4.4, 4.8  # s
TURN = math.radians(70)

Array = np.ndarray


class Run(NamedTuple):
    """Of the robot, beside the world's."""

    trajectory: fr.Trajectory
    bridge: Bridge
    torques: Array  # (S, 4) of the motors after each step, N m
    levers: Array  # (S,) of the box before the shoulder, m
    rate: float  # steps in a second of processor time


def main() -> None:
    """Runs the demo; exits with 1 where a claim fails."""
    parser = argparse.ArgumentParser(description="Soft fingers on an arm.")
    parser.add_argument("--quick", action="store_true", help="up to the lift")
    quick = parser.parse_args().quick
    out = HERE / "out" / "quick" if quick else HERE / "out"
    out.mkdir(parents=True, exist_ok=True)
    file = GRIPPER / "out" / "finger.h5"
    if not file.is_file():
        file.parent.mkdir(exist_ok=True)
        fr.write_rom(file, fr.reduce(fr.assemble(fr.read_scene(GRIPPER / "finger.toml"))))
    run = simulate(fr.read_rom(file), WEIGHED if quick else END)
    fr.write_trajectory(out / "robot.h5", run.trajectory)
    if not quick:
        fr.export(run.trajectory, out / "robot.gif", seconds=END)
        draw(run, out / "torques.png")
    report(run, quick)


def simulate(rom: fr.Rom, duration: float) -> Run:
    """The whole."""
    model = mujoco.MjModel.from_xml_path(str(HERE / "arm.xml"))
    data = mujoco.MjData(model)
    data.qpos[:] = data.ctrl[:] = joints(0.0)
    robot = Robot(model, data)
    world = world_of(rom, robot)
    bridge = Bridge(robot, world, {f"{side}_finger": "hand" for side in SIDES})
    steps = round(duration / DT)
    recorder = WorldRecorder(world, steps, snapshots=steps // 40)
    torques, levers = np.zeros((steps, 4)), np.zeros(steps)
    begin = process_time()
    for step in range(steps):
        data.ctrl[:] = joints(world.time + DT)
        pull = TENSION * rise(world.time, DOWN, CLOSED) * (1 - rise(world.time, LOWERED, OPENED))
        bridge.step({f"{side}_finger": {"flexor": [pull]} for side in SIDES})
        recorder.sample(step + 1)
        torques[step], levers[step] = data.actuator_force, math.hypot(*world.pose("box").position[:2])
    rate = steps / (process_time() - begin)
    return Run(recorder.record("robot", {}), bridge, torques, levers, rate)


def world_of(rom: fr.Rom, robot: Robot) -> fr.World:
    """Ground, box and fingers; the arm's links to be seen."""
    lies = fr.BaseState(np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))
    across = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])  # a capsule's axis z along x
    bodies: dict[str, fr.RigidBody | fr.SoftBody] = {
        "ground": fr.RigidBody(HalfSpace(), motion=lies),
        "box": fr.RigidBody(Box((EDGE, EDGE, EDGE)), density=DENSITY, position=(REACH, 0, EDGE / 2)),
        "column": fr.RigidBody(Capsule(0.03, SHOULDER), motion=robot.motion("column", (0, 0, -SHOULDER / 2))),
        "upper_arm": fr.RigidBody(
            Capsule(0.02, UPPER_ARM), motion=robot.motion("upper_arm", (UPPER_ARM / 2, 0, 0), across)
        ),
        "forearm": fr.RigidBody(Capsule(0.02, FOREARM), motion=robot.motion("forearm", (FOREARM / 2, 0, 0), across)),
        "wrist": fr.RigidBody(Capsule(0.015, 0.07), motion=robot.motion("hand", (0, 0, -0.045))),
        "palm": fr.RigidBody(Box((2 * ASIDE + 0.03, 0.03, 0.01)), motion=robot.motion("hand", (0, 0, -HAND + 0.012))),
    }
    links = ["column", "upper_arm", "forearm", "wrist", "palm", *SIDES]
    fingers = [f"{side}_finger" for side in SIDES]
    for side, sign in SIDES.items():
        # a finger's axis x hangs down, and its lower side, -z, looks at the other one
        mount = np.array([[0, 0, sign], [0, sign, 0], [-1, 0, 0]], dtype=float)
        bodies[side] = fr.RigidBody(
            Box((0.004, 0.02, 0.02)), motion=robot.motion("hand", (sign * ASIDE, 0, -HAND), mount)
        )
        bodies[f"{side}_finger"] = fr.SoftBody(rom, on=side)
    apart = [[*links, *fingers, "ground"], ["box", *links]]
    return fr.World(bodies, DT, gravity=(0, 0, -GRAVITY), friction=0.8, apart=apart)


def joints(time: float) -> Array:
    """Angles (4,) of the joints that hold the hand upright over the box, rad."""
    low = rise(time, WAITED, DOWN) - rise(time, CLOSED, LIFTED) + rise(time, TURNED, LOWERED)
    height = ABOVE + (GRIP - ABOVE) * low
    up = height + HAND - SHOULDER
    far = math.hypot(REACH, up)
    inner = math.acos((UPPER_ARM**2 + far**2 - FOREARM**2) / (2 * UPPER_ARM * far))
    bend = math.pi - math.acos((UPPER_ARM**2 + FOREARM**2 - far**2) / (2 * UPPER_ARM * FOREARM))
    shoulder = -math.atan2(up, REACH) - inner
    return np.array([TURN * rise(time, WEIGHED, TURNED), shoulder, bend, -shoulder - bend])


def draw(run: Run, file: Path) -> None:
    """Torques of the joints over time."""
    import matplotlib

    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    figure, (whole, close) = plt.subplots(2, figsize=(8, 5), sharex=True, layout="constrained")
    times = DT * np.arange(1, len(run.torques) + 1)
    shoulder, elbow = run.torques[:, 1], run.torques[:, 2]
    before, due = shoulder[at(WAITED)], -DENSITY * EDGE**3 * GRAVITY * run.levers
    whole.plot(times, shoulder, label="shoulder")
    whole.plot(times, elbow, label="elbow")
    whole.legend(loc="lower right")
    whole.set(ylabel="torque of the motor, N m", title="What the arm feels")
    close.plot(times, shoulder - before, label="shoulder, more than in the beginning")
    close.plot(times, due, "0.4", ls="dashed", lw=1, label="weight of the box times its distance")
    close.legend(loc="lower left")
    close.set(xlabel="time, s", ylabel="N m", ylim=(-0.2, 0.1))
    for time, what in ((WAITED, "down"), (DOWN, "close"), (CLOSED, "lift"), (WEIGHED, "turn"), (TURNED, "put down")):
        for axes in (whole, close):
            axes.axvline(time, color="0.85", lw=0.8)
        whole.text(time, 0.97, f" {what}", transform=whole.get_xaxis_transform(), va="top", fontsize=8, color="0.4")
    figure.savefig(file, dpi=120)


def at(time: float) -> int:
    """The row of the step that ends at a time, s."""
    return round(time / DT) - 1


def report(run: Run, quick: bool) -> None:
    """Says how it went, and exits."""
    trajectory, account = run.trajectory, run.bridge.account
    weight = DENSITY * EDGE**3 * GRAVITY
    box = trajectory.bodies["box"].pose
    felt = run.torques[at(WEIGHED), 1] - run.torques[at(WAITED), 1]
    due = -weight * run.levers[at(WEIGHED)]
    lifted = box[at(WEIGHED) + 1, 2] - box[0, 2]
    print(f"{trajectory.steps} steps of {1e3 * DT:g} ms: {run.rate:.0f} steps in a second of processor time")
    print(f"the box, {1e3 * weight / GRAVITY:.1f} g, is lifted by {1e3 * lifted:.1f} mm")
    print(f"the shoulder feels {felt:.5f} N m more than before, of {due:.5f}: {abs(felt / due - 1):.2%} off")
    print(f"fingers and box: their account closes to {trajectory.balance_error:.1e}")
    print(
        f"the coupling passed {1e3 * account.passed:.2f} mJ, and its delay added {1e3 * account.added:.4f} mJ to them, "
        f"{abs(account.added) / account.passed:.2%}"
    )
    claims = [
        ("the box is lifted by 80 mm to 3 mm", abs(lifted - (ABOVE - GRIP)) < 3e-3),
        ("the shoulder feels its weight to 1 %", abs(felt / due - 1) < 0.01),
        ("the account of fingers and box closes to 1e-10", trajectory.balance_error < 1e-10),
        ("the delay adds or takes less than 1 % of what is passed", abs(account.added) < 0.01 * account.passed),
    ]
    if not quick:
        put = box[0, 0] * np.array([math.cos(TURN), math.sin(TURN)])
        beside = float(np.linalg.norm(box[-1, :2] - put))
        print(f"it is put down {1e3 * beside:.2f} mm from where it was to be")
        claims += [
            ("it is put down on its face to 0.1 mm", abs(box[-1, 2] - EDGE / 2) < 1e-4),
            ("and to 2 mm where it was to be", beside < 2e-3),
        ]
    for claim, holds in claims:
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    sys.exit(0 if all(holds for _, holds in claims) else 1)


if __name__ == "__main__":
    main()
