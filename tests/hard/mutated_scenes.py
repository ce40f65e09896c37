"""Scenes that nobody should write, reproducible by seed; those that read are assembled on a small mesh."""

import copy
import sys
import tomllib
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from mutated_files import refused

import fenics_rom as fr
from fenics_rom.errors import FenicsRomError, MeshError, SceneError
from fenics_rom.mechanics.load_history import LoadHistory
from fenics_rom.scene import foreign_file

sys.path.append(str(Path(__file__).parents[1]))
import stand_ins
from bodies import box_arrays, write_arrays
from gmsh_here import arrays_found_here

RICH = """
name = "rich"
[mesh]
file = "box.msh"
degree = 2
groups = { other = 77 }
[materials.body]
young = 1e6
poisson = 0.3
density = 1000.0
cells = "body"
[supports]
clamped = ["left"]
[contacts.bottom]
surface = "bottom"
[contacts.right]
near = { point = [1.0, 0.2, 0.15], radius = 0.3 }
force = "normal"
[actuators.pull]
surface = "back"
force = "normal"
[outputs.tip]
points = [[1.0, 0.4, 0.3], [0.5, 0.2, 0.15]]
[outputs.face]
surface = "right"
[effects]
inertia = {}
[effects.damping]
alpha = 1.0
beta = 1e-3
materials.body = { alpha = 2.0, beta = 2e-3 }
[effects.damping.dashpots.oil]
surface = "right"
coefficient = 3.0
[effects.gravity]
acceleration = [0, 0, -9.81]
[effects.springs.bed]
surface = "front"
stiffness = 50.0
[effects.base_motion.quake]
direction = [0, 1, 0]
acceleration = 0.5
[effects.prescribed.push]
surface = "right"
force = [0.0, 2.0, 0.0]
[effects.prescribed.poke]
point = [0.7, 0.1, 0.3]
table = "push.csv"
[effects.pressure.air]
surface = "top"
[effects.tendon.rope]
points = [[0.0, 0.0, 0.3], [0.5, 0.2, 0.3], [1.0, 0.4, 0.3]]
[effects.contact]
switching = "scene"
restitution = 0.5
[effects.contact.obstacles.floor]
shape = "half-space"
point = [0, 0, -1e-3]
normal = [0, 0, 1]
[effects.contact.obstacles.ball]
shape = "sphere"
center = [1.2, 0.4, 0.3]
radius = 0.099
table = "push.csv"
[effects.friction]
coefficient = 0.1
[reduction]
order = { bottom = 4, right = 5 }
weighting = "nodal"
[run]
dt = 0.005
duration = 0.5
snapshots = 10
[[run.load]]
contact = "right"
stop = 0.2
force = [1.0]
[[run.load]]
actuator = "air"
start = 0.1
force = [50.0]
"""
PLAIN = """
[mesh]
file = "box.msh"
[material]
young = 1e6
poisson = 0.3
density = 1000.0
[supports]
clamped = ["left"]
[contacts.right]
surface = "right"
[effects]
inertia = {}
damping = { alpha = 1.0, beta = 1e-3 }
[run]
dt = 0.01
duration = 0.1
load = [{ contact = "right", force = [0, 0, 1] }]
"""
TABLE = "time,x,y,z\n0,0,0,0\n0.3,-0.02,0.0,0.0\n0.5,0.01,0.0,0.0\n"
VALUES: tuple[Any, ...] = (
    *(0, -1, 1, 2, 3, 10**9, 10**40, -(10**400), 0.0, -0.0, 1e-320, 1e-200, 1e-30, 1e30, 1e150, 1e300, 1.7e308, -1e300),
    *(
        float("nan"),
        float("inf"),
        -float("inf"),
        True,
        False,
        "",
        "x",
        "left",
        "right",
        "body",
        "é☃",
        "\u202e\x00\x1b[31m",
    ),
    *(10_000 * "x", "..", "/", "/dev/zero", "/dev/stdin", "push.csv", "box.msh", "pipe", "nan", [], [[]], {}, [{}]),
    *([0, 0, 0], [1.0, 2.0, 3.0], [float("nan")] * 3, [1e300] * 3, [1e-300] * 3, ["left"] * 3, [[0, 0, 0]] * 2),
    *({"left": 1}, {"point": [0, 0, 0], "radius": 1}, {"alpha": 1e300}, list(range(1000)), 0.5, 0.4999999999999999),
)
NUMBERS = tuple(value for value in VALUES if isinstance(value, int | float) and not isinstance(value, bool))
TEXTS = tuple(value for value in VALUES if isinstance(value, str))
EXAMPLES = {"rich": RICH, "plain": PLAIN}


