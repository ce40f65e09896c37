"""Obstacles that turn: a screw drives a soft nut, and rollers feed a soft sheet by friction.

    python demos/feed/feed.py           # two minutes
    python demos/feed/feed.py --quick   # larger steps, shorter ways

Everything is written to demos/feed/out/. The checks at the end fail if a claim does not hold.
"""

import argparse
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import gmsh
import matplotlib.pyplot as plt
import numpy as np
from numpy import ndarray as Array

import fenics_rom as fr
from fenics_rom.io.markdown import markdown
from fenics_rom.scene.file import parse_scene

HERE = Path(__file__).parent
PITCH, CORE, THREAD, TURNS = 0.01, 0.018, 2e-3, 8  # m, of the screw, whose threads are a sine, and how many it has
AROUND, ALONG = 32, 12  # triangles around it, and along a pitch
NUT, TOOTH = (0.02, 0.008, 0.008), 5e-3  # m: its block, and how far two teeth stick out of it, a pitch apart
SHEET, ROLLER, APART = (0.2, 0.02, 0.004), 0.02, 0.05  # m: the sheet, radius of two rollers, half of their distance
CLEARANCE, LOAD = 2e-5, 0.05  # m, of the teeth; N, against which the nut goes
RAMP = 0.2  # s, in which a speed is reached
FRICTION = 0.5
SCENE = """
frame = "{frame}"
[mesh]
file = "{file}"
[material]
young = {young}
poisson = 0.3
density = 1000.0
[contacts.skin]
{place}
[effects]
inertia = {{}}
damping = {{ alpha = 0.0, beta = 2e-3 }}
"""
SCREW = """
[effects.prescribed.load]
point = [{end}, 0, {middle}]
force = [-{load}, 0, 0]
[[supports.held]]
plane = {{ point = [0, 0, {top}], normal = [0, 0, 1] }}
normal = [0, 0, 1]
[[supports.held]]
plane = {{ point = [0, 0, {top}], normal = [0, 0, 1] }}
normal = [0, 1, 0]
[effects.contact.obstacles.screw]
shape = "mesh"
file = "screw.stl"
motion = {{}}
"""
ROLLERS = """
[effects.gravity]
acceleration = [0, 0, -9.81]
[effects.friction]
coefficient = {friction}
[effects.contact.obstacles.first]
shape = "capsule"
start = [-{apart}, -0.05, 0]
end = [-{apart}, 0.05, 0]
radius = {radius}
motion = {{ origin = [-{apart}, 0, 0] }}
[effects.contact.obstacles.second]
shape = "capsule"
start = [{apart}, -0.05, 0]
end = [{apart}, 0.05, 0]
radius = {radius}
motion = {{ origin = [{apart}, 0, 0] }}
"""

Part = tuple[str, tuple[float, float, float], tuple[float, float, float]]


class Fed(NamedTuple):
    """What was fed along x."""

    times: Array  # (n,), s
    places: Array  # of its middle (n,), m
    rate: float  # of what turns, rad/s
    balance: float  # what the energy account misses, of the work
    shape: tuple[fr.Rom, Array, Array]  # its model, where its nodes are in the end (N, 3), m, and poses of obstacles


def main() -> None:
    """Runs the demo; exits with 1 where a claim fails."""
    parser = argparse.ArgumentParser(description="What a screw and rollers feed.")
    parser.add_argument("--quick", action="store_true", help="larger steps, shorter ways")
    quick = parser.parse_args().quick
    out = HERE / "out" / "quick" if quick else HERE / "out"
    out.mkdir(parents=True, exist_ok=True)
    nut, sheet = drive(out, quick), feed(out, quick)
    turn = 2 * math.pi / nut.rate
    advance = nut.places[-1] - np.interp(nut.times[-1] - turn, nut.times, nut.places)
    last = sheet.times > sheet.times[-1] / 2
    speed = float(np.polyfit(sheet.times[last], sheet.places[last], 1)[0])
    off = abs(advance / PITCH - 1), abs(speed / (sheet.rate * ROLLER) - 1)
    heads = ("", "found", "expected", "off by", "account")
    of_nut = f"{1e3 * advance:.4f} mm", f"{1e3 * PITCH:g} mm, the pitch", f"{off[0]:.1e}", f"{nut.balance:.0e}"
    expected = f"{1e3 * sheet.rate * ROLLER:g} mm/s, ω R"
    of_sheet = f"{1e3 * speed:.2f} mm/s", expected, f"{off[1]:.1e}", f"{sheet.balance:.0e}"
    print(markdown(heads, [("advance of the nut in a turn", *of_nut), ("speed of the sheet", *of_sheet)]))
    draw(nut, sheet, out / "feed.png")
    claims = [
        ("a turn of the screw advances the nut by a pitch, to 0.5 %", off[0] < 5e-3),
        ("the sheet goes as fast as the rollers' surface, to 0.5 %", off[1] < 5e-3),
        ("energy accounts close to 1e-12 of the work", max(nut.balance, sheet.balance) < 1e-12),
    ]
    for claim, holds in claims:
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    sys.exit(0 if all(holds for _, holds in claims) else 1)


