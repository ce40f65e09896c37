"""A box is welded to a springboard, and a bob is hinged to the box; let go, the board bounces on a stop.

    python demos/weld/weld.py             # half a minute
    python demos/weld/weld.py --quick     # a part of it

Everything is written to demos/weld/out/. The checks at the end fail if a claim does not hold.
"""

import argparse
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import fenics_rom as fr
from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.world.joints import SurfaceJoint
from fenics_rom.world.shapes import Box
from fenics_rom.world.surfaces import carried

HERE = Path(__file__).parent
TIP = np.array((0.45, 0.1, 0.01))  # middle of the surface that is welded, m
LENGTH, WIDTH, THICKNESS, YOUNG, POISSON, DENSITY = 0.4, 0.2, 0.01, 0.8e9, 0.3, 950.0  # of what of the board bends
BOX = fr.RigidBody(Box((0.2, 0.2, 0.1)), mass=0.5, position=(0.5, 0.1, 0.06))


def main() -> None:
    """Runs the demo; exits with 1 where a claim fails."""
    parser = argparse.ArgumentParser(description="A box that is welded to a springboard.")
    parser.add_argument("--quick", action="store_true", help="a part of it")
    quick = parser.parse_args().quick
    out = HERE / "out" / "quick" if quick else HERE / "out"
    out.mkdir(parents=True, exist_ok=True)
    world = fr.make_world(fr.read_world(HERE / "weld.toml"))
    history = bounce(world, 300 if quick else 2000)
    gone = world.ledger
    gap = abs(world.energy - gone.supplied + gone.dissipated + gone.numerical + gone.lost_in_switching)
    draw(history, out / "weld.png")

    hertz, (least, most) = frequency(world.simulator("board").rom, 0.7 if quick else 2.0), beam_frequencies()
    struck = np.linalg.norm(history["stop"], axis=1) > 0
    print(f"the box leaves its place on the board by at most {history['off'].max():.1e} m")
    print(f"energy account: closes to {gap / gone.supplied:.1e} of the work of gravity")
    print(f"impacts dissipated {gone.contact:.3f} J of {gone.supplied:.3f} J")
    print(f"weld: up to {np.abs(history['force']).max():.1f} N and {np.abs(history['couple']).max():.2f} N m")
    print(f"the box is at the stop in {struck.sum()} of {len(struck)} steps")
    print(f"board and box alone: {hertz:.4f} Hz; a beam with such a tip mass {least:.4f}, a wide plate {most:.4f} Hz")
    claims = [
        ("the box stays at its place on the board to 1e-9 m", history["off"].max() < 1e-9),
        ("energy account closes to 1e-12", gap < 1e-12 * gone.supplied),
        ("the box strikes the stop, and leaves it", struck.any() and not struck.all()),
        ("board and box swing between a beam and a wide plate with a tip mass", least < hertz < most),
    ]
    for claim, holds in claims:
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    sys.exit(0 if all(holds for _, holds in claims) else 1)


def bounce(world: fr.World, steps: int) -> dict[str, np.ndarray]:
    """Times, heights, forces of the weld and of the stop, and how far the box is off its place on the board."""
    board = world.simulator("board")
    places = board.contact_coordinates
    weights, _ = carried(places, np.full(len(places), 1 / len(places)), TIP)
    rows: dict[str, list[np.ndarray]] = {name: [] for name in ("time", "tip", "bob", "force", "couple", "stop", "off")}
    for _ in range(steps):
        world.step()
        pose, (force, couple) = world.pose("box"), world.joint_forces(0)
        place = pose.position + rotation_matrix(pose.rotation) @ (TIP - BOX.position)
        seen = {
            "time": world.time,
            "tip": place[2],
            "bob": world.pose("bob").position[2],
            "force": force,
            "couple": couple,
            "stop": world.force_between("box", "stop"),
            "off": np.abs(place - weights @ board.places()).max(),
        }
        for name, value in seen.items():
            rows[name].append(np.array(value))
    return {name: np.array(values) for name, values in rows.items()}


def frequency(rom: fr.Rom, seconds: float) -> float:
    """Of board and box alone after a small push, Hz."""
    world = fr.World({"board": fr.SoftBody(rom), "box": BOX}, 1e-3, joints=[SurfaceJoint("board", "box", "tip")])
    pushed = fr.World(world.bodies, 1e-3, joints=[SurfaceJoint("board", "box", "tip")])
    heights = []
    for step in range(round(seconds / 1e-3)):
        world.step()
        pushed.step({"box": {"force": (0, 0, 0.1 if step < 50 else 0)}})
        heights.append(pushed.pose("box").position[2] - world.pose("box").position[2])
    z = np.array(heights)
    rise = np.flatnonzero((z[:-1] < 0) & (z[1:] >= 0))
    times = 1e-3 * (rise - z[rise] / (z[rise + 1] - z[rise]))
    return float((len(times) - 1) / (times[-1] - times[0]))


def beam_frequencies() -> tuple[float, float]:
    """The lowest of a cubic beam element with the box at its tip, of a beam's stiffness and of a wide plate's, Hz."""
    L, lined = LENGTH, DENSITY * WIDTH * THICKNESS * LENGTH / 420
    M = lined * np.array(((156, -22 * L), (-22 * L, 4 * L**2)))
    mass, inertia = BOX.mass_and_inertia()
    x, _, z = BOX.position - np.array((LENGTH, 0, 0.005))
    M += ((mass, mass * x), (mass * x, inertia[1, 1] + mass * (x**2 + z**2)))
    rest = DENSITY * WIDTH * THICKNESS * 0.1  # of the board below the box, 0.1 m
    M += rest * np.array(((1, 0.05), (0.05, 0.1**2 / 3)))
    found = []
    for stiffness in (YOUNG, YOUNG / (1 - POISSON**2)):
        EI = stiffness * WIDTH * THICKNESS**3 / 12
        K = EI / L**3 * np.array(((12, -6 * L), (-6 * L, 4 * L**2)))
        found.append(float(np.sqrt(np.linalg.eigvals(np.linalg.solve(M, K)).real.min()) / (2 * np.pi)))
    return found[0], found[1]


def draw(history: dict[str, np.ndarray], file: Path) -> None:
    """Heights, and forces of weld and stop."""
    figure, (heights, forces) = plt.subplots(2, 1, figsize=(7, 5), sharex=True, layout="constrained")
    heights.plot(history["time"], 1e3 * (history["tip"] - TIP[2]), label="tip of the board")
    heights.plot(history["time"], 1e3 * (history["bob"] - history["bob"][0]), label="bob")
    forces.plot(history["time"], history["force"][:, 2], label="weld on the board")
    forces.plot(history["time"], history["stop"][:, 2], label="stop on the box")
    heights.set_ylabel("rise (mm)")
    forces.set(xlabel="time (s)", ylabel="vertical force (N)", ylim=(-40, 80))
    for axes in (heights, forces):
        axes.legend(loc="upper right")
        axes.grid(alpha=0.3)
    figure.savefig(file, dpi=80)
    plt.close(figure)


if __name__ == "__main__":
    main()