def prepare(folder: Path) -> None:
    """The mesh, a table, and things that are neither."""
    import os

    stand_ins.replace(foreign_file, "read_arrays", arrays_found_here)
    write_arrays(folder / "box.msh", *box_arrays((1.0, 0.4, 0.3), (2, 1, 1)))
    (folder / "push.csv").write_text(TABLE)
    os.mkfifo(folder / "pipe")


def mutated(random: np.random.Generator) -> tuple[str, bytes]:
    """What was done, and the text."""
    name = random.choice(["rich", "rich", "rich", "plain"])
    text = EXAMPLES[name]
    if random.random() < 0.2:
        return f"{name}, as text", as_text(text, random)
    tree = copy.deepcopy(tomllib.loads(text))
    change = as_tree if random.random() < 0.4 else of_its_kind
    with deep():
        done = [change(tree, random) for _ in range(random.integers(1, 4))]
        return f"{name}, {'; '.join(done)}", toml(tree).encode("utf-8", "surrogatepass")


@contextmanager
def deep() -> Iterator[None]:
    """Lets a tree be nested deeper than what reads it stands: it is made by recursion, too."""
    limit = sys.getrecursionlimit()
    sys.setrecursionlimit(20_000)
    try:
        yield
    finally:
        sys.setrecursionlimit(limit)


def outcome(content: bytes, folder: Path) -> str:
    """Reads a scene and assembles what it says."""
    file = folder / "scene.toml"
    file.write_bytes(content)
    try:
        scene = fr.read_scene(file)
    except SceneError as error:
        return refused(error, SceneError)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            system = fr.assemble(scene)
        except MeshError:
            return "read, and refused for its mesh"
        except SceneError:
            return "read, and refused by assembly"
        assert all(np.isfinite(columns).all() for columns in system.contacts.values())
        if scene.run is None:
            return "assembled"
        columns = {name: B.shape[1] for name, B in system.contacts.items()}
        try:
            history = LoadHistory(
                scene.environment, columns, {name: B.shape[1] for name, B in system.actuators.items()}
            )
        except SceneError:
            return "assembled, and its run refused"
        for _, (_, u) in zip(range(5), history, strict=False):
            assert np.isfinite(u).all()
        return f"assembled, with a run, and {reduced(system, history.dt)}"


def reduced(system: fr.System, dt: float) -> str:
    """Reduces a system and runs the model; of numbers beyond all measure a method may despair, but must say so."""
    try:
        body = fr.Simulator(fr.reduce(system, order=6), dt=dt)
        for _ in range(5):
            body.step(np.ones(body.inputs))
    except FenicsRomError as error:
        return f"refused by reduction or a step ({type(error).__name__})"
    return "reduced, and stepped"


def as_text(text: str, random: np.random.Generator) -> bytes:
    """Bytes and lines flipped, cut, repeated or moved."""
    data = bytearray(text.encode())
    for _ in range(random.integers(1, 4)):
        way, at = random.integers(5), int(random.integers(len(data)))
        length = int(2 ** random.uniform(0, 8))
        if way == 0:
            data[at] = random.integers(256)
        elif way == 1:
            del data[at : at + length]
        elif way == 2:
            to = int(random.integers(len(data)))
            data[to:to] = data[at : at + length]
        else:
            lines = bytes(data).split(b"\n")
            one, other = random.integers(len(lines), size=2)
            lines.insert(int(other), lines[one] if way == 3 else lines.pop(one))
            data = bytearray(b"\n".join(lines))
        data = data or bytearray(b"\n")
    return bytes(data)


