"""What a new user, or an enemy, might give: each ends in one clear line and status 1 or 2, or in the right number.

Cases are named by kind. Whatever is refused leaves every file as it was.
"""

import os
import re
import shutil
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
import pytest
from bodies import box_arrays, box_surfaces, write_arrays
from rom_files import tampered

import fenics_rom as fr
from fenics_rom.cli.main import main
from fenics_rom.errors import FenicsRomError
from fenics_rom.scene import foreign_file

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
SCENE = """\
name = "block"
[mesh]
file = "block.msh"
[material]
young = 1e5
poisson = 0.3
density = 1000.0
[supports]
clamped = ["left"]
[contacts.tip]
surface = "right"
[outputs.tip]
surface = "right"
[effects]
inertia = {}
damping = { alpha = 1.0 }
gravity = { acceleration = [0, 0, -9.81] }
[reduction]
order = 4
[run]
dt = 0.01
duration = 0.1
[[run.load]]
contact = "tip"
force = [0, 0, 0.1]
"""
in_another_process = foreign_file.read_arrays  # the other tests read in their own
ERROR = re.compile(r"fenics-rom(?: \w+)?: error: ([^\n]+)\n")
BALL = '[effects.contact.obstacles.ball]\nshape = "sphere"\ncenter = [1.5, 0.2, 0.15]\nradius = 0.1\n'
PUSH = '[[run.load]]\ncontact = "tip"\nforce = [0, 0, 0.1]\n'


