"""A bellows is pressed until its folds close: it touches itself, and is then as stiff as a stack of plates.

    python demos/folds/folds.py           # a minute
    python demos/folds/folds.py --quick   # a coarser mesh, a part of the way, larger steps

Everything is written to demos/folds/out/. The checks at the end fail if a claim does not hold.
"""

import argparse
import itertools
import sys
import time
from dataclasses import replace
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
from fenics_rom.mechanics.contact import ContactSolution
from fenics_rom.scene.file import parse_scene

HERE = Path(__file__).parent
LEAVES, LONG, RISE, THICK, DEEP, NECK = 4, 0.03, 5e-3, 2e-3, 8e-3, 5e-3  # number, and in m, of leaves; half the neck
SPEED, STEP, FRICTION = 0.02, 1e-3, 0.3  # m/s of the plate, s, coefficient
SCENE = """
[mesh]
file = "{file}"
[material]
young = 1e6
poisson = 0.4
density = 1100
[supports]
clamped = ["foot"]
[contacts.folds]
surface = "folds"
[effects]
inertia = {{}}
damping = {{ alpha = 20.0, beta = 1e-3 }}
friction = {{ coefficient = {friction} }}
[effects.contact]
self_contact = ["folds"]
[effects.contact.obstacles.plate]
shape = "half-space"
point = [0, 0, {top}]
normal = [0, 0, -1]
"""


class Pressed(NamedTuple):
    """A bellows while a plate presses it."""

    order: str
    force: Array  # on the plate (n,), N
    within: Array  # sum of the sizes of its forces on itself (n,), N
    moved: Array  # its nodes in the end, (N, 3), m
    spots: tuple[Array, Array]  # its contact points then (P, 3), m, and forces on them (P, 3), N
    balance: float  # what the energy account misses, of the work
    rate: float  # steps per second


def main() -> None:
    """Runs the demo; exits with 1 where a claim fails."""
    parser = argparse.ArgumentParser(description="A bellows whose folds close.")
    parser.add_argument("--quick", action="store_true", help="a coarser mesh, a part of the way, larger steps")
    quick = parser.parse_args().quick
    out = HERE / "out" / "quick" if quick else HERE / "out"
    out.mkdir(parents=True, exist_ok=True)
    mesh(out / "bellows.msh", 8e-3 if quick else 5e-3)
    text = SCENE.format(file=out / "bellows.msh", friction=FRICTION, top=LEAVES * RISE + 2 * THICK)
    system = fr.assemble(parse_scene(text))
    scene, (steps, dt) = system.scene, (360, 2 * STEP) if quick else (850, STEP)
    assert scene is not None
    acting = scene.environment
    whole = press(FullOrderSimulator(system, dt, acting, {"plate": plate}), steps, "full")
    roms = [fr.reduce(system, order=order) for order in ((30,) if quick else (20, 30, 40))]
    models = [press(fr.Simulator(rom, dt, signals={"plate": plate}), steps, order_of(rom)) for rom in roms]
    alone = fr.Simulator(roms[-1], dt, scene=replace(acting, self_contact=()), signals={"plate": plate})
    apart = press(alone, steps, order_of(roms[-1]))

    print(f"{system.elastic_size} unknowns, {steps} steps of {1e3 * dt:.0f} ms\n")
    heads = ("order", "error of the force on the plate", "of forces on itself", "account", "steps per second")
    print(markdown(heads, [row_of(each, whole) for each in (*models, whole)]))
    stiffer = whole.force[-1] / apart.force[-1]
    print(f"\nIn the end {whole.force[-1]:.2f} N push the plate, and {apart.force[-1]:.2f} N where folds may pass")
    draw(roms[-1], whole, apart, dt, out / "folds.png")
    best = models[-1]
    claims = [
        ("closed, the folds are ten times as stiff as open ones", stiffer > 10),
        ("reduced, the force is right to 5 % over the way", off(best.force, whole.force) < 0.05),
        ("energy accounts close to 1e-12 of the work", max(each.balance for each in (*models, whole)) < 1e-12),
    ]
    for claim, holds in claims:
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    sys.exit(0 if all(holds for _, holds in claims) else 1)


def off(found: Array, expected: Array) -> float:
    """Relative error in the 2-norm."""
    return float(np.linalg.norm(found - expected) / np.linalg.norm(expected))


def row_of(each: Pressed, whole: Pressed) -> tuple[str, ...]:
    """What the table says of a model."""
    errors = ("-", "-") if each is whole else (f"{off(a, b):.1%}" for a, b in zip(each[2:4], whole[2:4], strict=True))
    return (each.order, *errors, f"{each.balance:.0e}", f"{each.rate:.0f}")


def order_of(rom: fr.Rom) -> str:
    """Of its only contact mode."""
    return str(rom.contact_models["folds"].order)


