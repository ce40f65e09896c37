"""The pads of contact_rates.py: their mesh, what acts on them, and how they settle."""

from dataclasses import dataclass
from pathlib import Path

import gmsh
import numpy as np

import fenics_rom as fr
from fenics_rom.scene.file import parse_scene

SIZE, BRICKS, MORE_BRICKS = (0.20, 0.15, 0.10), (4, 3, 2), (7, 4, 2)  # m; 5 x 4 and 8 x 5 nodes at the bottom
ORDER = 24  # and six rigid motions
DENSITY, GRAVITY = 200.0, 9.81
WEIGHT = DENSITY * SIZE[0] * SIZE[1] * SIZE[2] * GRAVITY
PRESSED = 4 * WEIGHT  # N, with the weight itself
COEFFICIENT = 0.5
STEP = 1e-3  # s

GROUND = 'ground = { shape = "half-space", point = [0, 0, 0], normal = [0, 0, 1] }'
BALL = 'ball = { shape = "sphere", center = [0.1, 0.075, -10.0], radius = 10.0 }'
WALL = 'wall = { shape = "half-space", point = [0.9, 0, 0], normal = [-1, 0, 0] }'
FAR = 'ground = { shape = "half-space", point = [0, 0, -1000.0], normal = [0, 0, 1] }'

BODY = """
name = "pad"
[mesh]
file = "{file}"
[material]
young = 1.0e5       # Pa
poisson = 0.1
density = {density}     # kg/m3
[contacts.bottom]
surface = "bottom"
[effects]
inertia = {{}}
damping = {{ alpha = 5.0, beta = 1e-2 }}   # 1/s, s
"""
LOADS = """
gravity = {{ acceleration = [0, 0, -{gravity}] }}   # m/s2
[effects.prescribed.press]
surface = "top"
force = [0, 0, {press}]   # N
[effects.prescribed.push]
surface = "bottom"
force = [{push}, 0, 0]   # N
"""
CONTACT = """
[effects.contact]
{law}
[effects.contact.obstacles]
{obstacle}
"""
FRICTION = """
[effects.friction]
coefficient = {coefficient}
"""
RUN = """
[run]
dt = {step}
duration = {duration}
"""


@dataclass(frozen=True)
class Case:
    """What acts on the pad."""

    obstacle: str | None = GROUND
    push: float = 0.0  # of the force at which it would slide
    friction: bool = True
    law: str = ""
    loads: bool = True

    def text(self, file: Path, duration: float) -> str:
        """Its scene."""
        parts = [BODY.format(file=file.name, density=DENSITY)]
        if self.loads:
            push = self.push * COEFFICIENT * PRESSED
            parts.append(LOADS.format(gravity=GRAVITY, press=WEIGHT - PRESSED, push=push))
        if self.obstacle is not None:
            parts.append(CONTACT.format(law=self.law, obstacle=self.obstacle))
            if self.friction:
                parts.append(FRICTION.format(coefficient=COEFFICIENT))
        return "".join([*parts, RUN.format(step=STEP, duration=duration)])


STIFF = "residual_compliance = false"
CASES = {
    "at rest": Case(),
    "sticks": Case(push=0.5),
    "in part slides": Case(push=0.96),
    "slides": Case(push=1.5),
    "on a ball, sticks": Case(BALL, push=0.5),
    "on a ball, slides": Case(BALL, push=1.2),
    "the same, and a wall is there": Case(f"{BALL}\n{WALL}", push=1.2),
    "on a ball, no friction": Case(BALL, friction=False),
    "sticks, without residual compliance": Case(push=0.5, law=STIFF),
    "in part slides, without it": Case(push=0.96, law=STIFF),
    "no friction": Case(friction=False),
    "penalty, sticks": Case(push=0.5, law='method = "penalty"\nstiffness = 1e4\ndamping = 10.0'),
    "nothing in reach": Case(FAR),
    "loads alone": Case(None),
    "neither": Case(None, loads=False),
}
ON_THE_GROUND = ("at rest", "sticks", "in part slides", "slides")


def mesh(file: Path, bricks: tuple[int, int, int]) -> None:
    """Writes the mesh of the pad: so many bricks of tetrahedra, with the surfaces "bottom" and "top"."""
    gmsh.initialize([], readConfigFiles=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        geo, (lx, ly, lz), (nx, ny, nz) = gmsh.model.geo, SIZE, bricks
        corners = [geo.addPoint(x, y, 0) for x, y in ((0, 0), (lx, 0), (lx, ly), (0, ly))]
        lines = [geo.addLine(corners[k], corners[(k + 1) % 4]) for k in range(4)]
        for line, count in zip(lines, (nx, ny, nx, ny), strict=True):
            geo.mesh.setTransfiniteCurve(line, count + 1)
        bottom = geo.addPlaneSurface([geo.addCurveLoop(lines)])
        geo.mesh.setTransfiniteSurface(bottom)
        (_, top), (_, body), *_ = geo.extrude([(2, bottom)], 0, 0, lz, numElements=[nz])
        geo.synchronize()
        for dimension, tag, name in ((2, bottom, "bottom"), (2, top, "top"), (3, body, "body")):
            gmsh.model.setPhysicalName(dimension, gmsh.model.addPhysicalGroup(dimension, [tag]), name)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(file))
    finally:
        gmsh.finalize()


def scene(case: Case, file: Path, duration: float) -> fr.Scene:
    """The scene of a case."""
    return parse_scene(case.text(file, duration), folder=file.parent, source="pad")


def settled(rom: fr.Rom, scene: fr.Scene, steps: int) -> fr.Simulator:
    """A pad that has been pressed and pushed for some steps."""
    body = fr.Simulator(rom, STEP, scene=scene)
    for _ in range(steps):
        body.step(np.zeros(body.inputs) if body.environment is None else ())
    return body
