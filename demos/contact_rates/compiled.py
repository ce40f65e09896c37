"""Steps per second of pads, single and in batches, in NumPy and compiled, in turns, and how far they are apart.

`.venv/bin/python demos/contact_rates/compiled.py` (5 min): tables on the screen and in out/compiled.md.
"""

import os
import statistics
import time
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import numpy as np
from pad_batches import ORDER as ORDER_OF_MANY
from pad_batches import POINTS, PUSHED, pushed_about
from pads import BRICKS, CASES, MORE_BRICKS, ORDER, STEP, Case, mesh, scene, settled
from step_rates import RANDOM, random_pushes

import fenics_rom as fr
from fenics_rom.compilation import numpy_alone
from fenics_rom.io.markdown import markdown

OUT = Path(__file__).parent / "out"
os.environ["NUMBA_NUM_THREADS"] = "1"  # read when numba is loaded
SETTLE, STEPS, ROUNDS = 300, 200, 5
TOGETHER, STEPS_OF_MANY = 1024, 20
SHOWN = [name for name in CASES if name not in ("loads alone", "neither")]


def ways() -> tuple[tuple[str, AbstractContextManager[None]], ...]:
    """What is made within takes such steps."""
    return ("NumPy", numpy_alone()), ("compiled", nullcontext())


def bodies_of(case: Case, file: Path, pushed: bool) -> dict[str, fr.Simulator]:
    """The settled pad in NumPy and compiled."""
    acting = scene(case, file, SETTLE * STEP)
    rom, bodies = fr.reduce(fr.assemble(acting), order=ORDER), {}
    for name, made in ways():
        with made:
            bodies[name] = settled(rom, acting, SETTLE)
        if pushed:
            assert bodies[name].environment is not None
            for load, signal in random_pushes().items():
                bodies[name].environment.set_signal(load, signal)
    return bodies


def row_of(name: str, bodies: dict[str, fr.Simulator]) -> tuple[str, ...]:
    """Medians of rounds in turns; after as many steps of both, how far the displacements differ."""
    found: dict[str, list[float]] = {key: [] for key in bodies}
    rolled: dict[str, list[float]] = {key: [] for key in bodies}
    for _ in range(ROUNDS):
        for key, body in bodies.items():
            start = time.process_time()
            for _ in range(STEPS):
                body.step(())
            found[key].append(STEPS / (time.process_time() - start))
    one, other = (body.displacement() for body in bodies.values())
    difference = np.abs(one - other).max() / np.abs(one).max()
    for _ in range(ROUNDS):
        for key, body in bodies.items():
            start = time.process_time()
            body.rollout(np.zeros((2 * STEPS, body.inputs)), outputs=[])
            rolled[key].append(2 * STEPS / (time.process_time() - start))
    rates = [statistics.median(rate[key]) for rate in (found, rolled) for key in bodies]
    return name, *(f"{rate:,.0f}" for rate in rates), f"{difference:.0e}"


def rows_of_many(points: int, bricks: tuple[int, int, int]) -> list[tuple[object, ...]]:
    """Batches of pads with so many points, and single ones; how far their first pads are apart after all steps."""
    file = OUT / f"pads-{points}.msh"
    mesh(file, bricks)
    rom, rows = fr.reduce(fr.assemble(scene(CASES["at rest"], file, STEP)), order=ORDER_OF_MANY), []
    for name, (every, share) in PUSHED.items():
        pads: list[fr.Batch | fr.Simulator] = []
        for _, made in ways():
            with made:
                pads += fr.Batch(rom, TOGETHER, STEP), fr.Simulator(rom, STEP, ledger=False)
        numpy, alone, compiled, compiled_alone = pushed_about(pads, every, share, STEPS_OF_MANY)
        first, *others = (pad.state(0)[0][0] if isinstance(pad, fr.Batch) else pad.state[0] for pad in pads)
        off = max(np.abs(other - first).max() for other in others) / np.abs(first).max()
        rates = (f"{rate:,.0f}" for rate in (alone, compiled_alone, TOGETHER * numpy, TOGETHER * compiled))
        ratios = compiled / numpy, TOGETHER * compiled / alone, TOGETHER * compiled / compiled_alone
        rows.append((points, name, *rates, *(f"{ratio:.1f}" for ratio in ratios), f"{off:.0e}"))
        print(rows[-1])
    return rows


def main() -> None:
    """Measures all cases with 20 points, and random pushes with 40, too; then batches."""
    if not fr.compiled():
        raise SystemExit('compiled.py: nothing runs compiled; install numba: pip install "fenics-rom[fast]"')
    OUT.mkdir(exist_ok=True)
    rows = []
    for bricks, names in ((BRICKS, [*SHOWN, RANDOM]), (MORE_BRICKS, ["at rest", RANDOM])):
        file = OUT / f"compiled-{bricks[0]}.msh"
        mesh(file, bricks)
        points = (bricks[0] + 1) * (bricks[1] + 1)
        for name in names:
            case = CASES["sticks" if name == RANDOM else name]
            rows.append(row_of(f"{name}, {points} points", bodies_of(case, file, name == RANDOM)))
            print(rows[-1])
    heading = ("case", "NumPy", "compiled", "NumPy, in a rollout", "compiled, in a rollout", "difference")
    tables = [markdown(heading, rows)]
    many = [row for points, bricks in POINTS.items() for row in rows_of_many(points, bricks)]
    single, batch = ("a single one, NumPy", "compiled"), (f"{TOGETHER:,} pads, NumPy", "compiled")
    ratios = "beside NumPy's", "beside NumPy's single one", "beside the compiled one", "difference"
    tables.append(markdown(("points", "pads", *single, *batch, *ratios), many))
    (OUT / "compiled.md").write_text("\n".join(tables))
    print("\n".join(tables))


if __name__ == "__main__":
    main()
