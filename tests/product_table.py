"""`python tests/product_table.py` writes the table of products into fenics_rom/README.md, by running a body for each.

A product is an elastic law in a frame with parts that act or touch; it is stepped at full order and reduced, rolled
out, batched, put into a world, and differentiated.
"""

import re
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
from bodies import box_arrays, scene_text, write_arrays

import fenics_rom as fr
from fenics_rom.errors import FenicsRomError
from fenics_rom.scene.file import parse_scene
from fenics_rom.world.shapes import Box

PAGE = Path(__file__).parent.parent / "fenics_rom" / "README.md"
HEADING = "## What goes with what\n"
ROPE = "points = [[0.0, 0.015, 0.004], [0.15, 0.015, 0.002], [0.3, 0.015, 0.004]]"
FLOOR = 'shape = "half-space"\npoint = [0, 0, -4e-4]\nnormal = [0, 0, 1]'
BALL = 'shape = "sphere"\ncenter = [0.25, 0.015, 0.0704]\nradius = 0.05'
FRAMES = ("held", "carried", "free")
SHORT, LONG = 1e-3, 0.04  # s: with large deformation, of linearly implicit steps and of Newton's

# Elastic laws: effects, and time step.
LAWS = {
    "small strains": ({"inertia": ""}, SHORT),
    "small strains, relaxing": ({"inertia": "", "viscoelasticity": "ratios = [0.5]\ntimes = [0.02]"}, SHORT),
    "small strains, no inertia": ({}, SHORT),
    "large, linearly implicit": ({"inertia": "", "large_deformation": ""}, SHORT),
    "large, Newton": ({"inertia": "", "large_deformation": 'material = "neo_hookean"'}, LONG),
    "large, relaxing": (
        {"inertia": "", "large_deformation": "", "viscoelasticity": "ratios = [0.5]\ntimes = [0.02]"},
        SHORT,
    ),
    "large, no inertia": ({"large_deformation": ""}, SHORT),
}
PARTS = {
    "loads": {
        "prescribed.push": "point = [0.3, 0.03, 0.02]\nforce = [1e-3, 0.0, 2e-3]",
        "pressure.air": 'surface = "top"',
    },
    "tendons": {"tendon.rope": ROPE},
    "strokes": {"tendon.rope": f'{ROPE}\ncontrol = "length"'},
    "guides": {"tendon.rope": ROPE, "tendon_friction": "coefficient = 0.3"},
    "volumes": {"pressure.air": 'near = { point = [0, 0, 0], radius = 1.0 }\ncontrol = "volume"'},
    "gas": {"pressure.air": 'near = { point = [0, 0, 0], radius = 1.0 }\ncontrol = "gas"\ngas = { volume = 1e-4 }'},
    "valves": {
        "pressure.air": 'near = { point = [0, 0, 0], radius = 1.0 }\ncontrol = "valve"\ngas = { volume = 1e-4 }\n'
        "valve = { area = 1e-7 }"
    },
    "driven": {"driven_support.jaw": 'surface = "right"\ndirection = [1.0, 0.0, 0.0]'},
    "heat": {"temperature.warm": 'field = "20 + 100 * z"\namplitude = 1.0'},
    "reactions": {"readings.held": 'quantity = "reaction"'},  # read after each use
    "springs": {"springs.bed": 'surface = "right"\nstiffness = 1.0'},
    "dashpots": {"damping.dashpots.oil": 'surface = "right"\ncoefficient = 0.05'},
    "fibres": {
        "material.fibres": "directions = [[1, 1, 0]]\nmodulus = 1e5",
        "membranes.skin": 'surface = "top"\ndirections = [[1, 0, 0]]\nstiffness = 20.0',
        "cables.wire": f"{ROPE}\nstiffness = 5.0",
    },
    "masses": {
        "point_masses.ball": "point = [0.3, 0.0, 0.0]\nmass = 0.01",
        "rigid_parts.plate": 'surface = "right"\nmass = 0.01\ncenter = [0.31, 0.015, 0.01]',
    },
    "contact": {
        "contact": "",
        "friction": "coefficient = 0.4",
        "contact.obstacles.floor": FLOOR,
        "contact.obstacles.ball": BALL,
    },
    "impacts": {"contact": "restitution = 0.5", "contact.obstacles.floor": FLOOR},
    "penalty": {"contact": 'method = "penalty"\nstiffness = 1e2', "contact.obstacles.floor": FLOOR},
}
LARGEST = {"tendons": 0.1, "strokes": 1e-4, "driven": 1e-4, "guides": 0.1, "loads": 1.0}
LARGEST |= {"volumes": 1e-8, "gas": 1e-6, "valves": 1e3}  # m³, m³ and Pa
USES = ("full order", "step", "rollout", "batch", "world", "gradient")
PHYSICS = {  # why a product has no meaning, by what its refusal says
    "no equilibrium": "nothing holds it, so that without inertia it has no equilibrium",
    "restitution: goes with inertia": "what has no inertia has no impacts",
    "effects.damping: means nothing without inertia": "equilibria have no speeds that a dashpot could resist",
    "viscoelasticity: means nothing without inertia": "equilibria are of the relaxed material",
    "moves nodes relative to what is clamped": "nothing is clamped that a support could move against",
    "a base bears the body; use its base_wrench": "its base bears it: `base_wrench` is what it reads",
    "nothing is held; use it with supports": "nothing holds it that could have a reaction",
}