def points_of(x, y, z):
    return f"points = [[{x}, {y}, {z}]]"


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A block, its scene, its ROM, and runs of both."""
    folder = tmp_path_factory.mktemp("block")
    write_arrays(folder / "block.msh", *box_arrays((1.0, 0.4, 0.3), (2, 1, 1)))
    (folder / "block.toml").write_text(SCENE)
    system = fr.assemble(fr.read_scene(folder / "block.toml"))
    rom = fr.reduce(system)
    fr.write_rom(folder / "rom.h5", rom)
    fr.write_trajectory(folder / "run.h5", fr.simulate(rom))
    fr.write_trajectory(folder / "full.h5", fr.simulate(system))
    return folder


@pytest.fixture
def inside(files, tmp_path, monkeypatch):
    """Works in a copy of them."""
    shutil.copytree(files, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def say(capfd):
    """Runs a command in this process: its exit status and what it printed."""

    def run(*arguments):
        with pytest.raises(SystemExit) as end:
            main([str(argument) for argument in arguments])
        return end.value.code, *capfd.readouterr()

    return run


@pytest.fixture
def refused(inside, say):
    """What is said of a command that cannot be done, and that it changes nothing."""

    def run(*arguments, status=1):
        before = {file: file.lstat().st_mtime_ns for file in Path().rglob("*")}
        code, out, err = say(*arguments)
        assert (code, out) == (status, ""), err
        assert ERROR.fullmatch(err), err
        assert {file: file.lstat().st_mtime_ns for file in Path().rglob("*")} == before
        return ERROR.fullmatch(err)[1]

    return run


def changed(there, instead):
    """The scene with something else in one place; at its end where nothing is to go."""
    assert SCENE.count(there) == 1 or not there
    return SCENE.replace(there, instead) if there else SCENE + instead


# --- scenes -----------------------------------------------------------------------------------------------------------

SCENES = {  # by kind: what is there, what stands there instead, and what is said
    "wrong type, name is a number": ('"block"', "3", "name = 3: use a non-empty string"),
    "wrong type, name is empty": ('"block"', '""', "name = '': use a non-empty string"),
    "wrong type, young is text": ("1e5", '"soft"', "material.young = 'soft': use a finite number > 0, in Pa"),
    "wrong type, young is true": ("1e5", "true", "material.young = True: use a finite number"),
    "wrong type, young is a list": ("1e5", "[1e5]", "material.young = [100000.0]: use a finite number"),
    "wrong type, young is a date": ("1e5", "2024-01-01", "use a finite number > 0, in Pa"),
    "wrong type, gravity is a number": (
        "{ acceleration = [0, 0, -9.81] }",
        "-9.81",
        "effects.gravity = -9.81: use a table, [effects.gravity], of acceleration (a list of 3",
    ),
    "wrong type, acceleration is a number": (
        "[0, 0, -9.81]",
        "-9.81",
        "acceleration = -9.81: use a list of 3, each a finite number, in m/s2, such as [0, 0, -9.81]",
    ),
    "wrong type, force is a number": (
        "[0, 0, 0.1]",
        "1.0",
        "run.load[0].force = 1.0: use a list of at least 1, each a finite number, in N, such as [0, 0, 1.0]",
    ),
    "wrong type, force of texts": ("[0, 0, 0.1]", '["a", "b", "c"]', "run.load[0].force[0] = 'a': use a finite"),
    "wrong type, damping is a number": ("{ alpha = 1.0 }", "1.0", "effects.damping = 1.0: use a table"),
    "wrong type, inertia is true": ("inertia = {}", "inertia = true", "effects.inertia = True: use a table"),
    "wrong type, clamped is a text": ('["left"]', '"left"', "supports.clamped = 'left': use a list"),
    "wrong type, mesh is a text": ('[mesh]\nfile = "block.msh"', 'mesh = "block.msh"', "mesh = 'block.msh': use a"),
    "wrong type, load is a table": ("[[run.load]]", "[run.load]", "run.load = "),
    "wrong type, order is a number with a point": ("order = 4", "order = 4.5", "order = 4.5: use a whole number"),
    "wrong type, material is a list": ("[material]", "[[material]]", "material = "),
    "wrong unit, young in words": ("1e5", '"1e5 Pa"', "material.young = '1e5 Pa': use a finite number"),
    "not finite, young is nan": ("1e5", "nan", "material.young = nan: use a finite number"),
    "not finite, density is inf": ("1000.0", "inf", "material.density = inf: use a finite number"),
    "not finite, force is nan": ("[0, 0, 0.1]", "[0, 0, nan]", "run.load[0].force[2] = nan: use a finite number"),
    "not finite, step is nan": ("dt = 0.01", "dt = nan", "run.dt = nan: use a finite number"),
    "not finite, duration is inf": ("duration = 0.1", "duration = inf", "run.duration = inf: use a finite"),
    "not finite, gravity is inf": ("-9.81", "-inf", "effects.gravity.acceleration[2] = -inf: use a finite"),
    "out of range, no stiffness": ("1e5", "0.0", "material.young = 0.0: use a finite number > 0"),
    "out of range, negative stiffness": ("1e5", "-1e5", "material.young = -100000.0: use a finite number > 0"),
    "out of range, negative mass": ("1000.0", "-1000.0", "material.density = -1000.0: use a finite number > 0"),
    "out of range, nu is 0.5": ("0.3", "0.5", "material.poisson = 0.5: use a finite number > -1 and < 0.5"),
    "out of range, nu is 0.7": ("0.3", "0.7", "material.poisson = 0.7: use"),
    "out of range, nu is -1": ("0.3", "-1.0", "material.poisson = -1.0: use"),
    "out of range, negative damping": ("alpha = 1.0", "alpha = -1.0", "effects.damping.alpha = -1.0: use"),
    "out of range, no order": ("order = 4", "order = 0", "reduction.order = 0: use a whole number >= 1"),
    "out of range, tolerance of 1": ("order = 4", "tolerance = 1.0", "reduction.tolerance = 1.0: use"),
    "out of range, degree 3": ('"block.msh"', '"block.msh"\ndegree = 3', "mesh.degree = 3: use a whole number"),
    "out of range, negative step": ("dt = 0.01", "dt = -0.01", "run.dt = -0.01: use a finite number > 0"),
    "out of range, step longer than the run": ("dt = 0.01", "dt = 0.10000001", "run.dt = 0.10000001: use at most"),
    "out of range, radius of no size": ("", BALL.replace("0.1\n", "0.0\n"), "ball.radius = 0.0: use a finite"),
    "out of range, box of zero thickness": (
        "",
        '[effects.contact.obstacles.plate]\nshape = "box"\ncenter = [0, 0, 2]\nsize = [1, 1, 0]\n',
        "effects.contact.obstacles.plate.size[2] = 0: use a finite number > 0, in m",
    ),
    "out of range, normal of no length": (
        "",
        '[effects.contact.obstacles.floor]\nshape = "half-space"\npoint = [0, 0, -1]\nnormal = [0, 0, 0]\n',
        "floor: halfspace: normal: use a vector of any length but 0",
    ),
    "huge number, young of 1e300": ("1e5", "1e300", "material.young = 1e+300: use 0 or a size from 1e-50 to 1e+50"),
    "huge number, density of 1e-300": ("1000.0", "1e-300", "density = 1e-300: use 0 or a size from 1e-50"),
    "huge number, 1e400": ("1e5", "1e400", "material.young = inf: use a finite number"),
    "huge number, whole number of 400 digits": ("1e5", "1" + 400 * "0", "material.young = 1000"),
    "unknown key, yung": (
        "young",
        "yung",
        "material: no key 'yung'; there is density, expansion, fibres, poisson, young; did you mean 'young'?",
    ),
    "unknown key, at the top": ("name", "nmae", "no key 'nmae'; there is"),
    "unknown key, effect": ("gravity", "gravty", "effects: no key 'gravty'; there is"),
    "unknown key, of a load": ("force = [0, 0, 0.1]", "forces = [0, 0, 0.1]", "run.load[0]: no key 'forces'; there is"),
    "unknown name, surface": (
        '"right"\n[out',
        '"rigth"\n[out',
        "no surface 'rigth'; there is back, bottom, front, left",
    ),
    "unknown name, contact": (
        'contact = "tip"',
        'contact = "tipp"',
        "run.load[0].contact: no contact mode 'tipp'; there",
    ),
    "unknown name, clamped": ('["left"]', '["wall"]', "no surface 'wall'; there is back, bottom"),
    "unknown choice, shape": (
        "",
        BALL.replace("sphere", "ball"),
        "ball.shape: no choice 'ball'; there is box, capsule",
    ),
    "empty table, no contacts": ('[contacts.tip]\nsurface = "right"\n', "[contacts]\n", "at least one contact mode is"),
    "empty table, no material": ("young = 1e5\npoisson = 0.3\ndensity = 1000.0\n", "", "material: young is missing"),
    "empty table, contact": (
        'surface = "right"\n[out',
        "\n[out",
        "contacts.tip: give exactly one of surface, near, plane, facing, box, along, inner, all, any, none, together",
    ),
    "empty table, gravity": ("{ acceleration = [0, 0, -9.81] }", "{}", "effects.gravity: acceleration is missing"),
    "empty table, no obstacles": (
        "inertia = {}",
        "inertia = {}\ncontact = {}",
        "effects.contact.obstacles: at least one is needed",
    ),
    "missing, mesh": ('[mesh]\nfile = "block.msh"\n', "", "mesh is missing"),
    "missing, density": ("density = 1000.0\n", "", "material: density is missing"),
    "closed table, contact in braces": (
        "[reduction]",
        f"contact = {{ restitution = 0.5 }}\n{BALL}[reduction]",
        "[effects.contact.obstacles.ball] adds to effects.contact = { ... }, which is closed; write its keys in",
    ),
    "duplicate name, two contacts": ("", '[contacts.tip]\nsurface = "top"\n', "is not TOML: Cannot declare"),
    "duplicate name, two keys": ("young = 1e5", "young = 1e5\nyoung = 2e5", "is not TOML: Cannot overwrite a value"),
    "duplicate name, actuator and effect": (
        "",
        '[actuators.air]\nsurface = "top"\n[effects.pressure.air]\nsurface = "top"\n',
        "effects.pressure.air: the name is taken by actuators.air",
    ),
    "both, order and tolerance": (
        "order = 4",
        "order = 4\ntolerance = 1e-3",
        "reduction: give order or tolerance, not both",
    ),
    "both, surface and near": (
        'surface = "right"\n[out',
        'surface = "right"\nnear = { point = [1, 0, 0], radius = 1 }\n[out',
        "any, none, together (got surface, near)",
    ),
    "wrong shape, two numbers": ("[0, 0, -9.81]", "[0, -9.81]", "acceleration is a list of 2: use a list of 3"),
    "wrong shape, force of two numbers": (
        "[0, 0, 0.1]",
        "[0, 0.1]",
        "contact mode 'tip': use 3 numbers in its force (got 2)",
    ),
    "wrong shape, point of four numbers": (
        '[outputs.tip]\nsurface = "right"',
        f"[outputs.tip]\n{points_of(1, 0, '0, 0')}",
        "list of 4",
    ),
    "name, with a slash": ("[contacts.tip]", '[contacts."a/b"]', "contacts: name 'a/b': use letters, digits"),
    "name, empty": ("[contacts.tip]", '[contacts.""]', "contacts: name '': use letters, digits"),
    "name, of 101 letters": ("[contacts.tip]", f"[contacts.{101 * 'a'}]", "use letters, digits, _ and -, at most 100"),
    "far away, output off the body": (
        '[outputs.tip]\nsurface = "right"',
        f"[outputs.tip]\n{points_of(5, 5, 5)}",
        "outputs.tip",
    ),
    "far away, contact near nothing": (
        'surface = "right"\n[out',
        "near = { point = [9, 9, 9], radius = 0.1 }\n[out",
        "contacts.tip",
    ),
    "syntax, no TOML": ("[mesh]", "[mesh", "is not TOML: Expected ']' at the end of a table declaration (at line 2"),
    "syntax, nested too deeply": ("1e5", 5000 * "[", "is nested too deeply"),
    "syntax, a control character": ('"block"', '"bl\0ock"', "is not TOML"),
    "syntax, too long": ("", "#" * 70_000, "is too long; use at most 60000 bytes"),
}


@pytest.mark.parametrize("kind", SCENES)
def test_scene_is_refused_in_one_line(inside, refused, kind):
    there, instead, said = SCENES[kind]
    Path("block.toml").write_text(changed(there, instead))
    assert said in refused("simulate", "block.toml", "-o", "out.h5")


RIGHT_SCENES = {  # what may look odd, and says the same
    "byte order mark": lambda text: b"\xef\xbb\xbf" + text.encode(),
    "CRLF": lambda text: text.replace("\n", "\r\n").encode(),
    "unicode name and comments": lambda text: text.replace('"block"', '"Prüfling \u200b σ" # ½ ✓').encode(),
    "whole numbers": lambda text: text.replace("1e5", "100_000").replace("1000.0", "1000").encode(),
    "keys in quotes": lambda text: text.replace("young", '"young"').encode(),
    "no line at the end": lambda text: text.rstrip().encode(),
    "tables in braces": lambda text: text.replace("[supports]\nclamped", "[supports]\n clamped\t").encode(),
}


@pytest.mark.parametrize("kind", RIGHT_SCENES)
def test_scene_that_looks_odd_gives_the_same_number(inside, say, kind):
    Path("odd µ.toml").write_bytes(RIGHT_SCENES[kind](SCENE))
    assert say("reduce", "odd µ.toml", "-o", "same one.h5")[0] == 0
    again, rom = fr.read_rom("same one.h5"), fr.read_rom("rom.h5")
    np.testing.assert_array_equal(again.contact_models["tip"].eigenvalues, rom.contact_models["tip"].eigenvalues)


def test_number_is_told_as_it_was_given(inside, say):
    """Not as 0.5, which would be refused."""
    Path("block.toml").write_text(changed("0.3", "0.4999999"))
    status, out, _ = say("reduce", "block.toml", "-o", "out.h5")
    assert status == 0
    assert "Poisson's ratio 0.4999999 on degree 1 tetrahedra" in out


# --- meshes -----------------------------------------------------------------------------------------------------------

POINTS, CELLS = box_arrays((1.0, 0.4, 0.3), (2, 1, 1))
FACES = np.sort(CELLS[:, [(1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)]].reshape(-1, 3), axis=1)
INSIDE = next(face for face in FACES if (face == FACES).all(axis=1).sum() == 2)  # of two cells
MESH = Path("block.msh")


def write_msh(points=POINTS, cells=CELLS, surfaces=None):
    """Gmsh's format 2.2, whatever the arrays are; groups are those of the block where none are given."""
    surfaces = box_surfaces(POINTS, CELLS) if surfaces is None else surfaces
    triangles = [(2, k, face) for k, faces in enumerate(surfaces.values(), start=1) for face in faces]
    elements = triangles + [(4, 0, cell) for cell in cells]
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat"]
    if surfaces:
        names = [f'2 {k} "{name}"' for k, name in enumerate(surfaces, start=1)]
        lines += ["$PhysicalNames", str(len(names)), *names, "$EndPhysicalNames"]
    nodes = [f"{k} {x!r} {y!r} {z!r}" for k, (x, y, z) in enumerate(np.asarray(points, dtype=float).tolist(), start=1)]
    lines += ["$Nodes", str(len(nodes)), *nodes, "$EndNodes", "$Elements", str(len(elements))]
    for k, (kind, group, corners) in enumerate(elements, start=1):
        lines.append(f"{k} {kind} 2 {group} {group + 1} {' '.join(str(corner + 1) for corner in corners)}")
    MESH.write_text("\n".join([*lines, "$EndElements", ""]))


