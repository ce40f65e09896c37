"""What a step of a pad costs: by what is in contact, beside full order, by effects, and in a world."""

import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from pads import BRICKS, CASES, COEFFICIENT, MORE_BRICKS, ORDER, PRESSED, STEP, WEIGHT, mesh, scene, settled
from touching_points import Seen

import fenics_rom as fr
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.io.markdown import markdown

RANDOM = "random pushes"
SCALED = {"at rest": CASES["at rest"], "sticks": CASES["sticks"], "slides": CASES["slides"], RANDOM: CASES["sticks"]}

Array = np.ndarray


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


def table_of_rates(rates: dict[str, float], rolled_out: dict[str, float], seen: dict[str, Seen], out: Path) -> None:
    """Steps per second of each case, beside what is in contact."""
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


def table_beside_full_order(out: Path, settle: int, steps: int, rounds: int) -> None:
    """Steps per second, reduced and at full order, of pads with few and with more points."""
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


def table_of_effects(rom: fr.Rom, scenes: dict[str, fr.Scene], out: Path) -> None:
    """Microseconds per step of each effect, from the start on."""
    profiles = {name: fr.simulate(rom, scene=scene, profile=True).profile for name, scene in scenes.items()}
    parts = list(dict.fromkeys(part for profile in profiles.values() for part in profile))
    rows = [(part, *(f"{1e6 * profile.get(part, 0.0):.1f}" for profile in profiles.values())) for part in parts]
    table = markdown(("µs of a step, from rest on", *profiles), rows)
    (out / "effects.md").write_text(table)
    print(table)


def table_of_worlds(roms: dict[str, fr.Rom], steps: int, rounds: int, out: Path) -> None:
    """Steps per second of a pad by its simulator, and in a world that has nothing else; best of rounds."""
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