def scene_of(mesh: Path, law: str, frame: str, part: str) -> str:
    """The scene of a product."""
    effects, dt = LAWS[law]
    acting = {**effects, "gravity": "acceleration = [0.0, 0.0, -9.81]", **PARTS[part]}
    beside = {name: acting.pop(name) for name in list(acting) if name.startswith(("readings.", "material."))}
    if "inertia" in effects:
        acting = {"damping": "alpha = 0.5\nbeta = 2e-4", **acting}
    run = f"dt = {dt}\nduration = {2 * dt}"
    if part in LARGEST:
        actuator = {"loads": "air", "volumes": "air", "gas": "air", "valves": "air", "driven": "jaw"}.get(part, "rope")
        run += f'\n[[run.load]]\nactuator = "{actuator}"\nforce = [{LARGEST[part]}]'
    elif "contact" not in acting:
        run += '\n[[run.load]]\ncontact = "right"\nforce = [0.0, 0.0, 1e-3]'
    text = scene_text(
        mesh,
        material="young = 5e5\npoisson = 0.4\ndensity = 1100.0" + "\nexpansion = 1e-5" * (part == "heat"),
        supports=None if frame == "free" else 'clamped = ["left"]',
        contacts='[contacts.right]\nsurface = "right"\n[contacts.bottom]\nsurface = "bottom"\n',
        effects="",
        run=run,
        **{"outputs.tip": "points = [[0.3, 0.03, 0.02]]"},
        **{f"effects.{name}": text for name, text in acting.items()},
        **beside,
    )
    return 'frame = "moving"\n' * (frame != "held") + text


def uses_of(text: str, frame: str, dt: float) -> dict[str, str]:
    """What each use of a product was refused with; "" where it runs."""
    refused: dict[str, str] = {}

    def attempt(use: str, run: Callable[[], object]) -> object:
        try:
            done = run()
        except FenicsRomError as error:
            refused[use] = str(error)
            return None
        refused[use] = ""
        return done

    system = attempt("read", lambda: fr.assemble(parse_scene(text)))
    if system is None:
        return dict.fromkeys(USES, refused["read"])
    method = "modal" if system.deformation is None else "modal+derivatives"
    attempt("full order", lambda: fr.simulate(system))
    rom = attempt("reduce", lambda: fr.reduce(system, order=6, method=method))
    if rom is None:
        return {use: refused.get(use, refused["reduce"]) for use in USES}
    new = partial(fr.Simulator, rom, dt)
    attempt("step", lambda: _stepped(new()))
    if refused["step"]:
        return {use: refused.get(use, refused["step"]) for use in USES}
    u = np.zeros((4, new().inputs))
    attempt("rollout", lambda: _rolled(new(), u))
    attempt("batch", lambda: _together(fr.Batch(rom, 2, dt), u[:2]))
    attempt("world", lambda: _in_world(rom, frame, dt))
    attempt("gradient", lambda: fr.differentiate(new(), u, _height))
    return {use: refused[use] for use in USES}


def _stepped(body: fr.Simulator) -> None:
    for _ in range(3):
        body.step(np.zeros(body.inputs))
    _read(body)