def replaced(old, new):
    text = MESH.read_text()
    assert old in text
    MESH.write_text(text.replace(old, new, 1))


def is_pipe():
    MESH.unlink()
    os.mkfifo(MESH)


def is_folder():
    MESH.unlink()
    MESH.mkdir()


NO_MSH = "is not in Gmsh's MSH format, version 2 or 4"
CRASHES_GMSH = "a node that is not there"
MESHES = {
    "missing": (MESH.unlink, "mesh file block.msh: not found"),
    "a folder": (is_folder, "not found"),
    "a pipe": (is_pipe, "not found"),
    "empty": (lambda: MESH.write_bytes(b""), NO_MSH),
    "binary garbage": (lambda: MESH.write_bytes(bytes(range(256)) * 40), NO_MSH),
    "text": (lambda: MESH.write_text("solid block\nendsolid\n"), NO_MSH),
    "a ROM": (lambda: shutil.copy("rom.h5", MESH), NO_MSH),
    "a scene": (lambda: shutil.copy("block.toml", MESH), NO_MSH),
    "cut short": (lambda: MESH.write_bytes(MESH.read_bytes()[:700]), "ends within $Elements: it was cut"),
    "version 9": (lambda: replaced("4.1 0 8", "9.0 0 8"), "Gmsh c"),
    "no groups": (lambda: write_msh(surfaces={}), "no surface 'left'; there is none: the file has no physical groups"),
    "no tetrahedra": (lambda: write_msh(cells=CELLS[:0]), "holds no tetrahedra"),
    "flat cells": (lambda: write_msh(POINTS * [1, 1, 0]), "12 of 12 cells have no volume"),
    "a point that is nan": (
        lambda: write_msh(np.where(POINTS == 0.4, np.nan, POINTS)),
        "coordinates that are not finite",
    ),
    "a point at infinity": (
        lambda: write_msh(np.where(POINTS == 0.4, np.inf, POINTS)),
        "coordinates that are not finite",
    ),
    CRASHES_GMSH: (lambda: write_msh(POINTS[:-1]), "Gmsh c"),
    "a surface that is empty": (
        lambda: write_msh(surfaces={"left": CELLS[:1, :3]}),
        "no surface 'right'; there is left",
    ),
    "a surface inside": (lambda: write_msh(surfaces={"left": [INSIDE], "right": [INSIDE]}), "boundary"),
    "a node far off": (lambda: write_msh(POINTS + 9.0 * (np.arange(len(POINTS)) == 4)[:, None]), "overlap"),
}