def as_tree(tree: dict[str, Any], random: np.random.Generator) -> str:
    """A key dropped, renamed, added, moved, or with another value, number or kind."""
    places = list(walk(tree, ()))
    parent, key, path = places[random.integers(len(places))]
    where, way = ".".join(map(str, path)), random.integers(7)
    other = places[random.integers(len(places))]
    if way == 0:
        del parent[key]
        return f"{where} gone"
    if way == 1 and isinstance(parent, dict):
        new = str(other[1]) if random.random() < 0.5 else str(VALUES[random.integers(len(VALUES))])[:200]
        parent[new] = parent.pop(key)
        return f"{where} named {new[:20]!r}"
    if way == 2 and isinstance(parent[key], dict | list):
        extra = copy.deepcopy(other[0][other[1]])
        if isinstance(parent[key], dict):
            parent[key][str(other[1])] = extra
        else:
            parent[key].append(extra)
        return f"{where} with more"
    if way == 3:
        parent[key] = copy.deepcopy(other[0][other[1]])
        return f"{where} as {'.'.join(map(str, other[2]))}"
    if way == 4 and isinstance(parent[key], float):
        parent[key] = float(f"1e{random.integers(-330, 330)}") * random.choice([-1, 1])
        return f"{where} = {parent[key]:g}"
    if way == 5:
        value = parent[key]
        for _ in range(int(random.choice([1, 3, 150]))):
            value = [value] if random.random() < 0.5 else {"deeper": value}
        parent[key] = value
        return f"{where} nested"
    parent[key] = copy.deepcopy(VALUES[random.integers(len(VALUES))])
    return f"{where} = {str(parent[key])[:30]!r}"


def of_its_kind(tree: dict[str, Any], random: np.random.Generator) -> str:
    """A number, a text or a list of such replaced by another: what a scene may hold, mostly."""
    places = [place for place in walk(tree, ()) if not isinstance(place[0][place[1]], dict)]
    parent, key, path = places[random.integers(len(places))]
    old = parent[key]
    if isinstance(old, str):
        others = [place[0][place[1]] for place in places if isinstance(place[0][place[1]], str)]
        parent[key] = str(random.choice(others)) if random.random() < 0.8 else TEXTS[random.integers(len(TEXTS))]
    elif isinstance(old, list):
        way = random.integers(3)
        parent[key] = old[:-1] if way == 0 else old + old[-1:] if way == 1 else [random.choice([0, 1, -1]), *old[1:]]
    elif random.random() < 0.5:
        parent[key] = NUMBERS[random.integers(len(NUMBERS))]
    else:
        old = 1.0 if abs(old) > 1e300 else old
        parent[key] = (
            float(old or 1.0) * 10.0 ** np.clip(2 * random.standard_t(1), -290, 290) * random.choice([-1, 1, 1])
        )
        if isinstance(old, int) and random.random() < 0.7 and abs(parent[key]) < 1e18:
            parent[key] = round(parent[key])
    return f"{'.'.join(map(str, path))} = {str(parent[key])[:30]!r}"


def walk(tree: Any, path: tuple[Any, ...]) -> Any:
    """Every value: what holds it, its key there, and its path."""
    for key, value in list(tree.items() if isinstance(tree, dict) else enumerate(tree)):
        yield tree, key, (*path, key)
        if isinstance(value, dict | list):
            yield from walk(value, (*path, key))


def toml(value: Any, top: bool = True) -> str:
    """A value as TOML, tables in one line but the outermost."""
    if isinstance(value, dict):
        pairs = [f"{quoted(key)} = {toml(item, False)}" for key, item in value.items()]
        return "\n".join(pairs) + "\n" if top else "{" + ", ".join(pairs) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml(item, False) for item in value) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    return quoted(value) if isinstance(value, str) else repr(value)


def quoted(text: str) -> str:
    """A basic string."""
    return '"' + "".join(c if c.isprintable() and c not in '"\\' else f"\\u{ord(c):04x}" for c in text) + '"'