def drive(out: Path, quick: bool) -> Fed:
    """A nut with two teeth in the threads of a screw, on a rail along it, against a load and without friction."""
    (length, wide, high), root = NUT, CORE - THREAD + CLEARANCE + TOOTH
    parts = [("box", (PITCH / 2 - length / 2, -wide / 2, root), NUT)]
    parts += [("tooth", (x, -wide / 2, root), (0.6 * PITCH, wide, TOOTH)) for x in (0.0, PITCH)]
    mesh(out / "nut.msh", parts, 4e-3)
    write_screw(out / "screw.stl")
    near = f"near = {{ point = [{PITCH / 2}, 0, {root - TOOTH}], radius = 0.009 }}"
    held = SCREW.format(end=PITCH / 2 + length / 2, middle=root + high / 2, load=LOAD, top=root + high)
    scene = SCENE.format(frame="fixed", file="nut.msh", young=1e6, place=near) + held
    rom = fr.reduce(fr.assemble(parse_scene(scene, folder=out)), order=8)
    return run(rom, 2e-3 if quick else 1e-3, 1.75 if quick else 2.5, 4 * math.pi, {"screw": 0.0})


def feed(out: Path, quick: bool) -> Fed:
    """A sheet on two rollers."""
    long, wide, _ = SHEET
    mesh(out / "sheet.msh", [("box", (-long / 2 - APART / 2, -wide / 2, ROLLER), SHEET)], 1e-2 if quick else 5e-3)
    rollers = ROLLERS.format(friction=FRICTION, apart=APART, radius=ROLLER)
    scene = (
        SCENE.format(
            frame="moving",
            file="sheet.msh",
            young=3e7,
            place=f"plane = {{ point = [0, 0, {ROLLER}], normal = [0, 0, 1] }}",
        )
        + rollers
    )
    rom = fr.reduce(fr.assemble(parse_scene(scene, folder=out)), order=8)
    turns = 0.25 if quick else 0.5
    return run(rom, 2e-3 if quick else 1e-3, turns, 6.0, {"first": -APART, "second": APART})


def run(rom: fr.Rom, dt: float, turns: float, rate: float, axes: dict[str, float]) -> Fed:
    """A body at rest, while obstacles turn at a rate, rad/s, about axes: of a screw x, of rollers y."""
    nothing, is_screw = np.zeros(3), "screw" in axes

    def motion(x: float) -> Callable[[float], fr.BaseState]:
        def pose(time: float) -> fr.BaseState:
            share = min(time / RAMP, 1.0)
            angle = rate * (time - RAMP / 2) if time > RAMP else rate * RAMP * share**2 / 2
            axis = np.array([1.0, 0.0, 0.0]) if is_screw else np.array([0.0, 1.0, 0.0])
            turned = np.array([math.cos(angle / 2), *(math.sin(angle / 2) * axis)])
            return fr.BaseState(np.array([x, 0.0, 0.0]), turned, nothing, rate * share * axis)

        return pose

    body = fr.Simulator(rom, dt, signals={name: motion(x) for name, x in axes.items()})
    steps, places, begun = round((turns * 2 * math.pi / rate + RAMP / 2) / dt), [], body.energy
    assert body.environment is not None
    assert body.ledger is not None
    for _ in range(steps):
        body.step()
        places.append(float((rom.nodes + body.displacement())[:, 0].mean()))
    gone = body.ledger
    left = body.energy - begun - gone.supplied + gone.dissipated
    known = rom, rom.nodes + body.displacement(), body.environment.state.offsets
    return Fed(dt * np.arange(1, steps + 1), np.array(places), rate, abs(left) / abs(gone.supplied), known)


def mesh(file: Path, parts: Sequence[Part], size: float) -> None:
    """Boxes by corner and edges, teeth by the middle of their root and width, depth, height; edges of a size, m."""
    gmsh.initialize([], readConfigFiles=False)
    gmsh.option.setNumber("General.Terminal", 0)
    try:
        model, solids = gmsh.model.occ, []
        for kind, (x, y, z), (a, b, c) in parts:
            if kind == "box":
                solids.append((3, model.addBox(x, y, z, a, b, c)))
                continue
            corners = [model.addPoint(x + side, y, z - down) for side, down in ((-a / 2, 0), (0, c), (a / 2, 0))]
            lines = [model.addLine(corners[k], corners[(k + 1) % 3]) for k in range(3)]
            face = model.addPlaneSurface([model.addCurveLoop(lines)])
            solids.append(model.extrude([(2, face)], 0, b, 0)[1])
        if len(solids) > 1:
            model.fuse(solids[:1], solids[1:])
        model.synchronize()
        whole = gmsh.model.addPhysicalGroup(3, [tag for _, tag in gmsh.model.getEntities(3)])
        gmsh.model.setPhysicalName(3, whole, "body")
        gmsh.option.setNumber("Mesh.MeshSizeMax", size)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(file))
    finally:
        gmsh.finalize()