@pytest.mark.parametrize("kind", MESHES)
def test_mesh_is_refused_in_one_line(inside, refused, monkeypatch, kind):
    if kind == CRASHES_GMSH:
        monkeypatch.setattr(foreign_file, "read_arrays", in_another_process)
    change, said = MESHES[kind]
    change()
    message = refused("reduce", "block.toml", "-o", "out.h5")
    assert "block.msh: " in message
    assert said in message


RIGHT_MESHES = {
    "inverted cells": lambda: write_msh(
        cells=np.where(np.arange(len(CELLS))[:, None] % 2, CELLS, CELLS[:, [1, 0, 2, 3]])
    ),
    "points of no cell": lambda: write_msh(np.vstack([POINTS, [[7.0, 7.0, 7.0]]])),
    "every cell twice": lambda: write_msh(cells=np.vstack([CELLS, CELLS])),
    "CRLF": lambda: (write_msh(), MESH.write_bytes(MESH.read_bytes().replace(b"\n", b"\r\n"))),
}


@pytest.mark.parametrize("kind", RIGHT_MESHES)
def test_mesh_that_looks_odd_gives_the_same_number(inside, say, kind):
    RIGHT_MESHES[kind]()
    assert say("reduce", "block.toml", "-o", "same.h5")[0] == 0
    again, rom = fr.read_rom("same.h5"), fr.read_rom("rom.h5")
    np.testing.assert_allclose(
        again.contact_models["tip"].eigenvalues, rom.contact_models["tip"].eigenvalues, rtol=1e-9
    )


