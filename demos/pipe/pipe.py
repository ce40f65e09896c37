"""A soft finger finds its way into a pipe with an inner thread: it meets the mouth beside its axis, and slides in.

    python demos/pipe/pipe.py           # three minutes
    python demos/pipe/pipe.py --quick   # a coarser finger, a part of the way, larger steps

Everything is written to demos/pipe/out/. The checks at the end fail if a claim does not hold.
"""

import argparse
import sys
import time
from pathlib import Path
from typing import NamedTuple

import gmsh
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import PolyCollection
from numpy import ndarray as Array

import fenics_rom as fr
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.io.markdown import markdown
from fenics_rom.scene.file import parse_scene

HERE = Path(__file__).parent
LONG, THICK = 0.07, 5e-3  # m: the finger, and its radius
BORE, MOUTH, OUTSIDE = 5.4e-3, 0.01, 0.013  # m: radii of the pipe
PIPE, CONE = 0.04, 5e-3  # m: how long it is, and the cone of its mouth
PITCH, DEEP, AROUND, ALONG = 5e-3, 5e-4, 32, 10  # m, of the thread; triangles around, and along a pitch
AHEAD, ASIDE = 2.5e-3, 3e-3  # m: how far the tip is within the mouth, and the axes are apart
SPEED, STEP, FRICTION = 0.05, 1e-3, 0.2  # m/s of the pipe, s, coefficient
SCENE = """
[mesh]
file = "finger.msh"
[material]
young = 1e6
poisson = 0.3
density = 1100
[supports]
clamped = ["root"]
[contacts.skin]
surface = "skin"
[effects]
inertia = {{}}
damping = {{ alpha = 20.0, beta = 1e-3 }}
friction = {{ coefficient = {friction} }}
[effects.contact.obstacles.pipe]
shape = "mesh"
file = "pipe.stl"
position = [-{ahead}, 0, {aside}]
[run]
dt = {step}
duration = {duration}
snapshots = 80
"""


class Pushed(NamedTuple):
    """A finger while the pipe comes over it."""

    order: str
    force: Array  # of the pipe on it (n, 3), N
    moved: Array  # its nodes in the end, (N, 3), m
    pressure: Array  # of contact then, (N,), Pa
    touching: int  # points that push then
    balance: float  # what the energy account misses, of the work
    rate: float  # steps per second


def main() -> None:
    """Runs the demo; exits with 1 where a claim fails."""
    parser = argparse.ArgumentParser(description="A soft finger finds its way into a threaded pipe.")
    parser.add_argument("--quick", action="store_true", help="a coarser finger, a part of the way, larger steps")
    quick = parser.parse_args().quick
    out = HERE / "out" / "quick" if quick else HERE / "out"
    out.mkdir(parents=True, exist_ok=True)
    steps, dt = (225, 2 * STEP) if quick else (800, STEP)
    mesh(out / "finger.msh", 2.5e-3 if quick else 1.8e-3)
    write_pipe(out / "pipe.stl")
    given = {"friction": FRICTION, "ahead": AHEAD, "aside": ASIDE, "step": dt, "duration": steps * dt}
    system = fr.assemble(parse_scene(SCENE.format(**given), folder=out))
    scene = system.scene
    assert scene is not None
    whole = push(FullOrderSimulator(system, dt, scene.environment, {"pipe": pushed}), steps, "full")
    roms = [fr.reduce(system, order=order) for order in ((30,) if quick else (20, 40, 80))]
    models = [push(fr.Simulator(rom, dt, signals={"pipe": pushed}), steps, order_of(rom)) for rom in roms]

    points = len(system.points_of_contact().coordinates)
    print(f"{system.elastic_size} unknowns, {points} contact points, {len(pipe()[1])} triangles, {steps} steps\n")
    heads = (
        "order",
        "error of the force along the pipe",
        "of the shape",
        "points that push",
        "account",
        "steps per second",
    )
    print(markdown(heads, [row_of(each, whole) for each in (*models, whole)]))
    draw(roms[-1], whole, models[-1], dt, out / "pipe.png")
    fr.write_trajectory(out / "run.h5", fr.simulate(roms[-1], signals={"pipe": pushed}), force=True)
    best = models[-1]
    print(
        f"\nIn the end {-whole.force[-1, 0]:.2f} N push, and the tip is {1e3 * tip_aside(roms[-1], whole):.2f} mm aside"
    )
    claims = [
        (
            "the tip comes to the pipe's axis, to the play that it has there",
            abs(tip_aside(roms[-1], whole) - ASIDE) < 1e-3,
        ),
        ("reduced, the shape is right to 1 % in the end", off(best.moved, whole.moved) < 0.01),
        ("reduced, the force is right to 5 % over the way", off(best.force[:, 0], whole.force[:, 0]) < 0.05),
        ("energy accounts close to 1e-12 of the work", max(each.balance for each in (*models, whole)) < 1e-12),
    ]
    for claim, holds in claims:
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    sys.exit(0 if all(holds for _, holds in claims) else 1)


