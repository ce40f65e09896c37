"""The bodies that are learned with: a soft arm with tendons that bends far, the same among pegs, a finger that lifts.

The arm is that of Elastica's benchmarks in size, stiffness and density (1 m long, 8 cm wide, 10 MPa, 1000 kg/m³), with
eight tendons in place of muscles: four end in its middle, four at its tip. Making them needs FEniCSx and Gmsh.
"""

from pathlib import Path

import fenics_rom as fr
from fenics_rom.errors import SceneError, check_known

LENGTH, WIDTH = 1.0, 0.08  # m
BRICKS = 12  # along the arm, of six tetrahedra each
SECTIONS = 0.5, 0.98  # m, where tendons end
SIDES = {"left": (0.03, 0.0), "right": (-0.03, 0.0), "up": (0.0, 0.03), "down": (0.0, -0.03)}  # their y and z, m
TENDONS = tuple(f"{side}{k + 1}" for k in range(len(SECTIONS)) for side in SIDES)
TENSION = {"far": 500.0, "pegs": 120.0}  # N, the largest
ORDER = 20
PEG_RADIUS, PEG_CIRCLE = 0.045, 0.13  # m; of their axes

ARM = """
name = "arm"
[mesh]
file = "{file}"
degree = 2
[material]
young = 1.0e7       # Pa
poisson = 0.45
density = 1000.0    # kg/m3
[supports]
clamped = ["root"]
[contacts.end]
near = {{ point = [1.0, 0.0, 0.0], radius = 0.13 }}
[outputs.line]
points = {line}
[outputs.tip]
points = [[1.0, 0.0, 0.0], [0.95, 0.0, 0.0]]
{effects}
{tendons}
"""
EFFECTS = {
    "far": """
[effects]
inertia = {}
damping = { alpha = 1.0, beta = 5e-3 }   # 1/s, s
large_deformation = { material = "st_venant_kirchhoff" }
[reduction]
method = "modal+derivatives"
""",
    "pegs": """
[effects]
inertia = {}
damping = { alpha = 1.0, beta = 5e-3 }   # 1/s, s
friction = { coefficient = 0.3 }
[effects.contact.obstacles]
""",
}
PEG = '{name} = {{ shape = "capsule", start = [0.85, {y}, {z}], end = [1.1, {y}, {z}], radius = {radius} }}\n'
PEGS = {  # where their axes are, y and z, m: along the arm, around its end
    name: (a * PEG_CIRCLE / 2**0.5, b * PEG_CIRCLE / 2**0.5)
    for name, a, b in (("first", 1, 1), ("second", -1, 1), ("third", -1, -1), ("fourth", 1, -1))
}

FINGER = """
name = "lifting finger"
[mesh]
file = "{file}"
degree = 2
[material]
young = 1.0e6       # Pa
poisson = 0.45
density = 1070.0    # kg/m3
[supports]
clamped = ["root"]
[contacts.upper]             # the end of the upper side
near = {{ point = [0.09, 0.0, 0.025], radius = 0.0195 }}   # m
[outputs.line]
points = [[0.0, 0.0, 0.01], [0.025, 0.0, 0.01], [0.05, 0.0, 0.01], [0.075, 0.0, 0.01], [0.09, 0.0, 0.01]]
[effects]
inertia = {{}}
damping = {{ alpha = 1.0, beta = 2e-3 }}   # 1/s, s
friction = {{ coefficient = 0.5 }}
[effects.tendon.flexor]      # along the lower side: it pulls the tip down
points = [[0.005, 0.0, -0.0075], [0.035, 0.0, -0.0075], [0.065, 0.0, -0.0075], [0.095, 0.0, -0.0075]]
[effects.tendon.extensor]    # along the upper side: it lifts it
points = [[0.005, 0.0, 0.008], [0.035, 0.0, 0.008], [0.065, 0.0, 0.008], [0.095, 0.0, 0.008]]
[effects.contact.obstacles.load]   # a plate that lies on posts, just above the finger
shape = "box"
center = [0.09, 0.0, {height}]
size = {size}
"""
TOUCH = """
[outputs.skin]               # what the end of its upper side feels, as a sensor shows it
quantity = "touch"
near = {{ point = [0.09, 0.0, 0.025], radius = 0.0195 }}
taxels = {{ rows = 2, columns = 4 }}
sensor = {{ rate = 50.0, pressure_noise = 20.0 }}
"""
LOAD_HEIGHT, LOAD_SIZE = 0.0155, [0.03, 0.03, 0.01]  # m, of the middle of the plate on its posts, and of its edges