# --- tables -----------------------------------------------------------------------------------------------------------

TABLES = {
    "missing": (None, "table force.csv: cannot be read: No such file or directory"),
    "empty": (b"", "use a line that names the columns"),
    "blank lines": (b"\n\n  \n", "use a line that names the columns"),
    "no header": (b"0,1,2,3\n1,1,2,3\n", "line 1, column '0': its first row must name the columns, time first"),
    "header alone": (b"time,x,y,z\n", "at least one line of data"),
    "one row": (b"time,x,y,z\n0,0,0,1\n", "use two or more rows"),
    "time alone": (b"time\n0\n1\n", "a time and one number or more"),
    "ragged, too few": (b"time,x,y,z\n0,0,0,1\n1,0,0\n", "line 3: has 3 cells; use 4, as in line 1"),
    "ragged, too many": (b"time,x,y,z\n0,0,0,1\n1,0,0,1,\n", "line 3: has 5 cells; use 4"),
    "text in a cell": (b"time,x,y,z\n0,0,0,1\n1,0,much,1\n", "line 3, column 'y': 'much' was given; use a"),
    "empty cell": (b"time,x,y,z\n0,0,0,1\n1,0,,1\n", "line 3, column 'y': '' was given; use a finite number"),
    "decimal commas": (b"time;x;y;z\n0;0;0;1\n", "line 1, column 'time;x;y;z': its first row must name the columns"),
    "nan": (b"time,x,y,z\n0,0,0,nan\n1,0,0,1\n", "line 2, column 'z': 'nan' was given; use a finite number"),
    "inf": (b"time,x,y,z\n0,0,0,1\n1,0,0,inf\n", "line 3, column 'z': 'inf' was given; use a finite number"),
    "times that decrease": (b"time,x,y,z\n1,0,0,1\n0,0,0,1\n", "strictly increasing times"),
    "times that stay": (b"time,x,y,z\n0,0,0,1\n0,0,0,1\n", "strictly increasing times"),
    "doubled name": (b"time,x,x,z\n0,0,0,1\n1,0,0,1\n", "line 1: column 'x' is there twice"),
    "wrong order": (b"time,z,y,x\n0,0,0,1\n1,0,0,1\n", "line 1, column 'z': use x, y and z in this order"),
    "time last": (b"x,y,z,time\n0,0,0,0\n0,0,0,1\n", "line 1, column 'x': its first row must name the columns, time"),
    "unit of another quantity": (b"time,x (Pa),y,z\n0,0,0,1\n1,0,0,1\n", "unit 'Pa'; use a name and one of (N)"),
    "unit that is not there": (b"time (h),x,y,z\n0,0,0,1\n1,0,0,1\n", "unit 'h'; use a name and one of (s), (ms)"),
    "name of another quantity": (b"time,pressure.x,y,z\n0,0,0,1\n1,0,0,1\n", "is a pressure; use numbers in N"),
    "UTF-16": ("time,x,y,z\n0,0,0,1\n1,0,0,1\n".encode("utf-16"), "is no text in UTF-8, at byte"),
    "binary": (bytes(range(128, 256)), "is no text in UTF-8, at byte"),
}


@pytest.mark.parametrize("kind", TABLES)
def test_table_is_refused_in_one_line(inside, refused, kind):
    content, said = TABLES[kind]
    if content is not None:
        Path("force.csv").write_bytes(content)
    Path("block.toml").write_text(changed("force = [0, 0, 0.1]", 'table = "force.csv"'))
    for command in ("reduce", "simulate"):
        message = refused(command, "block.toml", "-o", "out.h5")
        assert message.startswith("block.toml: run.load[0].table: table force.csv")
        assert said in message


