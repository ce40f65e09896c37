"""Bodies that are free, held in part, held by next to nothing, or not connected."""

from collections.abc import Iterator

import numpy as np
from boxes import box
from measures import accounts, both_runs
from rows import Row

import fenics_rom as fr

LENGTHS, BRICKS = (0.3, 0.1, 0.1), (3, 1, 1)
PUSH = (0.0, 0.0, 0.1)  # N
SPRING = '[effects.springs.ground]\nsurface = "bottom"\nstiffness = {}'
GRAVITY = "gravity = { acceleration = [0.0, 0.0, -9.81] }"


def rows(quick: bool) -> Iterator[Row]:
    """All of them; `quick`: short runs."""
    steps = 100 if quick else 2000
    yield from supports(steps)
    yield from falls(steps)


def supports(steps: int) -> Iterator[Row]:
    """How many rigid motions there are, and reduced runs against full order."""
    on = {f"right{k or ''}": f'surface = "right{k or ""}"\nforce = "resultant"' for k in range(3)}
    first = {"right": on["right"]}
    cases = {
        "free": ({"clamped": False}, 6),
        "two parts, one held": ({"copies": 2, "contacts": {name: on[name] for name in ("right", "right1")}}, 6),
        "three parts, none held": ({"copies": 3, "clamped": False, "contacts": on}, 18),
        "three parts, one held, of which one is pushed": ({"copies": 3, "contacts": first}, 12),
        "on a spring of 1e-4 N/m": ({"clamped": False, "effects": SPRING.format("1e-4")}, 0),
        "on a spring of 1e6 N/m": ({"clamped": False, "effects": SPRING.format("1e6")}, 0),
    }
    for case, (choices, count) in cases.items():
        system = box(LENGTHS, BRICKS, **choices)  # type: ignore[arg-type]
        rom = fr.reduce(system, order=20)
        gap = abs(rom.rigid - count)
        yield Row(case, "rigid motions", f"number of rigid motions, difference from {count}", gap, 0)
        runs = both_runs(system, rom, PUSH, steps=steps, dt=1e-3)
        yield Row(case, "rigid motions", "order 20 against full order: error of the run", runs.error, 1e-3)
        yield from accounts(case, "rigid motions", runs)


def falls(steps: int) -> Iterator[Row]:
    """A free body without damping by α falls along a parabola and does not turn or strain, whatever the step."""
    system = box(LENGTHS, BRICKS, clamped=False, damping="alpha = 0.0, beta = 1e-3", effects=GRAVITY)
    rom = fr.reduce(system, order=20)
    for dt in (1e-6, 1e-3, 1.0):
        gap = parabola_gap(rom, dt, steps)
        yield Row(f"falls, steps of {dt:g} s", "rigid motions", "distance from a parabola, relative", gap, 1e-9)


def parabola_gap(rom: fr.Rom, dt: float, steps: int) -> float:
    """How far a body that falls ends from where it should, as a share of the way."""
    body = fr.Simulator(rom, dt)
    for _ in range(steps):
        body.step()
    way = -9.81 * body.time**2 / 2
    return float(np.abs(body.displacement() - [0.0, 0.0, way]).max() / abs(way))