def off(found: Array, expected: Array) -> float:
    """Relative error in the 2-norm."""
    return float(np.linalg.norm(found - expected) / np.linalg.norm(expected))


def row_of(each: Pushed, whole: Pushed) -> tuple[str, ...]:
    """What the table says of a model."""
    errors = ("-", "-")
    if each is not whole:
        errors = f"{off(each.force[:, 0], whole.force[:, 0]):.1%}", f"{off(each.moved, whole.moved):.2%}"
    return (each.order, *errors, str(each.touching), f"{each.balance:.0e}", f"{each.rate:.0f}")


def order_of(rom: fr.Rom) -> str:
    """Of its only contact mode."""
    return str(rom.contact_models["skin"].order)


def tip_aside(rom: fr.Rom, each: Pushed) -> float:
    """How far the tip has moved aside in the end, m."""
    return float(each.moved[rom.nodes[:, 0].argmax(), 2])


def mesh(file: Path, size: float) -> None:
    """A rod along x that ends in half a ball at 0, with edges of a size, m."""
    gmsh.initialize([], readConfigFiles=False)
    gmsh.option.setNumber("General.Terminal", 0)
    try:
        model = gmsh.model.occ
        rod, tip = model.addCylinder(-LONG, 0, 0, LONG - THICK, 0, 0, THICK), model.addSphere(-THICK, 0, 0, THICK)
        model.fuse([(3, rod)], [(3, tip)])
        model.synchronize()
        faces = [tag for _, tag in gmsh.model.getEntities(2)]
        root = [tag for tag in faces if gmsh.model.getBoundingBox(2, tag)[3] < -LONG + 1e-5]
        groups = [(3, "body", [tag for _, tag in gmsh.model.getEntities(3)])]
        groups += [(2, "root", root), (2, "skin", sorted(set(faces) - set(root)))]
        for dimension, name, tags in groups:
            gmsh.model.setPhysicalName(dimension, gmsh.model.addPhysicalGroup(dimension, tags), name)
        gmsh.option.setNumber("Mesh.MeshSizeMax", size)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(file))
    finally:
        gmsh.finalize()


def bore(x: Array, around: Array) -> Array:
    """Radius of the pipe inside: a cone, then a bore whose thread is a cosine of x/pitch - turns around it, m."""
    thread = DEEP * np.clip((x - CONE) / PITCH, 0.0, 1.0) * np.cos(2 * np.pi * x / PITCH - around)
    radius: Array = BORE + (MOUTH - BORE) * np.clip(1 - x / CONE, 0.0, 1.0) + thread
    return radius


def pipe() -> tuple[Array, Array]:
    """Vertices (V, 3), m, and triangles (T, 3): loops of points along the inside, back along the outside."""
    x = np.linspace(0.0, PIPE, round(PIPE / PITCH * ALONG) + 1)
    around = 2 * np.pi * np.arange(AROUND) / AROUND
    x, radius = np.append(x, [PIPE, 0.0]), np.vstack([bore(x[:, None], around), np.full((2, AROUND), OUTSIDE)])
    loops = np.stack([np.repeat(x[:, None], AROUND, axis=1), radius * np.cos(around), radius * np.sin(around)], axis=2)
    loop, place = np.indices(radius.shape)
    row = [(loop + i) % len(x) * AROUND + (place + j) % AROUND for i, j in ((0, 0), (0, 1), (1, 0), (1, 1))]
    a, b, c, d = (each.ravel() for each in row)
    return loops.reshape(-1, 3), np.concatenate([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)])


