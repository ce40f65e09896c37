"""Soft bodies fall on rough meshes that turn and shake: none ends inside, and none gains energy but by their work.

    python demos/feed/drops.py --drops 10000   # a day
    python demos/feed/drops.py                 # a hundred, ten minutes

Each drop has a mesh, a block, a place, an attitude, spins, a friction and a step of 1 to 10 ms by chance. The checks at
the end fail if a claim does not hold.
"""

import argparse
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import gmsh
import numpy as np
from numpy import ndarray as Array

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.mechanics.frame_motion import quaternion_of_vector
from fenics_rom.mechanics.obstacle_poses import distance_from
from fenics_rom.scene.file import parse_scene

HERE = Path(__file__).parent
SIZE, SQUARES, EDGE = 0.2, 12, 0.015  # m and number of triangles' squares, of a ground; m, longest edge of blocks
BEFORE_NEXT, DURATION = 25, 0.25  # drops of one mesh and block; s, of each
DEEPEST = 1e-10  # m
SCENE = """
frame = "moving"
[mesh]
file = "block.msh"
[material]
young = 1e5
poisson = 0.3
density = 500.0
[contacts.skin]
near = { point = [0, 0, 0], radius = 1.0 }
[effects]
inertia = {}
damping = { alpha = 0.0, beta = 1e-3 }
gravity = { acceleration = [0, 0, -9.81] }
friction = { coefficient = MU }
[effects.contact.obstacles.ground]
shape = "mesh"
file = "ground.stl"
motion = {}
"""


def main() -> None:
    """Runs the drops; exits with 1 where one ends inside or gains energy."""
    parser = argparse.ArgumentParser(description="Drops on rough meshes that turn.")
    parser.add_argument("--drops", type=int, default=100, help="how many")
    parser.add_argument("--seed", type=int, default=0, help="of what is left to chance")
    parser.add_argument("--quick", action="store_true", help="four drops")
    given = parser.parse_args()
    rng, out, deepest, gained, refused, touched = np.random.default_rng(given.seed), HERE / "out", 0.0, 0.0, 0, 0
    out.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore", FenicsRomWarning)
    rom, drops = None, 4 if given.quick else given.drops
    for number in range(drops):
        if rom is None or number % BEFORE_NEXT == 0:
            block(out / "block.msh", rng.uniform(0.4, 1.0, 3) * EDGE)
            ground(out / "ground.stl", rng)
            scene = parse_scene(SCENE.replace("MU", f"{rng.uniform(0, 1):.3f}"), folder=out)
            rom = fr.reduce(fr.assemble(scene), order=6)
        try:
            depth, gain, steps = drop(rom, rng)
        except fr.StepError as error:
            refused += 1
            print(f"drop {number} was refused: {error}")
            continue
        deepest, gained, touched = max(deepest, depth), max(gained, gain), touched + steps
    print(f"{drops} drops, {touched} steps that touched; {refused} ended as a step was refused")
    claims = [
        (f"no point ends deeper inside than 1e-10 m: {deepest:.1e} m at most", deepest < DEEPEST),
        (f"no energy comes but by the ground's work and weight: {gained:.1e} of it at most", gained < 1e-12),
        ("at most one drop in a hundred is refused a step", refused <= drops / 100),
    ]
    for claim, holds in claims:
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    sys.exit(0 if all(holds for _, holds in claims) else 1)