FINGERS = {"finger": FINGER, "feeling-finger": FINGER + TOUCH}


def make(kind: str, folder: Path) -> Path:
    """Reduces the body "far", "pegs", "plate" or one of FINGERS; the name of its file in a folder, which is kept."""
    check_known("body", kind, (*EFFECTS, *FINGERS, "plate"), SceneError)
    file = folder / f"{kind}.h5"
    if not file.exists():
        fr.write_rom(file, fr.reduce(fr.assemble(scene(kind, folder)), order=ORDER))
    return file


def scene(kind: str, folder: Path) -> fr.Scene:
    """The scene of a body."""
    from fenics_rom.scene.file import parse_scene  # here, as environments need the numbers above where there is none

    if kind == "plate":
        return fr.read_scene(Path(__file__).parents[1] / "plate" / "plate.toml")
    folder = folder.resolve()  # a mesh is looked for beside its scene
    if kind in FINGERS:
        text = FINGERS[kind].format(
            file=Path(__file__).parents[2] / "meshes" / "finger.msh", height=LOAD_HEIGHT, size=LOAD_SIZE
        )
        return parse_scene(text, folder=folder, source=kind)
    mesh = folder / "arm.msh"
    write_mesh(mesh)
    line = [[k / 10 * LENGTH, 0.0, 0.0] for k in range(1, 11)]
    effects = EFFECTS[kind]
    if kind == "pegs":
        effects += "".join(PEG.format(name=name, y=y, z=z, radius=PEG_RADIUS) for name, (y, z) in PEGS.items())
    text = ARM.format(
        file=mesh,
        line=line,
        effects=effects,
        tendons="".join(f"[effects.tendon.{name}]\npoints = {cable(name)}\n" for name in TENDONS),
    )
    if kind == "far":  # a run says how far the arm is to bend
        text += "[run]\ndt = 1e-2\nduration = 1.0\n"
        text += "".join(f'[[run.load]]\nactuator = "{name}"\nforce = [{TENSION[kind]}]\n' for name in TENDONS)
    return parse_scene(text, folder=folder, source=kind)


def cable(name: str) -> list[list[float]]:
    """Points of a tendon, m."""
    end = SECTIONS[int(name[-1]) - 1]
    count = round(end * 6)
    return [[0.02 + (end - 0.02) * k / count, *SIDES[name[:-1]]] for k in range(count + 1)]


def write_mesh(file: Path) -> None:
    """Writes the mesh of the arm, with the surface "root"."""
    import gmsh

    gmsh.initialize([], readConfigFiles=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        geo, a = gmsh.model.geo, WIDTH / 2
        corners = [geo.addPoint(0, y, z) for y, z in ((-a, -a), (a, -a), (a, a), (-a, a))]
        lines = [geo.addLine(corners[k], corners[(k + 1) % 4]) for k in range(4)]
        for line in lines:
            geo.mesh.setTransfiniteCurve(line, 2)
        root = geo.addPlaneSurface([geo.addCurveLoop(lines)])
        geo.mesh.setTransfiniteSurface(root)
        (_, tip), (_, body), *_ = geo.extrude([(2, root)], LENGTH, 0, 0, numElements=[BRICKS])
        geo.synchronize()
        for dimension, tag, name in ((2, root, "root"), (2, tip, "tip"), (3, body, "body")):
            gmsh.model.setPhysicalName(dimension, gmsh.model.addPhysicalGroup(dimension, [tag]), name)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(file))
    finally:
        gmsh.finalize()