def mesh(file: Path, size: float) -> None:
    """Two mirrored rows of leaves between a foot and a head, with edges of a size, m."""
    gmsh.initialize([], readConfigFiles=False)
    gmsh.option.setNumber("General.Terminal", 0)
    try:
        model, height = gmsh.model.occ, LEAVES * RISE
        parts = [model.addBox(-2 * NECK, 0.0, z, 4 * NECK, DEEP, 2 * THICK) for z in (-THICK, height)]
        for side, k in itertools.product((-1, 1), range(LEAVES)):
            (a, b), (c, d) = ((side * (NECK + (k + end) % 2 * LONG), (k + end) * RISE) for end in (0, 1))
            points = [model.addPoint(x, 0.0, z) for x, z in ((a, b), (c, d), (c, d + THICK), (a, b + THICK))]
            lines = [model.addLine(*ends) for ends in itertools.pairwise((*points, points[0]))]
            face = model.addPlaneSurface([model.addCurveLoop(lines)])
            parts.append(model.extrude([(2, face)], 0.0, DEEP, 0.0)[1][1])
        model.fuse([(3, parts[0])], [(3, part) for part in parts[1:]])
        model.synchronize()
        groups = [(3, "body", [tag for _, tag in gmsh.model.getEntities(3)])]
        faces = {tag: gmsh.model.getBoundingBox(2, tag) for _, tag in gmsh.model.getEntities(2)}
        cut = [tag for tag, box in faces.items() if box[4] - box[1] < 1e-5]  # by the planes in front and behind
        foot = [tag for tag, box in faces.items() if box[5] < -THICK + 1e-5]
        head = [tag for tag, box in faces.items() if box[2] > height + 2 * THICK - 1e-5]
        groups += [(2, "foot", foot), (2, "head", head), (2, "folds", sorted(set(faces) - {*cut, *foot}))]
        for dimension, name, tags in groups:
            gmsh.model.setPhysicalName(dimension, gmsh.model.addPhysicalGroup(dimension, tags), name)
        gmsh.model.mesh.setSize(gmsh.model.getEntities(0), size)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(file))
    finally:
        gmsh.finalize()


def plate(time: float) -> Array:
    """Where it is, from where it lies on the bellows at rest, m."""
    return np.array([0.0, 0.0, -SPEED * time])


def press(body: fr.Simulator | FullOrderSimulator, steps: int, order: str) -> Pressed:
    """The plate comes down on the bellows at a constant speed, for some steps."""
    stepper = body.stepper if isinstance(body, FullOrderSimulator) else body.integrator
    assert stepper.interface is not None
    assert body.ledger is not None
    rest, nothing = stepper.interface.points.coordinates, np.empty(0)
    begun, force, within, contact = time.process_time(), np.zeros(steps), np.zeros(steps), None
    for step in range(steps):
        body.step(nothing)
        contact = stepper.contact
        if contact is not None:
            force[step], within[step] = -contact.by_obstacle[0, 2], on_itself(contact)
    rate, gone = steps / (time.process_time() - begun), body.ledger
    left = body.energy - gone.supplied + gone.dissipated + gone.numerical + gone.lost_in_switching
    spots = rest + stepper.point_displacement(), 0 * rest if contact is None else contact.forces
    return Pressed(order, force, within, body.displacement(), spots, abs(left) / gone.supplied, rate)


def on_itself(contact: ContactSolution) -> float:
    """Sum of the sizes of forces of the bellows on itself, N."""
    own = contact.pairs >= len(contact.forces)
    return float(np.linalg.norm(contact.pair_forces[own], axis=1).sum())


def draw(rom: fr.Rom, whole: Pressed, apart: Pressed, dt: float, file: Path) -> None:
    """The bellows from the side, with its forces on itself, and the force on the plate over its way."""
    figure = plt.figure(figsize=(9, 5), layout="constrained")
    left, right = figure.subfigures(1, 2)
    views, in_front = (left.subplots(3, 1, sharex=True), np.isclose(rom.nodes[rom.triangles, 1], 0.0).all(axis=1))
    moved = {"at rest": 0.0, "pressed, folds that pass": apart.moved, "folds that touch": whole.moved}
    for view, (title, by) in zip(views, moved.items(), strict=True):
        corners = 1e3 * (rom.nodes + by)[rom.triangles[in_front]][..., [0, 2]]
        view.add_collection(PolyCollection(corners, facecolor="#9ecae1", edgecolor="#3182bd", linewidth=0.4, alpha=0.7))
        view.set(title=title, ylabel="z (mm)", aspect="equal", ylim=(-10, 32))
        view.autoscale_view(scaley=False)
    places, forces = 1e3 * whole.spots[0], whole.spots[1]
    if (pushed := forces.any(axis=1)).any():
        along = forces[pushed][:, [0, 2]] / np.linalg.norm(forces, axis=1).max()
        views[2].quiver(*places[pushed][:, [0, 2]].T, *along.T, color="#cb181d", width=4e-3, scale=10, zorder=3)
    views[2].set_xlabel("x (mm)")
    axes, way = right.subplots(), 1e3 * SPEED * dt * np.arange(1, len(whole.force) + 1)
    for run, label in ((whole, "folds that touch"), (apart, "folds that pass")):
        axes.semilogy(way, np.maximum(run.force, 1e-3), label=label)
    axes.set(xlabel="way of the plate (mm)", ylabel="force on it (N)")
    axes.legend()
    axes.grid(alpha=0.3)
    figure.savefig(file, dpi=80)
    plt.close(figure)


if __name__ == "__main__":
    main()
