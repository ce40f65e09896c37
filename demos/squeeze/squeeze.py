"""Two soft pads are squeezed into one another, then one slides over the other; their meshes do not match.

    python demos/squeeze/squeeze.py           # two minutes
    python demos/squeeze/squeeze.py --quick   # coarser meshes, a part of the way

Everything is written to demos/squeeze/out/. The checks at the end fail if a claim does not hold.
"""

import argparse
import sys
from pathlib import Path

import gmsh
import matplotlib.pyplot as plt
import numpy as np
from dragged import STEP, Dragged, Vector, Way, drag, draw_front, off

import fenics_rom as fr
from fenics_rom.io.markdown import markdown
from fenics_rom.scene.file import parse_scene

HERE = Path(__file__).parent
LOW, UPPER, BEGINS = (0.12, 0.10, 0.02), (0.09, 0.07, 0.02), (0.01, 0.015, 0.02)  # m: sizes, and where the upper one is
WAY, FRICTION = Way(UPPER, BEGINS, pressed=1e-3, down=0.1, speed=0.05, rise=0.05), 0.5

SCENE = """
frame = "{frame}"
[mesh]
file = "{file}"
[material]
young = {young}
poisson = 0.3
density = 300
[supports]
clamped = ["{held}"]
[contacts.face]
surface = "{face}"
[effects]
inertia = {{}}
damping = {{ alpha = 30.0, beta = 3e-3 }}
[effects.contact.obstacles.far]
shape = "half-space"
point = [0, 0, -10]
normal = [0, 0, 1]
"""


def main() -> None:
    """Runs the demo; exits with 1 where a claim fails."""
    parser = argparse.ArgumentParser(description="Two soft pads squeezed into one another.")
    parser.add_argument("--quick", action="store_true", help="coarser meshes, a part of the way")
    quick = parser.parse_args().quick
    out = HERE / "out" / "quick" if quick else HERE / "out"
    out.mkdir(parents=True, exist_ok=True)
    sizes, steps = ((0.02, 0.024), 200) if quick else ((0.0105, 0.008), 350)
    low = pad(out / "low.msh", LOW, (0, 0, 0), sizes[0], ("top", "bottom"), "fixed", 5e4)
    upper = pad(out / "upper.msh", UPPER, BEGINS, sizes[1], ("bottom", "top"), "moving", 1e5)
    systems = low, upper
    all_modes = [fr.reduce(each, order=each.elastic_size, method="modal") for each in systems]
    whole = drag(all_modes, WAY, FRICTION, steps)
    orders = (30,) if quick else (20, 40)
    models = [drag([fr.reduce(each, order=order) for each in systems], WAY, FRICTION, steps) for order in orders]

    points = [len(rom.contact_models["face"].contact_points) for rom in whole.roms]
    print(f"{points[0]} and {points[1]} points; {low.elastic_size} and {upper.elastic_size} unknowns\n")
    heads = ("order", "error of the pressing force", "of friction", "account", "points that push", "steps per second")
    print(markdown(heads, [row_of(each, whole) for each in (*models, whole)]))
    draw(whole, out / "squeeze.png")
    friction, _, pressing = whole.force[-1] * [1, 1, -1]
    print(f"\nIn the end {pressing:.1f} N press, and friction is {friction / pressing:.3f} of that")
    wrong = max(off(each.force[:, 2], whole.force[:, 2]) for each in models)
    claims = [
        ("sliding, friction is its share of the pressing force to 3 %", abs(friction / pressing / FRICTION - 1) < 0.03),
        ("reduced, the pressing force is right to 1 % over the way", wrong < 0.01),
        ("energy accounts close to 1e-12", max(each.balance for each in (*models, whole)) < 1e-12),
    ]
    for claim, holds in claims:
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    sys.exit(0 if all(holds for _, holds in claims) else 1)


def row_of(each: Dragged, whole: Dragged) -> tuple[str, ...]:
    """What the table says of a model."""
    errors = ("-", "-") if each is whole else (f"{off(each.force[:, k], whole.force[:, k]):.2%}" for k in (2, 0))
    push = each.world.contact_forces("low", "upper")[1].any(axis=1).sum()
    return (each.name + ", all" * (each is whole), *errors, f"{each.balance:.0e}", str(push), f"{each.rate:.0f}")


def pad(file: Path, size: Vector, at: Vector, edge: float, faces: tuple[str, str], frame: str, E: float) -> fr.System:
    """A pad of triangles with an edge, m, that touches with the first of its faces, and is held at the other."""
    gmsh.initialize([], readConfigFiles=False)
    gmsh.option.setNumber("General.Terminal", 0)
    try:
        body = gmsh.model.occ.addBox(*at, *size)
        gmsh.model.occ.synchronize()
        for name, height in (("bottom", at[2]), ("top", at[2] + size[2])):
            ends = np.array([[*at[:2], height], [at[0] + size[0], at[1] + size[1], height]])
            ends += [[-1e-6], [1e-6]]
            tags = gmsh.model.getEntitiesInBoundingBox(*ends.ravel(), dim=2)
            gmsh.model.setPhysicalName(2, gmsh.model.addPhysicalGroup(2, [tag for _, tag in tags]), name)
        gmsh.model.setPhysicalName(3, gmsh.model.addPhysicalGroup(3, [body]), "body")
        gmsh.model.mesh.setSize(gmsh.model.getEntities(0), edge)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(file))
    finally:
        gmsh.finalize()
    given = {"face": faces[0], "held": faces[1], "frame": frame, "young": E}
    return fr.assemble(parse_scene(SCENE.format(file=file, **given)))


def draw(whole: Dragged, file: Path) -> None:
    """The pads from the side, the pressure on the lower one, and the forces over time."""
    figure, (side, above, forces) = plt.subplots(1, 3, figsize=(13, 3.6), layout="constrained")
    draw_front(side, whole)
    low, pad = whole.roms[0], whole.world.simulator("low")
    nodes, pressure = pad.node_places(), pad.contact_pressure()
    top = low.triangles[np.isclose(low.nodes[low.triangles, 2], LOW[2]).all(axis=1)]
    shown = above.tripcolor(*(1e3 * nodes[:, :2].T), top, 1e-3 * pressure, shading="gouraud", cmap="magma")
    figure.colorbar(shown, ax=above, label="pressure (kPa)", shrink=0.8)
    above.set(title="on the lower pad", xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
    times = STEP * np.arange(1, len(whole.force) + 1)
    forces.plot(times, -whole.force[:, 2], label="pressing")
    forces.plot(times, whole.force[:, 0], label="friction")
    forces.set(title="on the lower pad", xlabel="time (s)", ylabel="force (N)")
    forces.legend()
    forces.grid(alpha=0.3)
    figure.savefig(file, dpi=80)
    plt.close(figure)


if __name__ == "__main__":
    main()
