"""Steps per second of the pads in NumPy and compiled, in turns, with how far they are from one another.

`.venv/bin/python demos/contact_rates/compiled.py` (3 min): tables on the screen and in out/compiled.md.
"""

import statistics
import time
from contextlib import nullcontext
from pathlib import Path

import numpy as np
from pads import BRICKS, CASES, MORE_BRICKS, ORDER, STEP, Case, mesh, scene, settled
from step_rates import RANDOM, random_pushes

import fenics_rom as fr
from fenics_rom.compilation import numpy_alone
from fenics_rom.io.markdown import markdown

OUT = Path(__file__).parent / "out"
SETTLE, STEPS, ROUNDS = 300, 200, 5
SHOWN = [name for name in CASES if name not in ("loads alone", "neither")]


def bodies_of(case: Case, file: Path, pushed: bool) -> dict[str, fr.Simulator]:
    """The settled pad in NumPy and compiled."""
    acting = scene(case, file, SETTLE * STEP)
    rom, bodies = fr.reduce(fr.assemble(acting), order=ORDER), {}
    for name, made in (("NumPy", numpy_alone()), ("compiled", nullcontext())):
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


def main() -> None:
    """Measures all cases with 20 points, and random pushes with 40, too."""
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
    table = markdown(heading, rows)
    (OUT / "compiled.md").write_text(table)
    print(table)


if __name__ == "__main__":
    main()
