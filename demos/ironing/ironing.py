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
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy import ndarray as Array

sys.path.extend(str(Path(__file__).parents[1] / name) for name in ("hard_cases", "squeeze"))
from boxes import brick_cells, msh, outer_triangles
from dragged import STEP, Dragged, Vector, Way, drag, draw_front, off

import fenics_rom as fr
from fenics_rom.io.markdown import markdown
from fenics_rom.scene.file import parse_scene

HERE = Path(__file__).parent
SLAB, BLOCK, BEGINS = (0.12, 0.04, 0.02), (0.03, 0.024, 0.015), (0.015, 0.008, 0.02)  # m: sizes, and where the block is
ROUND = 0.08  # m, radius of its bottom
WAY, FRICTION = Way(BLOCK, BEGINS, pressed=1.2e-3, down=0.1, speed=0.1, rise=0.05), 0.3

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
    all_modes = [fr.reduce(each, order=each.elastic_size, method="modal") for each in systems]
    whole = drag(all_modes, WAY, FRICTION, steps)
    models = [drag([fr.reduce(each, order=order) for each in systems], WAY, FRICTION, steps) for order in orders]

    points = [len(rom.contact_models["face"].contact_points) for rom in whole.roms]
    print(f"{points[0]} and {points[1]} points; {slab.elastic_size} and {block.elastic_size} unknowns\n")
    heads = ("order", "pressing force", "drag", "most in a step", "error of the force", "account", "steps per second")
    print(markdown(heads, [row_of(each, whole) for each in (*models, whole)]))
    draw(whole, out / "ironing.png")
    pressing, friction = -slide(whole)[:, 2], slide(whole)[:, 0]
    rises = whole.force[round(WAY.down / STEP) : round((WAY.down + WAY.rise) / STEP), 0]
    claims = [
        ("the force changes by less than 1 % in a step", max(jumps(each).max() for each in (*models, whole)) < 0.01),
        ("the pressing force is constant to 5 %", np.abs(pressing / pressing.mean() - 1).max() < 0.05),
        (
            "drag rises, then is constant to 5 %",
            rises[0] < 0.5 * friction.mean() and np.ptp(friction) < 0.1 * friction.mean(),
        ),
        (
            "drag is friction's share of the pressing force to 10 %",
            abs((friction / pressing).mean() / FRICTION - 1) < 0.1,
        ),
        (
            "reduced, the force is right to 1 % over the way",
            max(off(each.force, whole.force) for each in models) < 0.01,
        ),
        ("energy accounts close to 1e-12", max(each.balance for each in (*models, whole)) < 1e-12),
    ]
    for claim, holds in claims:
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    sys.exit(0 if all(holds for _, holds in claims) else 1)


def slide(each: Dragged) -> Array:
    """Forces on the slab while the block slides at full speed."""
    return each.force[round((WAY.down + 2 * WAY.rise) / STEP) :]


def jumps(each: Dragged) -> Array:
    """By how much the force changes from step to step meanwhile, of the force."""
    return np.linalg.norm(np.diff(slide(each), axis=0), axis=1) / np.linalg.norm(slide(each)[1:], axis=1)


def row_of(each: Dragged, whole: Dragged) -> tuple[str, ...]:
    """What the table says of a model."""
    ends = (f"{force.min():.2f} to {force.max():.2f} N" for force in (-slide(each)[:, 2], slide(each)[:, 0]))
    error = "-" if each is whole else f"{off(each.force, whole.force):.2%}"
    told = f"{jumps(each).max():.2%}", error, f"{each.balance:.0e}", f"{each.rate:.0f}"
    return (each.name + ", all" * (each is whole), *ends, *told)


def body(
    size: Vector, bricks: tuple[int, int, int], at: Vector, faces: tuple[str, str],
    frame: str, young: float, bow: float,
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


def draw(whole: Dragged, file: Path) -> None:
    """The bodies from the side, forces over time, and what they change in a step."""
    figure, (side, forces, changes) = plt.subplots(1, 3, figsize=(13, 3.6), layout="constrained")
    draw_front(side, whole)
    times = STEP * np.arange(1, len(whole.force) + 1)
    forces.plot(times, -whole.force[:, 2], label="pressing")
    forces.plot(times, whole.force[:, 0], label="drag")
    forces.set(title="force on the block", xlabel="time (s)", ylabel="force (N)", ylim=(0, None))
    forces.legend()
    forces.grid(alpha=0.3)
    jumped = jumps(whole)
    changes.plot(times[-len(jumped) :], 100 * jumped, linewidth=0.8)
    changes.set(title="change in a step", xlabel="time (s)", ylabel="% of the force", ylim=(0, None))
    changes.grid(alpha=0.3)
    figure.savefig(file, dpi=80)
    plt.close(figure)


if __name__ == "__main__":
    main()
