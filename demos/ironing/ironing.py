"""Ironing: a block with a round bottom is pressed on a softer slab, and dragged over it with friction.

    python demos/ironing/ironing.py           # some minutes
    python demos/ironing/ironing.py --quick   # coarser meshes, a shorter way

After Puso & Laursen (Comput. Methods Appl. Mech. Eng. 193, 2004) and Fischer & Wriggers (the same, 195, 2006): the
block is ten times as stiff, friction is 0.3, and meshes do not match. Everything is written to demos/ironing/out/. The
checks at the end fail if a claim does not hold.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import PolyCollection
from numpy import ndarray as Array

sys.path.insert(0, str(Path(__file__).parents[1] / "hard_cases"))
from boxes import brick_cells, msh, outer_triangles

import fenics_rom as fr
from fenics_rom.io.markdown import markdown
from fenics_rom.scene.file import parse_scene
from fenics_rom.world.shapes import Box

HERE = Path(__file__).parent
SLAB, BLOCK, BEGINS = (0.12, 0.04, 0.02), (0.03, 0.024, 0.015), (0.015, 0.008, 0.02)  # m: sizes, and where the block is
ROUND = 0.08  # m, radius of its bottom
PRESSED, DOWN = 1.2e-3, 0.1  # m, within s
SPEED, RISE = 0.1, 0.05  # m/s aside, reached within s
STEP, FRICTION, PLATE = 1e-3, 0.3, 4e-3  # s, coefficient, m: thickness of the plate that carries the block

SCENE = """
frame = "{frame}"
[mesh]
file = "{file}"
[material]
young = {young}
poisson = 0.32
density = 1000
[supports]
clamped = ["{held}"]
[contacts.face]
surface = "{face}"
[effects]
inertia = {{}}
damping = {{ alpha = 100.0, beta = 2e-3 }}
[effects.contact.obstacles.far]
shape = "half-space"
point = [0, 0, -10]
normal = [0, 0, 1]
"""


class Ironed(NamedTuple):
    """A slab that has been ironed."""

    roms: list[fr.Rom]
    force: Array  # on the block (n, 3), N
    places: list[Array]  # of nodes in the end, (N, 3), m
    balance: float  # what the energy account misses, of what was supplied
    rate: float  # steps per second

    @property
    def slide(self) -> Array:
        """Forces while it slides at full speed."""
        return self.force[round((DOWN + 2 * RISE) / STEP) :]

    @property
    def jumps(self) -> Array:
        """By how much the force changes from step to step meanwhile, of the force."""
        return np.linalg.norm(np.diff(self.slide, axis=0), axis=1) / np.linalg.norm(self.slide[1:], axis=1)


def main() -> None:
    """Runs the demo; exits with 1 where a claim fails."""
    parser = argparse.ArgumentParser(description="A block is dragged over a soft slab.")
    parser.add_argument("--quick", action="store_true", help="coarser meshes, a shorter way")
    quick = parser.parse_args().quick
    out = HERE / "out" / "quick" if quick else HERE / "out"
    out.mkdir(parents=True, exist_ok=True)
    bricks, orders, steps = (((12, 4, 2), (5, 3, 2)), (30,), 260) if quick else (((16, 6, 3), (6, 5, 3)), (20, 40), 500)
    slab = body(SLAB, bricks[0], (0, 0, 0), ("top", "bottom"), "fixed", 1e5, 0.0)
    block = body(BLOCK, bricks[1], BEGINS, ("bottom", "top"), "moving", 1e6, 1 / ROUND)
    systems = slab, block
    whole = iron([fr.reduce(each, order=each.elastic_size, method="modal") for each in systems], steps)
    models = [iron([fr.reduce(each, order=order) for each in systems], steps) for order in orders]

    points = [len(rom.contact_models["face"].contact_points) for rom in whole.roms]
    print(f"{points[0]} and {points[1]} points; {slab.elastic_size} and {block.elastic_size} unknowns\n")
    heads = ("order", "pressing force", "drag", "most in a step", "error of the force", "account", "steps per second")
    print(markdown(heads, [row_of(each, whole) for each in (*models, whole)]))
    draw(whole, out / "ironing.png")
    pressing, drag = whole.slide[:, 2], -whole.slide[:, 0]
    rises = -whole.force[round(DOWN / STEP) : round((DOWN + RISE) / STEP), 0]
    claims = [
        ("the force changes by less than 1 % in a step", max(each.jumps.max() for each in (*models, whole)) < 0.01),
        ("the pressing force is constant to 5 %", np.abs(pressing / pressing.mean() - 1).max() < 0.05),
        ("drag rises, then is constant to 5 %", rises[0] < 0.5 * drag.mean() and np.ptp(drag) < 0.1 * drag.mean()),
        ("drag is friction's share of the pressing force to 10 %", abs((drag / pressing).mean() / FRICTION - 1) < 0.1),
        (
            "reduced, the force is right to 1 % over the way",
            max(off(each.force, whole.force) for each in models) < 0.01,
        ),
        ("energy accounts close to 1e-12", max(each.balance for each in (*models, whole)) < 1e-12),
    ]
    for claim, holds in claims:
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    sys.exit(0 if all(holds for _, holds in claims) else 1)


def off(found: Array, expected: Array) -> float:
    """Relative error in the 2-norm."""
    return float(np.linalg.norm(found - expected) / np.linalg.norm(expected))


def row_of(each: Ironed, whole: Ironed) -> tuple[str, ...]:
    """What the table says of a model."""
    orders = " and ".join(dict.fromkeys(str(rom.contact_models["face"].order) for rom in each.roms))
    pressing, drag = each.slide[:, 2], -each.slide[:, 0]
    ends = f"{pressing.min():.2f} to {pressing.max():.2f} N", f"{drag.min():.2f} to {drag.max():.2f} N"
    error = "-" if each is whole else f"{off(each.force, whole.force):.2%}"
    told = f"{each.jumps.max():.2%}", error, f"{each.balance:.0e}", f"{each.rate:.0f}"
    return (orders + ", all" * (each is whole), *ends, *told)


def body(
    size: tuple[float, float, float], bricks: tuple[int, int, int], at: tuple[float, float, float],
    faces: tuple[str, str], frame: str, young: float, bow: float,
) -> fr.System:  # fmt: skip
    """A block of tetrahedra, that touches with the first of its faces, and is held at the other.

    Its nodes are shaken within its top and bottom; `bow` is the curvature of its bottom along x, 1/m.
    """
    grid, cells = brick_cells(bricks)
    outer = outer_triangles(cells)
    surfaces = {name: outer[(grid[outer, 2] == end).all(axis=1)] for name, end in (("bottom", 0.0), ("top", 1.0))}
    inner = ((grid[:, :2] > 0) & (grid[:, :2] < 1)).all(axis=1)
    points = grid.copy()
    shake = np.random.default_rng(bricks[0]).uniform(-0.15, 0.15, (int(inner.sum()), 2))
    points[inner, :2] += shake / np.array(bricks[:2])
    points *= size
    points[:, 2] += bow / 2 * (points[:, 0] - size[0] / 2) ** 2 * (1 - grid[:, 2])
    with tempfile.TemporaryDirectory() as folder:
        mesh = Path(folder) / "block.msh"
        mesh.write_text(msh(points + at, {2: surfaces, 3: {"body": cells}}))
        scene = SCENE.format(file=mesh, face=faces[0], held=faces[1], frame=frame, young=young)
        return fr.assemble(parse_scene(scene))


def moved(time: float) -> fr.BaseState:
    """The plate that carries the block: down, then aside, smoothly."""
    s, aside = min(time / DOWN, 1.0), max(0.0, time - DOWN)
    down, sinking = PRESSED * s * s * (3 - 2 * s), PRESSED * 6 * s * (1 - s) / DOWN
    gone = SPEED * (aside**2 / (2 * RISE) if aside < RISE else aside - RISE / 2)
    place = np.array(BEGINS) + np.array(BLOCK) * [0.5, 0.5, 1.0] + np.array([gone, 0.0, PLATE / 2 - down])
    velocity = np.array([SPEED * min(aside / RISE, 1.0), 0.0, -sinking])
    return fr.BaseState(place, np.array([1.0, 0, 0, 0]), velocity, np.zeros(3))


def iron(roms: list[fr.Rom], steps: int) -> Ironed:
    """The block is pressed on the slab and dragged aside, for some steps."""
    slab, block = roms
    bodies = {
        "plate": fr.RigidBody(Box((*BLOCK[:2], PLATE)), motion=moved),
        "slab": fr.SoftBody(slab),
        "block": fr.SoftBody(block, on="plate", position=tuple(-moved(0.0).position)),
    }
    world = fr.World(bodies, STEP, friction=FRICTION, apart=[["plate", "slab"]])
    world.step()  # compiles what steps need
    begun, force = time.process_time(), np.zeros((steps, 3))
    for step in range(steps):
        world.step()
        force[step] = world.force_between("block", "slab")
    rate, gone = steps / (time.process_time() - begun), world.ledger
    left = world.energy - gone.supplied + gone.dissipated + gone.numerical + gone.lost_in_switching
    places = [world.simulator(name).node_places() for name in ("slab", "block")]
    return Ironed(roms, force, places, abs(left) / gone.supplied, rate)


def draw(whole: Ironed, file: Path) -> None:
    """The bodies from the side, forces over time, and what they change in a step."""
    figure, (side, forces, jumps) = plt.subplots(1, 3, figsize=(13, 3.6), layout="constrained")
    for rom, nodes, colour in zip(whole.roms, whole.places, ("#9ecae1", "#fdae6b"), strict=True):
        front = np.isclose(rom.nodes[rom.triangles, 1], rom.nodes[:, 1].min()).all(axis=1)
        corners = 1e3 * nodes[rom.triangles[front]][..., [0, 2]]
        side.add_collection(PolyCollection(corners, facecolor=colour, edgecolor="#444444", linewidth=0.4, alpha=0.8))
    side.autoscale_view()
    side.set(title="from the front, at the end", xlabel="x (mm)", ylabel="z (mm)", aspect="equal")
    times = STEP * np.arange(1, len(whole.force) + 1)
    forces.plot(times, whole.force[:, 2], label="pressing")
    forces.plot(times, -whole.force[:, 0], label="drag")
    forces.set(title="force on the block", xlabel="time (s)", ylabel="force (N)", ylim=(0, None))
    forces.legend()
    forces.grid(alpha=0.3)
    jumps.plot(times[-len(whole.jumps) :], 100 * whole.jumps, linewidth=0.8)
    jumps.set(title="change in a step", xlabel="time (s)", ylabel="% of the force", ylim=(0, None))
    jumps.grid(alpha=0.3)
    figure.savefig(file, dpi=80)
    plt.close(figure)


if __name__ == "__main__":
    main()
