"""What many pads cost that are stepped together."""

import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pads import BRICKS, CASES, COEFFICIENT, MORE_BRICKS, PRESSED, STEP, mesh, scene

import fenics_rom as fr
from fenics_rom.io.markdown import markdown

POINTS = {8: (3, 1, 2), 20: BRICKS, 40: MORE_BRICKS}  # that touch
ORDER = 14  # and six rigid motions
VERY_MANY, LARGE_ORDER = 4096, 34  # pads, and the order of theirs without rigid motions
PARTS = 9  # of a run, whose median counts
# The rate of a single one, wanted; a single pad with 40 points hardly searches for forces where it is lucky, and the
# ratio comes down to 33.
TIMES = {8: 40.0, 20: 40.0, 40: 25.0}
PUSHED = {  # anew after so many steps, with at most that share of what moves it
    "at rest": (0, 0.0),
    "pushed anew every ten steps": (10, 0.25),
    "in every step, four times as hard": (1, 1.0),
}


def table_of_batches(size: int, steps: int, out: Path) -> tuple[float, dict[str, bool]]:
    """Rates of pads that are stepped together, pushed at random: how far one is from a single one, what is reached."""
    rows, worst, reached = [], 0.0, {}
    for points, bricks in POINTS.items():
        file = out / f"pads-{points}.msh"
        mesh(file, bricks)
        rom = fr.reduce(fr.assemble(scene(CASES["at rest"], file, STEP)), order=ORDER)
        for name, (every, share) in PUSHED.items():
            bodies, single = fr.Batch(rom, size, STEP), fr.Simulator(rom, STEP, ledger=False)
            together, alone = pushed_about((bodies, single), every, share, steps)
            touching = np.count_nonzero(bodies.point_forces.any(axis=2)) / size
            off = np.abs(bodies.state(0)[0][0] - single.state[0]).max() / np.abs(single.state[0]).max()
            worst = max(worst, off)
            rates = f"{size * together:,.0f}", f"{alone:,.0f}", f"{size * together / alone:.1f}"
            reached[f"{TIMES[points]:g} times the rate of a single one, {points} points, {name}: {rates[2]}"] = (
                size * together >= TIMES[points] * alone
            )
            rows.append((points, name, f"{touching:.1f}", *rates, f"{off:.0e}"))
    heading = ("points", f"{size} pads", "points that push", "steps of a pad per second", "of a single one", "ratio")
    table = markdown((*heading, "difference"), rows)
    (out / "batches.md").write_text(table)
    print(table)
    return worst, reached


def pushed_about(pads: Sequence[fr.Batch | fr.Simulator], every: int, share: float, steps: int) -> list[float]:
    """Steps per second of batches, the first of all, and of single pads that are pushed like their first ones.

    Medians of parts in turns.
    """
    random, seconds, u = (
        np.random.default_rng(0),
        np.zeros((PARTS, len(pads))),
        np.zeros((pads[0].size, pads[0].inputs)),
    )
    for part in range(1 + PARTS):  # the first of them is for settling
        for step in range(steps):
            if every and step % every == 0:
                u = random.uniform(-1, 1, u.shape) * share * COEFFICIENT * PRESSED
            for k, pad in enumerate(pads):
                started = time.process_time()
                pad.step(u if isinstance(pad, fr.Batch) else u[0])
                seconds[part - 1, k] += (time.process_time() - started) * (part > 0)
    rates: list[float] = (steps / np.median(seconds, axis=0)).tolist()
    return rates


def table_of_very_many(size: int, steps: int, out: Path) -> None:
    """Rate and memory of a process that steps pads of order 40 with 40 points, pushed anew every ten steps."""
    file, rom_file = out / "pads-40.msh", out / "pads-40.h5"
    mesh(file, MORE_BRICKS)
    rom = fr.reduce(fr.assemble(scene(CASES["at rest"], file, STEP)), order=LARGE_ORDER)
    fr.write_rom(rom_file, rom)
    _, share = PUSHED["pushed anew every ten steps"]
    given = rom_file, size, STEP, share * COEFFICIENT * PRESSED, steps
    script = Path(__file__).with_name("many_pads.py")
    told = subprocess.run([sys.executable, script, *map(str, given)], capture_output=True, text=True, check=True)
    rate, memory, push = told.stdout.split()
    order = next(iter(rom.contact_models.values())).order
    heading = ("pads", "order", "points that push", "steps of a pad per second", "memory of the process")
    table = markdown(heading, [(f"{size:,}", order, push, f"{float(rate):,.0f}", f"{memory} MB")])
    (out / "very_many.md").write_text(table)
    print(table)