def test_table_that_looks_odd_gives_the_same_number(inside, say):
    Path("force.csv").write_bytes(
        b'\xef\xbb\xbf"time (ms)" , x (N), y(kN) ,"z (mN)"\r\n\r\n -1e3,0,0,+1E2\r\n1e3, 0,-0,100.\r\n'
    )
    Path("block.toml").write_text(changed("force = [0, 0, 0.1]", 'table = "force.csv"'))
    assert say("simulate", "block.toml", "-o", "same.h5")[0] == 0
    np.testing.assert_array_equal(fr.read_trajectory("same.h5").energy, fr.read_trajectory("full.h5").energy)


# --- ROM and run files ------------------------------------------------------------------------------------------------


def text_of(**texts):
    def change(h5):
        for name, text in texts.items():
            h5.attrs[name] = np.bytes_(text.encode())

    return change


def not_finite(h5):
    h5["times"][-1] = np.nan


def write_foreign(file):
    with h5py.File(file, "w") as h5:
        h5["x"] = 1.0


def flipped(file):
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)


def turned_into(make):
    def change(file):
        file.unlink()
        make(file)

    return change


DAMAGED = "is damaged: its content is not what was written (the checksum differs)"
FILES = {
    "empty": (lambda file: file.write_bytes(b""), "is not a fenics-rom file"),
    "text": (lambda file: file.write_text("fenics-romance"), "is not a fenics-rom file"),
    "binary garbage": (lambda file: file.write_bytes(bytes(range(256)) * 9), "is not a fenics-rom file"),
    "another program's HDF5": (write_foreign, "is not a fenics-rom file"),
    "cut short": (lambda file: file.write_bytes(file.read_bytes()[:3000]), DAMAGED),
    "cut within the seal": (lambda file: file.write_bytes(file.read_bytes()[:100]), DAMAGED),
    "longer": (lambda file: file.write_bytes(file.read_bytes() + b"more"), DAMAGED),
    "one bit": (flipped, DAMAGED),
    "missing": (Path.unlink, "not found"),
    "a folder": (turned_into(Path.mkdir), "is a folder or a device"),
    "a pipe": (turned_into(os.mkfifo), "is a folder or a device"),
    "a link to itself": (turned_into(lambda file: file.symlink_to(file.name)), "not found"),
    "a later format": (lambda file: tampered(file, text_of(format_version="9.0")), "has format version 9.0; this"),
    "another format": (lambda file: tampered(file, text_of(format="abaqus")), "is not a fenics-rom file"),
    "another content": (lambda file: tampered(file, text_of(content="mesh")), "rom.h5"),
    "an array more": (lambda file: tampered(file, lambda h5: h5.create_dataset("more", data=1.0)), "unexpected more"),
    "no basis": (lambda file: tampered(file, lambda h5: h5.pop("basis")), "basis is missing"),
}


@pytest.mark.parametrize("kind", FILES)
def test_rom_file_is_refused_in_one_line(inside, refused, kind):
    change, said = FILES[kind]
    change(Path("rom.h5"))
    for command in (["info", "rom.h5"], ["simulate", "rom.h5", "-o", "out.h5"], ["compare", "run.h5", "rom.h5"]):
        message = refused(*command)
        assert message.startswith("rom.h5: ")
        assert said in message or command[0] == "compare"


def test_run_file_that_is_not_finite_is_refused(inside, refused):
    tampered(inside / "run.h5", not_finite)
    assert "holds numbers that are not finite" in refused("info", "run.h5")


@contextmanager
def as_nobody():
    """As a user who may not do all that root may, where root runs the tests."""
    root = os.geteuid() == 0
    if root:
        os.seteuid(65534)
    try:
        yield
    finally:
        if root:
            os.seteuid(0)


FORBIDDEN = {
    "scene": (["reduce", "block.toml", "-o", "out.h5"], "block.toml"),
    "mesh": (["reduce", "block.toml", "-o", "out.h5"], "block.msh"),
    "ROM": (["info", "rom.h5"], "rom.h5"),
    "ROM to run": (["simulate", "rom.h5", "-o", "out.h5"], "rom.h5"),
    "run": (["compare", "run.h5", "full.h5"], "full.h5"),
    "output": (["simulate", "rom.h5", "-o", "out.h5"], "."),
}


@pytest.mark.parametrize("kind", FORBIDDEN)
def test_file_without_permission_is_told(inside, refused, kind):
    words, file = FORBIDDEN[kind]
    inside.chmod(0o777)
    Path(file).chmod(0o555 if file == "." else 0)
    with as_nobody():
        message = refused(*words)
    assert "ermission" in message
    assert file in message or file == "."


# --- command lines ----------------------------------------------------------------------------------------------------