def _rolled(body: fr.Simulator, u: np.ndarray) -> None:
    body.rollout(u)
    _read(body)


def _together(batch: fr.Batch, u: np.ndarray) -> None:
    batch.step(u)
    _read(batch)


def _read(body: fr.Simulator | fr.Batch) -> None:
    for name in body.rom.readings:
        body.reading(name)


def _height(outputs, energies):
    """Of the tip at the end, and what it changes by."""
    slope = np.zeros_like(outputs["tip"])
    slope[-1] = 1.0
    return float(outputs["tip"][-1].sum()), {"tip": slope}, None


def _in_world(rom: fr.Rom, frame: str, dt: float) -> None:
    """Beside a rigid body that falls, and on one that stands if it is carried."""
    cube, still = Box((0.02, 0.02, 0.02)), fr.BaseState((-0.01, 0.015, 0.01), (1, 0, 0, 0), (0, 0, 0), (0, 0, 0))
    bodies = {"box": fr.RigidBody(cube, mass=0.01, position=(0.6, 0.0, 0.0)), "soft": fr.SoftBody(rom)}
    if frame == "carried":
        bodies |= {"soft": fr.SoftBody(rom, on="hand", position=(0.01, 0, 0)), "hand": fr.RigidBody(cube, motion=still)}
    world = fr.World(bodies, dt, apart=[("soft", "hand")] if frame == "carried" else ())
    for _ in range(2):
        world.step()
    _read(world.simulator("soft"))


def products() -> Iterator[tuple[str, str]]:
    """Rows of the table: law and frame."""
    return ((law, frame) for law in LAWS for frame in FRAMES)


def row(law: str, frame: str) -> dict[str, dict[str, str]]:
    """Of each part of a row, of each use, what it was refused with; "" where it runs."""
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        mesh = write_arrays(Path(folder) / "box.msh", *box_arrays((0.3, 0.03, 0.02), (3, 1, 1)))
        return {part: uses_of(scene_of(mesh, law, frame, part), frame, LAWS[law][1]) for part in PARTS}


def reason(message: str) -> str:
    """Why a product is refused, in the words of the page."""
    if not message:
        return ""
    physics = [told for said, told in PHYSICS.items() if said in message]
    if physics:
        return physics[0]
    return "not yet: " + re.sub(r"^scene: ", "", message).replace("|", "/")


def line(law: str, frame: str, found: dict[str, dict[str, str]], notes: list[str]) -> str:
    """A row of the table; reasons are added to notes, by whose numbers it names them."""

    def cell(messages: list[str]) -> str:
        numbers = []
        for told in dict.fromkeys(map(reason, messages)):
            if told and told not in notes:
                notes.append(told)
            numbers.append(notes.index(told) + 1 if told else 0)
        if not any(numbers):
            return "runs"
        shown = ", ".join(str(number) for number in sorted(numbers) if number)
        return f"but {shown}" if 0 in numbers else shown

    by_part = [cell(list(of_part.values())) for of_part in found.values()]
    by_use = [cell([of_part[use] for of_part in found.values()]) for use in USES]
    return f"| {' | '.join((law, frame, *by_part, *by_use))} |"


def table(rows: dict[tuple[str, str], dict[str, dict[str, str]]]) -> str:
    """The section of the page."""
    notes: list[str] = []
    lines = [line(law, frame, found, notes) for (law, frame), found in rows.items()]
    head = ("elastic law", "frame", *PARTS, *USES)
    numbered = [f"{number}. {told}" for number, told in enumerate(notes, start=1)]
    introduction = (PAGE.read_text().partition(HEADING)[2].partition("\n|")[0]).strip("\n")
    return "\n".join(
        [
            *(HEADING, introduction, "", f"| {' | '.join(head)} |", f"|{'---|' * len(head)}", *lines, ""),
            *(*numbered, ""),
        ]
    )


def written(page: str, section: str) -> str:
    """The page with the section in place of the one it has."""
    before, _, after = page.partition(HEADING)
    rest = after.partition("\n## ")[2]
    return f"{before}{section}\n## {rest}"


if __name__ == "__main__":
    found = {}
    for law, frame in products():
        found[law, frame] = row(law, frame)
        print(law, frame, file=sys.stderr, flush=True)
    PAGE.write_text(written(PAGE.read_text(), table(found)))
