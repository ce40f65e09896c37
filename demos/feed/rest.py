"""What rests, stays: a free soft box in a groove, which is a mesh that is not convex, for a minute.

    python demos/feed/rest.py           # two minutes
    python demos/feed/rest.py --quick   # for a second

It falls into the groove and comes to rest there by friction. From 3 s on it is judged that no node of it is
ever farther than 1 um from where it was.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from feed import HERE, mesh
from numpy import ndarray as Array

import fenics_rom as fr
from fenics_rom.io.markdown import markdown
from fenics_rom.scene.file import parse_scene

SIZE, SLOPE, FALL = (0.1, 0.05, 0.05), 0.1, 1e-3  # m, of the box; of the sides; m
STEP, ALLOWED = 0.01, 1e-6  # s, m
SETTLES, RESTS = 3.0, 60.0  # s
SCENE = """
frame = "moving"
mesh = { file = "box.msh" }
material = { young = 1e5, poisson = 0.3, density = 500.0 }
contacts.bottom = { plane = { point = [0, 0, 0.05], normal = [0, 0, 1] } }
[effects]
inertia = {}
damping = { alpha = 1.0, beta = 2e-3 }
gravity = { acceleration = [0, 0, -9.81] }
friction = { coefficient = 0.5 }
contact = { obstacles = { groove = { shape = "mesh", file = "groove.stl" } } }
"""


def write_groove(file: Path) -> None:
    """As binary STL, in m: a block whose top is a V along y, its line at the origin."""
    profile = np.array([[0, 0], [-0.2, 0.2 * SLOPE], [-0.2, -0.1], [0.2, -0.1], [0.2, 0.2 * SLOPE]])
    front, back = (np.insert(profile, 1, y, axis=1) for y in (-0.2, 0.2))
    after = np.roll(np.arange(5), -1)
    ends = [[end[0], end[k], end[k + 1]] for end in (front, back) for k in (1, 2, 3)]
    sides = [[front[k], front[j], back[k]] for k, j in enumerate(after)]
    sides += [[front[j], back[j], back[k]] for k, j in enumerate(after)]
    corners = np.array(ends + sides)
    inside = np.array([0, 0, -0.05])
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = ((corners.mean(axis=1) - inside) * normals).sum(axis=1) < 0
    corners[inward] = corners[inward][:, ::-1]
    rows = np.zeros(len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("none", "<u2")])
    rows["corners"] = corners
    file.write_bytes(bytes(80) + np.uint32(len(corners)).tobytes() + rows.tobytes())


def moved(rom: fr.Rom, seconds: float) -> tuple[float, float, int]:
    """How far nodes get from where they came to rest, at most and in the end, m; how many points push."""
    body = fr.Simulator(rom, STEP)
    middle = np.array([0.0, 0.0, SLOPE * SIZE[0] / 2 + SIZE[2] / 2 + FALL])
    body.place(fr.BaseState(middle, np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3)))

    def nodes() -> Array:
        places: Array = rom.nodes + body.displacement()
        return places

    for _ in range(round(SETTLES / STEP)):
        body.step()
    begun, last, farthest = nodes(), nodes(), 0.0
    for _ in range(round(seconds / STEP)):
        body.step()
        last = nodes()
        farthest = max(farthest, float(np.linalg.norm(last - begun, axis=1).max()))
    return farthest, float(np.linalg.norm(last - begun, axis=1).max()), int(body.contact_forces().any(axis=1).sum())


def main() -> int:
    """Runs the demo."""
    parser = argparse.ArgumentParser(description="A box at rest in a groove.")
    parser.add_argument("--quick", action="store_true", help="for a second")
    quick = parser.parse_args().quick
    out = HERE / "out" / "quick" if quick else HERE / "out"
    out.mkdir(parents=True, exist_ok=True)
    mesh(out / "box.msh", [("box", (-SIZE[0] / 2, -SIZE[1] / 2, 0.05), SIZE)], 0.025)  # above it
    write_groove(out / "groove.stl")
    rom = fr.reduce(fr.assemble(parse_scene(SCENE, folder=out)), order=12)
    seconds = 1.0 if quick else RESTS
    farthest, end, pushing = moved(rom, seconds)
    heads = "at rest for", "moved at most", "in the end", "points that push"
    print(markdown(heads, [(f"{seconds:g} s", f"{farthest:.0e} m", f"{end:.0e} m", pushing)]))
    holds = farthest < ALLOWED and pushing > 0
    print(f"  {'holds' if holds else 'FAILS'}: no node moves by 1 um in {seconds:g} s")
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