LONG = f"{300 * 'a'}.h5"
COMMANDS = {
    "2, no command": ([], "the following arguments are required: COMMAND; see fenics-rom --help"),
    "2, unknown command": (["redcue", "block.toml"], "no command 'redcue'; there is certify, check, compare, "),
    "2, unknown command, hint": (["redcue"], "did you mean 'reduce'?"),
    "2, unknown option": (
        ["--verison"],
        "no option '--verison'; there is --help, --version; did you mean '--version'?",
    ),
    "2, unknown option of a command": (["info", "rom.h5", "--quiet"], "no option '--quiet'; there is --force, --help"),
    "2, unknown option, hint": (["simulate", "rom.h5", "--ordre", "3"], "did you mean '--order'?"),
    "2, unknown letter": (["info", "rom.h5", "-x"], "no option '-x'; there is --force, --help"),
    "2, missing output": (["reduce", "block.toml"], "the following arguments are required: -o/--output"),
    "2, missing file": (["info"], "the following arguments are required: FILE; see fenics-rom info --help"),
    "2, missing value": (["simulate", "rom.h5", "-o", "out.h5", "--dt"], "argument --dt: expected one argument"),
    "2, bad number": (
        ["simulate", "rom.h5", "-o", "out.h5", "--dt", "fast"],
        "argument --dt: invalid float value: 'fast'",
    ),
    "2, bad whole number": (["reduce", "block.toml", "-o", "out.h5", "--order", "2.5"], "invalid int value: '2.5'"),
    "2, bad choice": (
        ["reduce", "block.toml", "-o", "out.h5", "--method", "podd"],
        "invalid choice: 'podd' (choose from",
    ),
    "2, one file too many": (["info", "rom.h5", "run.h5"], "unrecognized arguments: run.h5"),
    "2, scene and matrices": (
        ["reduce", "block.toml", "-o", "out.h5", "--mass", "M"],
        "SCENE and --mass cannot be used",
    ),
    "2, neither": (["reduce", "-o", "out.h5"], "SCENE is needed, or --mass, --stiffness"),
    "2, order and tolerance": (
        ["reduce", "block.toml", "-o", "out.h5", "--order", "2", "--tolerance", "0.1"],
        "not allowed with argument",
    ),
    "2, option of a ROM for a scene": (["simulate", "block.toml", "-o", "out.h5", "--rate"], "--rate: for a ROM"),
    "2, port": (["view", "rom.h5", "--port", "99999"], "argument --port: '99999': use a whole number from 0"),
    "2, three runs to view": (["view", "run.h5", "run.h5", "run.h5"], "use a ROM, a world, a run, or two runs"),
    "1, a ROM for a scene": (["reduce", "rom.h5", "-o", "out.h5"], "rom.h5: is a ROM or a run, which info takes; use"),
    "1, a mesh for a scene": (["reduce", "block.msh", "-o", "out.h5"], "block.msh: is a mesh; use a scene file"),
    "1, a scene for a ROM": (
        ["info", "block.toml"],
        "block.toml: is not a fenics-rom file, a ROM or a run; of a scene --surf",
    ),
    "1, a run for a ROM": (["simulate", "run.h5", "-o", "out.h5"], "run.h5: is a run; use a ROM"),
    "1, a ROM for a run": (["compare", "rom.h5", "run.h5"], "rom.h5: is a ROM; use a run"),
    "1, another ending": (["simulate", "rom.toml", "-o", "out.h5"], "did you mean 'rom.h5'?"),
    "1, a letter too few": (["simulate", "blok.toml", "-o", "out.h5"], "did you mean 'block.toml'?"),
    "1, a long name": (["simulate", LONG, "-o", "out.h5"], LONG),
    "1, a long output": (["simulate", "rom.h5", "-o", LONG], "File name too long"),
    "1, output in a missing folder": (["reduce", "block.toml", "-o", "none/out.h5"], "folder none does not exist"),
    "1, output is a folder": (["simulate", "rom.h5", "-o", "."], "cannot be written: it is a folder or a device"),
    "1, output is a device": (
        ["simulate", "rom.h5", "-o", "/dev/null"],
        "/dev/null: cannot be written: it is a folder",
    ),
    "1, output below a file": (["simulate", "rom.h5", "-o", "rom.h5/out.h5"], "folder rom.h5 does not exist"),
    "1, input is output": (
        ["simulate", "rom.h5", "-o", "./rom.h5"],
        "is read by this command, so it cannot be its output",
    ),
    "1, scene is output": (
        ["reduce", "block.toml", "-o", "block.toml"],
        "is read by this command, so it cannot be its",
    ),
    "1, no order": (["reduce", "block.toml", "-o", "out.h5", "--order", "0"], "--order 0: use whole numbers from 1"),
    "1, a tolerance just too large": (
        ["reduce", "block.toml", "-o", "out.h5", "--tolerance", "1.0000001"],
        "--tolerance 1.0000001: use more than 0 and less than 1",
    ),
    "1, order above the ROM's": (["simulate", "rom.h5", "-o", "out.h5", "--order", "99"], "order 99: use 1 to "),
    "1, a run of 1e12 steps": (["simulate", "rom.h5", "-o", "out.h5", "--dt", "1e-13"], "use at most 10,000,000"),
    "1, step of zero": (["simulate", "rom.h5", "-o", "out.h5", "--dt", "0"], "dt = 0.0: use more than 0 and at"),
    "1, negative step": (["simulate", "rom.h5", "-o", "out.h5", "--dt", "-1"], "dt = -1.0: use more than 0 and at"),
    "1, step that is nan": (["simulate", "block.toml", "-o", "out.h5", "--dt", "nan"], "dt = nan: use more than 0"),
    "1, stepper of another model": (["simulate", "rom.h5", "-o", "out.h5", "--stepper", "newton"], "stepper"),
    "1, a picture of no kind": (["plot", "run.h5", "-o", "out.doc"], "out.doc"),
    "1, an export of no kind": (["export", "run.h5", "-o", "out.doc"], "out.doc"),
    "1, an instant after the run": (["export", "run.h5", "-o", "out.vtu", "--time", "9"], "--time 9: use 0 to 0.1"),
    "1, a plot that there is not": (["plot", "run.h5", "-o", "out.pdf", "--what", "energie"], "energie"),
    "1, study with a file for a folder": (["study", "block.toml", "-o", "rom.h5"], "rom.h5: is a file; use a folder"),
    "1, identify without data": (["identify", "block.toml", "--data", "none.csv", "-o", "out"], "none.csv"),
    "1, a matrix that is missing": (
        [
            "reduce",
            "-o",
            "out.h5",
            *("--mass", "M.mtx", "--stiffness", "K.mtx", "--rayleigh", "0", "0"),
            "--contact",
            "a=B.mtx",
        ],
        ".mtx",
    ),
}


