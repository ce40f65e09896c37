"""Soft bodies fall on rough meshes that turn and shake: none ends inside, and none gains energy but by their work.

    python demos/feed/drops.py --drops 10000 --processes 2   # 45 minutes; started again, it goes on
    python demos/feed/drops.py --first 2700 --drops 100      # from this drop on
    python demos/feed/drops.py                               # a hundred, a minute

Each drop has a mesh, a block, a place, an attitude, spins, a friction and a step of 1 to 10 ms by chance. One in four
is thrown at a sheet, so fast that in a step it goes by up to ten times its thickness. Each drop is written to a table
as it ends, and those that are there already are not run again. At the end a table by mesh and step is printed, and the
checks fail if a claim does not hold.
"""

import argparse
import csv
import multiprocessing
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from itertools import groupby, product
from pathlib import Path
from typing import NamedTuple

import gmsh
import numpy as np
from numpy import ndarray as Array

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.io.markdown import markdown
from fenics_rom.mechanics.frame_motion import quaternion_of_vector
from fenics_rom.mechanics.obstacle_poses import seen
from fenics_rom.mechanics.obstacles import Mesh
from fenics_rom.scene.file import parse_scene

HERE = Path(__file__).parent
SIZE, SQUARES, EDGE = 0.2, 12, 0.015  # m and number of triangles' squares, of a ground; m, longest edge of blocks
TOGETHER, DURATION = 25, 0.2  # drops of one mesh and block; s, of each
SLAB, SHEET, FAST, EVERY = 0.05, 1e-3, 10.0, 4  # m, thick; thicknesses a step, at most; which grounds are sheets
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


class Drop(NamedTuple):
    """What came of a drop; a line of the table."""

    number: int
    is_fast: bool  # whether it was thrown at a sheet
    dt: float  # s
    touched: int  # steps that touched
    depth: float  # of the deepest point after any step, m
    passed: int  # points that went through, and ended a step outside
    gain: float  # of energy beyond the work, as a share
    refused: str  # why a step was refused; empty: none was


