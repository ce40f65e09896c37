"""What a step with contact and friction costs, by what is in contact.

    python demos/contact_rates/contact_rates.py             # two minutes
    python demos/contact_rates/contact_rates.py --quick     # short loops, to see that it works

A pad of foam, which nothing holds, is pressed on the ground, or on a big ball, with 20 points that can touch, and
pushed aside: too weakly to move it, so that part of it slides, or so that all of it does. Its reduced model has order
30. Every case first runs until it has settled. Then all cases take turns in one process, and the median of their rates
counts; so do pads with 20 and with 40 points, beside their full order, also under pushes that are random in every step.
The script

1. tables steps per second beside how many points touch, how many of them slide and how many systems of equations a
   step takes, one by one and in a rollout, also with the penalty method, without friction, without residual
   compliance, out of reach, and without contact in the scene;
2. tables them at rest, sticking, sliding and under random pushes, with 20 and with 40 points, beside full order;
3. tables how far forces are off while it settles, with and without residual compliance, beside what the step itself
   and a mesh whose nodes are a little elsewhere make at full order (not with --quick);
4. splits a step into its effects;
5. tables what a `Batch` makes of many pads with 8, 20 and 40 points that rest or are each pushed about at random,
   beside a single one, and by how much these two differ;
6. tables the rate of a world that has such a pad alone, beside that of its simulator;
7. checks that the scene without contact steps as if there was no such thing: in the same form, to the same bits.

Everything is written to demos/contact_rates/out/, with --quick to out/quick/. The checks at the end are on what
touches, on forces and on energy; --quick leaves out that on rates.
"""

import argparse
import os
import statistics
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import gmsh
import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "poke"))

from touching import DEGREE, FINER, run_moved, slid

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.io.markdown import markdown
from fenics_rom.runtime.steppers.midpoint import FusedMidpoint
from fenics_rom.scene.file import parse_scene

OUT = Path(__file__).parent / "out"
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

SIZE, BRICKS, MORE_BRICKS = (0.20, 0.15, 0.10), (4, 3, 2), (7, 4, 2)  # m; 5 x 4 and 8 x 5 nodes at the bottom
POINTS = {8: (3, 1, 2), 20: BRICKS, 40: MORE_BRICKS}  # that touch, of pads in a batch
ORDER = 24  # and six rigid motions
DENSITY, GRAVITY = 200.0, 9.81
WEIGHT = DENSITY * SIZE[0] * SIZE[1] * SIZE[2] * GRAVITY
NEAR = 1e-4  # m; a point stops up to one step before the ground, and need not be pressed on
PRESSED = 4 * WEIGHT  # N, with the weight itself
COEFFICIENT = 0.5
STEP = 1e-3  # s
TOGETHER = 1024  # pads that are stepped together
FEW_TOGETHER = 16  # with --quick
ORDER_TOGETHER = 14  # and six rigid motions
PUSHED = {  # anew after so many steps, with at most that share of what moves it
    "at rest": (0, 0.0),
    "pushed anew every ten steps": (10, 0.25),
    "in every step, four times as hard": (1, 1.0),
}
WAY = 0.075 * DEGREE  # m, as far as turning the pad moves its sides
WANTED = 5000.0  # steps a second with all points touching and friction

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

Array = np.ndarray


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
RANDOM = "random pushes"
SCALED = {"at rest": CASES["at rest"], "sticks": CASES["sticks"], "slides": CASES["slides"], RANDOM: CASES["sticks"]}
ON_THE_GROUND = ("at rest", "sticks", "in part slides", "slides")
COMPARED = ("sticks", "in part slides", "slides", "on a ball, sticks")  # with full order