def write_pipe(file: Path) -> None:
    """As STL in words, in m."""
    vertices, triangles = pipe()
    corner = "vertex {:.9g} {:.9g} {:.9g}\n"
    facet = "facet normal 0 0 0\nouter loop\n" + 3 * corner + "endloop\nendfacet\n"
    file.write_text(
        f"solid pipe\n{''.join(facet.format(*each.ravel()) for each in vertices[triangles])}endsolid pipe\n"
    )


def pushed(time: float) -> Array:
    """How far the pipe has come over the finger, m."""
    return np.array([-SPEED * time, 0.0, 0.0])


def push(body: fr.Simulator | FullOrderSimulator, steps: int, order: str) -> Pushed:
    """The pipe comes at a constant speed, for some steps."""
    assert body.ledger is not None
    begun, force = time.process_time(), np.zeros((steps, 3))
    for step in range(steps):
        body.step(np.empty(0))
        force[step] = body.obstacle_forces()[0]
    rate, gone = steps / (time.process_time() - begun), body.ledger
    left = body.energy - gone.supplied + gone.dissipated + gone.numerical + gone.lost_in_switching
    contact = (body.stepper if isinstance(body, FullOrderSimulator) else body.integrator).contact
    touching = 0 if contact is None else contact.touching
    end = body.displacement(), body.contact_pressure()
    return Pushed(order, force, *end, touching, abs(left) / gone.supplied, rate)


def draw(rom: fr.Rom, whole: Pushed, best: Pushed, dt: float, file: Path) -> None:
    """The finger in the pipe that is cut open, the pressure on its unrolled skin, and the force over the way."""
    figure, axes = plt.subplots(4, 1, figsize=(9, 9), layout="constrained", height_ratios=(1.3, 1, 1, 1))
    way = 1e3 * SPEED * dt * np.arange(1, len(whole.force) + 1)
    mouth, x = -1e3 * AHEAD - way[-1], np.linspace(0.0, PIPE, 800)
    for side, angle in ((1, np.pi / 2), (-1, -np.pi / 2)):
        inside, outside = 1e3 * (ASIDE + side * bore(x, np.array(angle))), 1e3 * (ASIDE + side * OUTSIDE)
        axes[0].fill_between(mouth + 1e3 * x, inside, outside, color="#bdbdbd")
    nodes, facing = rom.nodes + whole.moved, (rom.nodes[rom.triangles, 1] < 1e-6).all(axis=1)
    corners = 1e3 * nodes[rom.triangles[facing]][..., [0, 2]]
    axes[0].add_collection(PolyCollection(corners, facecolor="#9ecae1", edgecolor="#3182bd", linewidth=0.3))
    axes[0].autoscale_view()
    axes[0].set(ylabel="z (mm)", aspect="equal", title="cut along the axis of the pipe")
    around = np.degrees(np.arctan2(rom.nodes[:, 2], rom.nodes[:, 1]))
    there = (rom.nodes[rom.triangles, 0] > -LONG + 1e-6).all(axis=1) & (np.ptp(around[rom.triangles], axis=1) < 180)
    most = 1e-3 * max(each.pressure.max() for each in (whole, best))
    for view, each in ((axes[1], whole), (axes[2], best)):
        drawn = {"triangles": rom.triangles[there], "shading": "gouraud", "cmap": "magma", "vmin": 0, "vmax": most}
        shown = view.tripcolor(1e3 * rom.nodes[:, 0], around, 1e-3 * each.pressure, **drawn)
        order = "full order" if each is whole else f"order {each.order}"
        view.set(ylabel="around (°)", title=f"contact pressure on the unrolled skin, {order}", yticks=(-180, 0, 180))
    axes[2].set(xlabel="along the finger at rest (mm)")
    figure.colorbar(shown, ax=axes[1:3], label="kPa", shrink=0.8)
    for each, line in ((whole, "-"), (best, "--")):
        axes[3].plot(way, -each.force[:, 0], line, label="full order" if each is whole else f"order {each.order}")
    axes[3].set(xlabel="way of the pipe (mm)", ylabel="force along it (N)")
    axes[3].legend()
    axes[3].grid(alpha=0.3)
    figure.savefig(file, dpi=80)
    plt.close(figure)


if __name__ == "__main__":
    main()