def screw() -> tuple[Array, Array]:
    """Vertices (V, 3), m, and triangles (T, 3) of a rod along x whose radius is a sine of x/pitch - turns around it."""
    x = np.linspace(-TURNS / 2, TURNS / 2, TURNS * ALONG + 1) * PITCH
    around = 2 * np.pi * np.arange(AROUND) / AROUND
    radius = CORE - THREAD * np.cos(2 * np.pi * x[:, None] / PITCH - around)
    side = np.stack(
        [np.broadcast_to(x[:, None], radius.shape), radius * np.sin(around), radius * np.cos(around)], axis=-1
    )
    a = (AROUND * np.arange(len(x) - 1)[:, None] + np.arange(AROUND)).ravel()
    b = (AROUND * np.arange(len(x) - 1)[:, None] + (np.arange(AROUND) + 1) % AROUND).ravel()
    rows, after = np.arange(AROUND), (np.arange(AROUND) + 1) % AROUND
    ends = len(x) * AROUND, (len(x) - 1) * AROUND
    caps = [[np.full(AROUND, ends[0]), rows, after], [np.full(AROUND, ends[0] + 1), ends[1] + after, ends[1] + rows]]
    sides = [[a, a + AROUND, b], [b, a + AROUND, b + AROUND]]
    triangles = np.concatenate([np.stack(each, axis=1) for each in (*sides, *caps)])
    vertices = np.concatenate([side.reshape(-1, 3), [[x[0], 0, 0], [x[-1], 0, 0]]])
    middle, corners = vertices.mean(axis=0), vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if (normals * (corners.mean(axis=1) - middle)).sum() < 0:
        triangles = triangles[:, ::-1]
    return vertices, triangles


def write_screw(file: Path) -> None:
    """As binary STL, in m."""
    vertices, triangles = screw()
    rows = np.zeros(len(triangles), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("none", "<u2")])
    rows["corners"] = vertices[triangles]
    file.write_bytes(bytes(80) + np.uint32(len(triangles)).tobytes() + rows.tobytes())


def draw(nut: Fed, sheet: Fed, file: Path) -> None:
    """Both from the side, and how far they went."""
    figure, axes = plt.subplots(2, 2, figsize=(10, 5), layout="constrained", width_ratios=(1.6, 1))
    rom, nodes, poses = nut.shape
    x = np.linspace(-TURNS / 2, TURNS / 2, 400) * PITCH
    turned = -2 * math.atan2(poses[0, 4], poses[0, 3])
    axes[0, 0].fill_between(
        1e3 * x, 1e3 * (CORE - THREAD * np.cos(2 * np.pi * x / PITCH - turned)), 12, color="#bdbdbd"
    )
    axes[1, 0].set(xlabel="x (mm)")
    for x0 in (-APART, APART):
        axes[1, 0].add_patch(plt.Circle((1e3 * x0, 0), 1e3 * ROLLER, color="#bdbdbd"))
    for view, fed in ((axes[0, 0], nut), (axes[1, 0], sheet)):
        rom, nodes, _ = fed.shape
        view.triplot(*(1e3 * nodes[:, [0, 2]]).T, rom.triangles, color="#3182bd", linewidth=0.5)
        view.set(aspect="equal", ylabel="z (mm)")
        view.autoscale_view()
    ways = (
        (nut, PITCH * nut.rate / 2 / math.pi, "nut, and a pitch a turn"),
        (sheet, sheet.rate * ROLLER, "sheet, and ω R"),
    )
    for view, (fed, speed, label) in zip(axes[:, 1], ways, strict=True):
        view.plot(fed.times, 1e3 * (fed.places - fed.places[0]), label=label.split(",")[0])
        view.plot(fed.times, 1e3 * speed * (fed.times - RAMP / 2).clip(0), "k:", label=label.split(", and ")[1])
        view.set(ylabel="way (mm)")
        view.legend()
        view.grid(alpha=0.3)
    axes[1, 1].set(xlabel="time (s)")
    figure.savefig(file, dpi=80)
    plt.close(figure)


if __name__ == "__main__":
    main()