def main() -> None:
    """Runs the demo."""
    parser = argparse.ArgumentParser(description="Measures what a step with contact costs.")
    parser.add_argument("--quick", action="store_true", help="short loops; rates are not judged")
    quick = parser.parse_args().quick
    if not ONE_THREAD.items() <= os.environ.items():  # read when NumPy is loaded, so it takes another start
        os.execve(sys.executable, [sys.executable, *sys.argv], os.environ | ONE_THREAD)
    out = OUT / "quick" if quick else OUT  # so that a test does not overwrite the whole
    out.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore", FenicsRomWarning)  # the pad slides away from where it was
    file = out / "pad.msh"
    mesh(file, BRICKS)
    settle, steps, rounds = (100, 20, 1) if quick else (700, 100, 5)

    scenes = {name: scene(case, file, settle * STEP) for name, case in CASES.items()}
    whole, bare = (fr.reduce(fr.assemble(scenes[name]), order=ORDER) for name in ("sticks", "neither"))
    print(f"Pad: order {next(iter(whole.contact_models.values())).order}, dt {STEP:g} s, one thread\n")
    bodies = {name: settled(bare if name == "neither" else whole, scenes[name], settle) for name in CASES}
    rates, rolled_out = in_turns(bodies, steps, rounds)
    seen = {name: look(body) for name, body in bodies.items() if CASES[name].obstacle is not None}
    table_of_rates(rates, rolled_out, seen, out)
    table_beside_full_order(out, settle, steps, rounds)
    table_of_effects(whole, {name: scenes[name] for name in ("sticks", "in part slides", "slides", "no friction")}, out)
    off = table_of_batches(FEW_TOGETHER if quick else TOGETHER, steps // 2, out)
    table_of_worlds({"sticks": whole, "neither": bare}, steps, rounds, out)
    errors = {} if quick else table_of_errors(whole, {name: scenes[name] for name in COMPARED}, out)
    check(rates, seen, bodies, whole, bare, scenes, errors, off)


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


def in_turns(bodies: dict[str, fr.Simulator], steps: int, rounds: int) -> tuple[dict[str, float], dict[str, float]]:
    """Steps per second of each, one by one and in rollouts of ten times as many, median of rounds of all in turns.

    Each round begins from the settled state.
    """
    starts = {name: body.save() for name, body in bodies.items()}
    one_by_one: dict[str, list[float]] = {name: [] for name in bodies}
    rolled_out: dict[str, list[float]] = {name: [] for name in bodies}
    for _ in range(rounds):
        for name, body in bodies.items():
            u, known = np.zeros(body.inputs), np.zeros((10 * steps, body.inputs))
            u = u if body.environment is None else np.empty(0)
            assert body.ledger is not None
            for found, count in ((one_by_one, steps), (rolled_out, len(known))):
                body.restore(starts[name])
                start = time.process_time()
                if found is rolled_out:
                    body.rollout(known, outputs=[])
                else:
                    for _ in range(count):
                        body.step(u)
                body.ledger.supplied  # noqa: B018, it is booked by this
                found[name].append(count / (time.process_time() - start))
    first, second = (
        {name: statistics.median(values) for name, values in found.items()} for found in (one_by_one, rolled_out)
    )
    return first, second


def table_beside_full_order(out: Path, settle: int, steps: int, rounds: int) -> None:
    """Section 2: steps per second, reduced and at full order, of pads with few and with more points."""
    rows: dict[str, list[object]] = {name: [name] for name in SCALED}
    for bricks in (BRICKS, MORE_BRICKS):
        file = out / f"pad-{bricks[0]}.msh"
        mesh(file, bricks)
        scenes = {name: scene(case, file, settle * STEP) for name, case in SCALED.items()}
        system = fr.assemble(scenes["sticks"])
        rom, u = fr.reduce(system, order=ORDER), np.empty(0)
        bodies: dict[tuple[str, str], fr.Simulator | FullOrderSimulator] = {}
        for name, each in scenes.items():
            bodies[name, "reduced"] = settled(rom, each, settle)
            bodies[name, "full"] = FullOrderSimulator(system, STEP, each.environment)
            for _ in range(settle):
                bodies[name, "full"].step(u)
        for order in ("reduced", "full"):
            for load, signal in random_pushes().items():
                environment = bodies[RANDOM, order].environment
                assert environment is not None
                environment.set_signal(load, signal)
        found: dict[tuple[str, str], list[float]] = {key: [] for key in bodies}
        for _ in range(rounds):
            for key, body in bodies.items():
                start = time.process_time()
                for _ in range(steps):
                    body.step(u)
                found[key].append(steps / (time.process_time() - start))
        for (name, _), values in found.items():
            rows[name].append(f"{statistics.median(values):,.0f}")
    heading = ("steps per second", "20 points: reduced", "full order", "40 points: reduced", "full order")
    table = markdown(heading, list(rows.values()))
    (out / "full-order.md").write_text(table)
    print(table)


def random_pushes() -> dict[str, Callable[[float], Array]]:
    """Loads that are others in every step: aside up to what would make the pad slide, down from nothing to twice it."""
    drawn = np.random.default_rng(0).uniform(-1, 1, (10_000, 3))
    aside, down = COEFFICIENT * PRESSED * drawn * [1, 1, 0], PRESSED * drawn * [0, 0, 1] + [0, 0, WEIGHT - PRESSED]
    return {"push": lambda t: aside[int(t / STEP) % 10_000], "press": lambda t: down[int(t / STEP) % 10_000]}


@dataclass(frozen=True)
class Seen:
    """What is in contact, mean over some steps."""

    touching: float
    pushing: float
    sliding: float
    force: Array  # (3,), N, of the obstacle


def look(body: fr.Simulator, steps: int = 20) -> Seen:
    """What is in contact in the next steps.

    More points touch than the model has freedoms to tell apart, so that some of them need not push. A point slides
    where its friction is as large as it can be.
    """
    (name, obstacle), *_ = body.environment.obstacles.items()  # type: ignore[union-attr]
    points = body.contact_points
    touching, pushing, sliding, force = [], [], [], []
    for _ in range(steps):
        body.step()
        gaps, normals = obstacle.distance(body.rom.nodes[points] + body.displacement()[points])
        forces = body.contact_forces()
        pressure = (forces * normals).sum(axis=1)
        pushes = pressure > 1e-9 * pressure.max(initial=0.0)
        aside = np.linalg.norm(forces - pressure[:, None] * normals, axis=1)
        touching.append(np.count_nonzero(gaps < NEAR))
        pushing.append(np.count_nonzero(pushes))
        sliding.append(np.count_nonzero(pushes & (aside > 0.999 * COEFFICIENT * pressure)))
        force.append(body.contact_forces(name))
    counts = [float(np.mean(count)) for count in (touching, pushing, sliding)]
    return Seen(counts[0], counts[1], counts[2], np.mean(force, axis=0))


def table_of_rates(rates: dict[str, float], rolled_out: dict[str, float], seen: dict[str, Seen], out: Path) -> None:
    """Section 1."""
    rows: list[tuple[object, ...]] = []
    for name, rate in rates.items():
        known = seen.get(name)
        counts = (known.touching, known.pushing, known.sliding) if known else ()
        contact = [f"{count:.3g}" for count in counts] or [""] * 3
        each = f"{1e6 / rate:.0f} µs", f"{rates['neither'] / rate:.1f}"
        rows.append((name, *contact, f"{rate:,.0f}", *each, f"{rolled_out[name]:,.0f}"))
    heading = (
        *("case", "points that touch", "push", "slide", "steps per second", "each", "times a step of neither"),
        "in a rollout",
    )
    table = markdown(heading, rows)
    (out / "rates.md").write_text(table)
    print(f"{table}")


def table_of_errors(rom: fr.Rom, scenes: dict[str, fr.Scene], out: Path) -> dict[str, list[float]]:
    """Section 3: errors of the force of the obstacle against full order, in the 2-norm from the start on.

    Of a case: with and without residual compliance, and of full order at smaller steps and on another mesh.
    """
    errors = {}
    for name, scene in scenes.items():
        full = fr.simulate(scene)
        sensitive = [*(fr.simulate(scene, dt=STEP / n) for n in FINER), run_moved(scene, full, moved_aside)]
        contact = replace(scene.effects.contact, residual_compliance=False)
        stiff = replace(scene, effects=replace(scene.effects, contact=contact))
        runs = fr.simulate(rom, scene=scene), fr.simulate(rom, scene=stiff), *sensitive
        (obstacle,) = full.forces
        errors[name] = [fr.compare(run, full)[f"force of {obstacle}"].relative for run in runs]
    rows = [(name, *(f"{each:.1e}" for each in several)) for name, several in errors.items()]
    heading = (
        "error of the force, while it settles",
        "reduced",
        "without residual compliance",
        *FINER.values(),
        "full order, nodes 1.3 mm aside",
    )
    table = markdown(heading, rows)
    (out / "errors.md").write_text(table)
    print(table)
    return errors


def moved_aside(nodes: Array) -> Array:
    """Nodes (N, 3), m, of the same pad, moved along its sides."""
    for axis in (0, 1):
        nodes = slid(nodes, axis=axis, ends=(0.0, SIZE[axis]), way=WAY / np.sqrt(2))
    return nodes


def table_of_batches(size: int, steps: int, out: Path) -> float:
    """Section 5: rates of pads that are stepped together, each pushed at random; how far one is from a single one."""
    rows, worst = [], 0.0
    for points, bricks in POINTS.items():
        file = out / f"pads-{points}.msh"
        mesh(file, bricks)
        rom = fr.reduce(fr.assemble(scene(CASES["at rest"], file, STEP)), order=ORDER_TOGETHER)
        for name, (every, share) in PUSHED.items():
            bodies, single = fr.Batch(rom, size, STEP), fr.Simulator(rom, STEP, ledger=False)
            together, alone = pushed_about(bodies, single, every, share, steps)
            touching = np.count_nonzero(bodies.point_forces.any(axis=2)) / size
            off = np.abs(bodies.state(0)[0][0] - single.state[0]).max() / np.abs(single.state[0]).max()
            worst = max(worst, off)
            rates = f"{size * together:,.0f}", f"{alone:,.0f}", f"{size * together / alone:.1f}"
            rows.append((points, name, f"{touching:.1f}", *rates, f"{off:.0e}"))
    heading = ("points", f"{size} pads", "points that push", "steps of a pad per second", "of a single one", "ratio")
    table = markdown((*heading, "difference"), rows)
    (out / "batches.md").write_text(table)
    print(table)
    return worst


def pushed_about(bodies: fr.Batch, single: fr.Simulator, every: int, share: float, steps: int) -> tuple[float, float]:
    """Steps per second of all bodies, and of a single one that is pushed like the first; best of parts in turns."""
    random, seconds, u = np.random.default_rng(0), np.zeros((2, 4)), np.zeros((bodies.size, bodies.inputs))
    for part in range(5):  # the first of them is for settling
        for step in range(steps):
            if every and step % every == 0:
                u = random.uniform(-1, 1, u.shape) * share * COEFFICIENT * PRESSED
            started = time.process_time()
            bodies.step(u)
            between = time.process_time()
            single.step(u[0])
            if part:
                seconds[:, part - 1] += between - started, time.process_time() - between
    together, alone = steps / seconds.min(axis=1)
    return float(together), float(alone)


def table_of_worlds(roms: dict[str, fr.Rom], steps: int, rounds: int, out: Path) -> None:
    """Section 6: steps per second of a pad by its simulator, and in a world that has nothing else; best of rounds."""
    rows = []
    for name, rom in roms.items():
        body, world = fr.Simulator(rom, STEP), fr.World({"pad": fr.SoftBody(rom)}, STEP)
        u = np.zeros(body.inputs)
        ways = {
            "simulator": lambda body=body, u=u: body.step(u),
            "world": lambda world=world, u=u: world.step({"pad": u}),
        }
        count, found = 20 * steps if rom.environment.is_plain else steps, dict.fromkeys(ways, 0.0)
        for _ in range(2 * rounds):
            for way, step in ways.items():
                start = time.process_time()
                for _ in range(count):
                    step()
                found[way] = max(found[way], count / (time.process_time() - start))
        ratio = found["world"] / found["simulator"]
        rows.append((name, f"{found['simulator']:,.0f}", f"{found['world']:,.0f}", f"{ratio:.2f}"))
    table = markdown(("steps per second", "by its simulator", "in a world alone", "ratio"), rows)
    (out / "worlds.md").write_text(table)
    print(table)


def table_of_effects(rom: fr.Rom, scenes: dict[str, fr.Scene], out: Path) -> None:
    """Section 4: microseconds per step of each effect, from the start on."""
    profiles = {name: fr.simulate(rom, scene=scene, profile=True).profile for name, scene in scenes.items()}
    parts = list(dict.fromkeys(part for profile in profiles.values() for part in profile))
    rows = [(part, *(f"{1e6 * profile.get(part, 0.0):.1f}" for profile in profiles.values())) for part in parts]
    table = markdown(("µs of a step, from rest on", *profiles), rows)
    (out / "effects.md").write_text(table)
    print(table)


def check(
    rates: dict[str, float],
    seen: dict[str, Seen],
    bodies: dict[str, fr.Simulator],
    whole: fr.Rom,
    bare: fr.Rom,
    scenes: dict[str, fr.Scene],
    errors: dict[str, list[float]],
    off: float,
) -> None:
    """The claims of this page, measured; without errors those of short loops."""
    quick = not errors
    held = max(abs(seen[name].force[2] / PRESSED - 1) for name in ON_THE_GROUND)
    dragged = abs(seen["slides"].force[0] / (COEFFICIENT * PRESSED) + 1)
    gaps = []
    for body in bodies.values():
        account = body.ledger
        assert account is not None
        size = max(body.energy, account.supplied, account.dissipated)
        gaps.append(abs(body.energy - account.supplied + account.dissipated) / size if size else 0.0)
    plain, asked = fr.Simulator(bare, STEP), fr.Simulator(bare, STEP, scene=scenes["neither"])
    for u in np.random.default_rng(0).standard_normal((100, plain.inputs)):
        plain.step(u)
        asked.step(u)
    same = all(np.array_equal(*pair) for pair in zip(plain.state, asked.state, strict=True))
    claims = {
        "what does not name contact has no part of it": asked.environment is None
        and type(asked._stepper.kernel) is FusedMidpoint,
        "it steps to the same bits": same,
        f"a pad of a batch moves as a single one, to 1e-5: {off:.1e}": off < 1e-5,
        "of 20 points at least 14 push in the first four cases": quick
        or min(seen[name].pushing for name in ON_THE_GROUND) >= 14,
        f"the ground carries what presses, to 1e-4: {held:.1e}": quick or held < 1e-4,
        f"what slides is held back by the coefficient of friction times that, to 1e-4: {dragged:.1e}": quick
        or dragged < 1e-4,
        f"the energy account closes to 1e-12: {max(gaps):.1e}": max(gaps) < 1e-12,
        "nothing touches what is out of reach": seen["nothing in reach"].touching == 0,
    }
    for name, (close, stiff, step, *_) in errors.items():
        claims[f"{name}: the force is at most half as far off as without residual compliance"] = close < stiff / 2
        claims[f"{name}: and at most twice as far as the step itself makes"] = close < 2 * step
    for claim, holds in claims.items():
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    if not quick:
        for name in ON_THE_GROUND:
            verdict = "reached" if rates[name] >= WANTED else "missed"
            print(f"  {verdict}: {WANTED:,.0f} steps a second, {name}: {rates[name]:,.0f}")
    if not all(claims.values()):
        sys.exit(1)


if __name__ == "__main__":
    main()