@pytest.mark.parametrize("kind", COMMANDS)
def test_command_line_is_refused_in_one_line(inside, refused, kind):
    words, said = COMMANDS[kind]
    assert said in refused(*words, status=int(kind[0]))


@pytest.mark.parametrize(
    ("words", "status"), [(["redcue"], 2), (["info", "block.toml"], 1), (["reduce", "rom.h5", "-o", "out.h5"], 1)]
)
def test_process_says_one_line_and_shows_no_traceback(inside, words, status):
    run = subprocess.run(
        [sys.executable, "-m", "fenics_rom", *words], capture_output=True, text=True, env=dict(os.environ), timeout=60
    )
    assert (run.returncode, run.stdout) == (status, "")
    assert ERROR.fullmatch(run.stderr)


# --- Python -----------------------------------------------------------------------------------------------------------


def simulator(dt=0.01):
    return fr.Simulator(fr.read_rom("rom.h5"), dt=dt)


def rom():
    return fr.read_rom("rom.h5")


CALLS = {
    "a scene that is not there": (lambda: fr.read_scene("none.toml"), "none.toml: cannot be read: No such file"),
    "a scene with a NUL in its name": (lambda: fr.read_scene("no\0ne"), "cannot be read"),
    "a ROM that is a folder": (lambda: fr.read_rom("."), "is a folder or a device"),
    "a ROM with a NUL in its name": (lambda: fr.read_rom("no\0ne"), "cannot be read: use a name without NUL"),
    "a path where a model belongs": (lambda: fr.simulate("rom.toml"), "rom"),
    "a step of zero": (lambda: simulator(0.0), "dt"),
    "a step that is nan": (lambda: simulator(float("nan")), "dt"),
    "an input too few": (lambda: simulator().step([0.0, 0.0]), "use 3 numbers in N (got [0.0, 0.0])"),
    "an input that is nan": (lambda: simulator().step([0.0, 0.0, np.nan]), "nan"),
    "an input that is infinite": (lambda: simulator().step([0.0, 0.0, -np.inf]), "inf"),
    "an input in words": (lambda: simulator().step("push"), "push"),
    "a contact that there is not": (lambda: simulator().switch("tap"), "no contact mode 'tap'; there is tip"),
    "an output that there is not": (lambda: simulator().displacement("tap"), "no output 'tap'; there is tip"),
    "an order of zero": (lambda: fr.truncate(rom(), 0), "order 0: use 1 to "),
    "half an order": (lambda: fr.truncate(rom(), 2.5), "order 2.5: use 1 to "),
    "an order of each contact mode": (lambda: fr.truncate(rom(), {"tip": 2}), "order {'tip': 2}: use 1 to "),
    "a signal of nothing": (lambda: fr.simulate(rom(), signals={"wind": 1.0}), "wind"),
    "a signal that is nan": (lambda: fr.simulate(rom(), signals={"gravity": np.nan}), "gravity"),
    "a place that is not there": (lambda: fr.write_rom("none/out.h5", rom()), "folder none does not exist"),
}


@pytest.mark.parametrize("kind", CALLS)
def test_call_is_refused_in_one_line(inside, kind):
    call, said = CALLS[kind]
    with pytest.raises(FenicsRomError) as caught:
        call()
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