def main() -> None:
    """Runs the drops; exits with 1 where one ends inside or gains energy."""
    parser = argparse.ArgumentParser(description="Drops on rough meshes that turn.")
    parser.add_argument("--drops", type=int, default=100, help="how many")
    parser.add_argument("--first", type=int, default=0, help="which is the first of them")
    parser.add_argument("--seed", type=int, default=0, help="of what is left to chance")
    parser.add_argument("--processes", type=int, default=1, help="at once")
    parser.add_argument("--quick", action="store_true", help="four drops")
    given = parser.parse_args()
    table, drops = HERE / "out" / f"drops_{given.seed}.csv", 4 if given.quick else given.drops
    table.parent.mkdir(parents=True, exist_ok=True)
    known = {} if given.quick else {each.number: each for each in read(table)}
    numbers = range(given.first, given.first + drops)
    groups = [list(some) for _, some in groupby(numbers, lambda number: number // TOGETHER)]
    groups = [left for some in groups if (left := [number for number in some if number not in known])]
    with table.open("w" if given.quick else "a", newline="") as file:
        for each in run(groups, given.seed, given.processes):
            known[each.number] = each
            csv.writer(file).writerow(each)
            file.flush()
    asked = [each for number, each in known.items() if number in numbers]
    print(by_kind(asked))
    sys.exit(0 if report(asked) else 1)


def read(table: Path) -> Iterator[Drop]:
    """Drops of a table, if there is one; a line that was not written to its end is left out."""
    for row in csv.reader(table.read_text().splitlines()) if table.exists() else ():
        if len(row) == len(Drop._fields):
            number, is_fast, dt, touched, depth, passed, gain, refused = row
            counts, sizes = (int(number), is_fast == "True"), (float(dt), int(touched), float(depth))
            yield Drop(*counts, *sizes, int(passed), float(gain), refused)


def run(groups: list[list[int]], seed: int, processes: int) -> Iterator[Drop]:
    """Runs groups of drops, each of which has a mesh and a block."""
    if processes == 1:
        for some in groups:
            yield from drops_of(some, seed)
        return
    with ProcessPoolExecutor(processes, multiprocessing.get_context("spawn")) as pool:
        for done in pool.map(listed, groups, [seed] * len(groups)):
            yield from done


def listed(numbers: list[int], seed: int) -> list[Drop]:
    """Drops of a group, all at once."""
    return list(drops_of(numbers, seed))


def by_kind(drops: list[Drop]) -> str:
    """A table of what came of them, by mesh and step."""
    rows = []
    for is_fast, (low, high) in product((False, True), ((1, 2), (2, 5), (5, 10))):
        some = [each for each in drops if each.is_fast is is_fast and low <= 1e3 * each.dt < high]
        if some:
            name, worst = "a sheet, thrown" if is_fast else "a slab", max(some, key=lambda each: each.depth)
            counts = len(some), sum(each.touched for each in some)
            largest = f"{worst.depth:.1e} m", sum(each.passed for each in some), f"{max(e.gain for e in some):.1e}"
            rows.append((name, f"{low} to {high} ms", *counts, *largest, sum(bool(each.refused) for each in some)))
    heading = "on", "steps of", "drops", "steps that touched", "deepest", "passed", "gained", "refused a step"
    return markdown(heading, rows)


def report(drops: list[Drop]) -> bool:
    """Prints what came of them; whether all claims hold."""
    for each in drops:
        if each.refused:
            print(f"drop {each.number} was refused: {each.refused}")
    refused, touched = sum(bool(each.refused) for each in drops), sum(each.touched for each in drops)
    deepest, gained = max(each.depth for each in drops), max(each.gain for each in drops)
    passed, fast = sum(each.passed for each in drops), sum(each.is_fast for each in drops)
    print(f"{len(drops)} drops, {fast} of them fast, {touched} steps that touched; {refused} were refused a step")
    claims = [
        (f"no point ends deeper inside than 1e-10 m: {deepest:.1e} m at most", deepest < DEEPEST),
        (f"no point goes through: {passed} did", not passed),
        (f"no energy comes but by the ground's work and weight: {gained:.1e} of it at most", gained < 1e-12),
        ("at most one drop in a hundred is refused a step", refused <= len(drops) / 100),
    ]
    for claim, holds in claims:
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    return all(holds for _, holds in claims)


def drops_of(numbers: list[int], seed: int) -> Iterator[Drop]:
    """Drops of one mesh and one block."""
    warnings.simplefilter("ignore", FenicsRomWarning)
    group = numbers[0] // TOGETHER
    rng, is_fast = np.random.default_rng([seed, group]), group % EVERY == EVERY - 1
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        block(folder / "block.msh", rng.uniform(0.4, 1.0, 3) * EDGE, rng.uniform(0.4, 1.0))
        ground(folder / "ground.stl", SHEET if is_fast else SLAB, rng)
        scene = parse_scene(SCENE.replace("MU", f"{rng.uniform(0, 1):.3f}"), folder=folder)
        rom = fr.reduce(fr.assemble(scene), order=6)
    for number in numbers:
        yield drop(rom, number, is_fast, np.random.default_rng([seed, group, number]))


def drop(rom: fr.Rom, number: int, is_fast: bool, rng: np.random.Generator) -> Drop:
    """Lets the block of a ROM fall, or throws it.

    Points that went through are found by their ways in a step, as the ground sees them.
    """
    still = fr.BaseState(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3))
    body = fr.Simulator(rom, float(10 ** rng.uniform(-3, -2)), signals={"ground": still._replace(position=-np.ones(3))})
    body.set_signal("ground", motion_of(rng))
    body.begin_anew()
    attitude = rng.normal(size=4)
    velocity, place = rng.normal(size=3) / 5, np.array([*rng.uniform(-0.04, 0.04, 2), 0.03])
    if is_fast:  # from two steps away, from above or below
        side, speed = rng.choice([-1.0, 1.0]), rng.uniform(1.0, FAST) * SHEET / body.dt
        velocity, place[2] = velocity - [0, 0, side * speed], side * (0.03 + 2 * speed * body.dt)
    body.place(fr.BaseState(place, attitude / np.linalg.norm(attitude), velocity, 3 * rng.normal(size=3)))
    shape, begun, deepest, touched, lost = rom.environment.obstacles["ground"].shape, body.energy, 0.0, 0, 0.0
    assert isinstance(shape, Mesh)
    assert body.environment is not None
    assert body.ledger is not None
    pose = body.environment.offsets_at(0.0)[0]
    gained, passed, places = 0.0, 0, seen(rom.nodes + body.displacement(), pose)
    for _ in range(round(DURATION / body.dt)):
        try:
            body.step()
        except fr.StepError as error:
            return Drop(number, is_fast, body.dt, touched, deepest, passed, gained, " ".join(str(error).split()))
        touched += body.integrator.contact is not None
        before, places = places, seen(rom.nodes + body.displacement(), body.environment.state.offsets[0])
        gaps, _ = shape.distance(places)
        passed += int(np.count_nonzero((shape.surface.first_crossed(before, places) >= 0) & (gaps > DEEPEST)))
        gone = body.ledger
        scale = max(body.energy, abs(gone.supplied), begun)
        gain = max(body.energy - begun - gone.supplied, lost - gone.dissipated)
        deepest, gained, lost = max(deepest, -float(gaps.min())), max(gained, gain / scale), gone.dissipated
    return Drop(number, is_fast, body.dt, touched, deepest, passed, gained, "")


def motion_of(rng: np.random.Generator) -> Callable[[float], fr.BaseState]:
    """The ground sways about an axis and is shaken, from rest."""
    axis, angle, rate = rng.normal(size=3) * [1, 1, 3], rng.uniform(0, 0.8), rng.uniform(2, 12)
    axis, shift = axis / np.linalg.norm(axis), rng.uniform(-5e-3, 5e-3, 3)

    def motion(time: float) -> fr.BaseState:
        share, speed = (1 - np.cos(rate * time)) / 2, rate * np.sin(rate * time) / 2
        turned = quaternion_of_vector(angle * share * axis)
        return fr.BaseState(shift * share, turned, shift * speed, angle * speed * axis)

    return motion


def block(file: Path, edges: Array, share: float) -> None:
    """A block of some edges (3,), m, in tetrahedra whose edges are a share of its longest."""
    gmsh.initialize([], readConfigFiles=False)
    gmsh.option.setNumber("General.Terminal", 0)
    try:
        gmsh.model.occ.addBox(*(-edges / 2), *edges)
        gmsh.model.occ.synchronize()
        whole = gmsh.model.addPhysicalGroup(3, [tag for _, tag in gmsh.model.getEntities(3)])
        gmsh.model.setPhysicalName(3, whole, "body")
        for bound in ("Min", "Max"):
            gmsh.option.setNumber(f"Mesh.MeshSize{bound}", share * float(edges.max()))
        gmsh.model.mesh.generate(3)
        gmsh.write(str(file))
    finally:
        gmsh.finalize()


def ground(file: Path, thickness: float, rng: np.random.Generator) -> None:
    """A slab or a sheet, m thick at least, whose top is rough, as STL; of a sheet the bottom is, too."""
    x = np.linspace(-SIZE / 2, SIZE / 2, SQUARES + 1)
    top = np.stack([*np.meshgrid(x, x, indexing="ij"), rng.uniform(-0.006, 0.006, (SQUARES + 1,) * 2)], axis=-1)
    low = (top if thickness == SHEET else top * [1, 1, 0]) - [0, 0, thickness]
    faces = [*squares(top), *(each[::-1] for each in squares(low))]
    for rim, down in zip(*(rims(lattice) for lattice in (top, low)), strict=True):
        for a, b, c, d in zip(rim[:-1], rim[1:], down[:-1], down[1:], strict=True):
            faces += [np.array([a, c, b]), np.array([b, c, d])]
    corners = np.array(faces)
    rows = np.zeros(len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("none", "<u2")])
    rows["corners"] = corners
    file.write_bytes(bytes(80) + np.uint32(len(rows)).tobytes() + rows.tobytes())


def rims(lattice: Array) -> list[Array]:
    """Rows at the four sides of a lattice (n, n, 3), one after another around it."""
    return [lattice[:, 0], lattice[-1, :], lattice[::-1, -1], lattice[0, ::-1]]


def squares(lattice: Array) -> list[Array]:
    """Two triangles (3, 3) of each square of a lattice (n, n, 3), seen from above."""
    a, b, c, d = (lattice[i : i + SQUARES, j : j + SQUARES].reshape(-1, 3) for i, j in ((0, 0), (1, 0), (0, 1), (1, 1)))
    return [np.array(each) for triangle in ((a, b, d), (a, d, c)) for each in zip(*triangle, strict=True)]


if __name__ == "__main__":
    main()