def drop(rom: fr.Rom, rng: np.random.Generator) -> tuple[float, float, int]:
    """How deep a point was at most, m; energy gained beyond the work, as a share; steps that touched."""
    still = fr.BaseState(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3))
    body = fr.Simulator(rom, float(10 ** rng.uniform(-3, -2)), signals={"ground": still._replace(position=-np.ones(3))})
    body.set_signal("ground", motion_of(rng))
    body.begin_anew()
    attitude = rng.normal(size=4)
    place = np.array([*rng.uniform(-0.04, 0.04, 2), 0.03])
    body.place(fr.BaseState(place, attitude / np.linalg.norm(attitude), rng.normal(size=3) / 5, 3 * rng.normal(size=3)))
    shape, begun, deepest, touched, lost = rom.environment.obstacles["ground"].shape, body.energy, 0.0, 0, 0.0
    assert body.environment is not None
    assert body.ledger is not None
    gained = 0.0
    for _ in range(round(DURATION / body.dt)):
        body.step()
        touched += body.integrator.contact is not None
        gaps, _ = distance_from(shape, rom.nodes + body.displacement(), body.environment.state.offsets[0])
        gone = body.ledger
        scale = max(body.energy, abs(gone.supplied), begun)
        gain = max(body.energy - begun - gone.supplied, lost - gone.dissipated)
        deepest, gained, lost = max(deepest, -float(gaps.min())), max(gained, gain / scale), gone.dissipated
    return deepest, gained, touched


def motion_of(rng: np.random.Generator) -> Callable[[float], fr.BaseState]:
    """The ground sways about an axis and is shaken, from rest."""
    axis, angle, rate = rng.normal(size=3) * [1, 1, 3], rng.uniform(0, 0.8), rng.uniform(2, 12)
    axis, shift = axis / np.linalg.norm(axis), rng.uniform(-5e-3, 5e-3, 3)

    def motion(time: float) -> fr.BaseState:
        share, speed = (1 - np.cos(rate * time)) / 2, rate * np.sin(rate * time) / 2
        turned = quaternion_of_vector(angle * share * axis)
        return fr.BaseState(shift * share, turned, shift * speed, angle * speed * axis)

    return motion


def block(file: Path, edges: Array) -> None:
    """A block of some edges (3,), m."""
    gmsh.initialize([], readConfigFiles=False)
    gmsh.option.setNumber("General.Terminal", 0)
    try:
        gmsh.model.occ.addBox(*(-edges / 2), *edges)
        gmsh.model.occ.synchronize()
        whole = gmsh.model.addPhysicalGroup(3, [tag for _, tag in gmsh.model.getEntities(3)])
        gmsh.model.setPhysicalName(3, whole, "body")
        gmsh.option.setNumber("Mesh.MeshSizeMax", float(edges.max()))
        gmsh.model.mesh.generate(3)
        gmsh.write(str(file))
    finally:
        gmsh.finalize()


def ground(file: Path, rng: np.random.Generator) -> None:
    """A slab whose top is rough, as STL."""
    x = np.linspace(-SIZE / 2, SIZE / 2, SQUARES + 1)
    top = np.stack([*np.meshgrid(x, x, indexing="ij"), rng.uniform(-0.006, 0.006, (SQUARES + 1,) * 2)], axis=-1)
    low = top * [1, 1, 0] - [0, 0, 0.05]
    faces = [*squares(top), *(each[::-1] for each in squares(low))]
    for rim in (top[:, 0], top[-1, :], top[::-1, -1], top[0, ::-1]):
        down = rim * [1, 1, 0] - [0, 0, 0.05]
        for a, b, c, d in zip(rim[:-1], rim[1:], down[:-1], down[1:], strict=True):
            faces += [np.array([a, c, b]), np.array([b, c, d])]
    corners = np.array(faces)
    rows = np.zeros(len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("none", "<u2")])
    rows["corners"] = corners
    file.write_bytes(bytes(80) + np.uint32(len(rows)).tobytes() + rows.tobytes())


def squares(lattice: Array) -> list[Array]:
    """Two triangles (3, 3) of each square of a lattice (n, n, 3), seen from above."""
    a, b, c, d = (lattice[i : i + SQUARES, j : j + SQUARES].reshape(-1, 3) for i, j in ((0, 0), (1, 0), (0, 1), (1, 1)))
    return [np.array(each) for triangle in ((a, b, d), (a, d, c)) for each in zip(*triangle, strict=True)]


if __name__ == "__main__":
    main()
