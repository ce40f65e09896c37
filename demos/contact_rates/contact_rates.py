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
   beside a single one, and by how much these two differ; and rate and memory of a process that steps 4,096;
6. tables the rate of a world that has such a pad alone, beside that of its simulator;
7. checks that the scene without contact steps as if there was no such thing: in the same form, to the same bits.

Everything is written to demos/contact_rates/out/, with --quick to out/quick/. The checks at the end are on what
touches, on forces, on energy and on ratios of rates within the run; --quick leaves out the latter.
"""

import argparse
import os
import sys
import warnings
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "poke"))
os.environ["FENICS_ROM_COMPILED"] = "0"  # rates of NumPy alone: compiled.py has both

from force_errors import COMPARED, table_of_errors
from pad_batches import VERY_MANY, table_of_batches, table_of_very_many
from pads import BRICKS, CASES, COEFFICIENT, ON_THE_GROUND, ORDER, PRESSED, STEP, mesh, scene, settled
from step_rates import in_turns, table_beside_full_order, table_of_effects, table_of_rates, table_of_worlds
from touching_points import Seen, look

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.runtime.steppers.midpoint import FusedMidpoint

OUT = Path(__file__).parent / "out"
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
TOGETHER = 1024  # pads that are stepped together
FEW_TOGETHER = 16  # with --quick
SLOWER = 50.0  # times as long as one without contact a step with all points touching and friction takes, at most


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
    off, reached = table_of_batches(FEW_TOGETHER if quick else TOGETHER, steps // 2, out)
    table_of_very_many(FEW_TOGETHER if quick else VERY_MANY, steps // 5, out)
    table_of_worlds({"sticks": whole, "neither": bare}, steps, rounds, out)
    errors = {} if quick else table_of_errors(whole, {name: scenes[name] for name in COMPARED}, out)
    check(rates, seen, bodies, bare, scenes["neither"], errors, off, reached)


def check(
    rates: dict[str, float],
    seen: dict[str, Seen],
    bodies: dict[str, fr.Simulator],
    bare: fr.Rom,
    empty: fr.Scene,
    errors: dict[str, list[float]],
    off: float,
    reached: dict[str, bool],
) -> None:
    """The claims of this page, measured; without errors those of short loops."""
    quick = not errors
    held = max(abs(seen[name].force[2] / PRESSED - 1) for name in ON_THE_GROUND)
    dragged = abs(seen["slides"].force[0] / (COEFFICIENT * PRESSED) + 1)
    gap = max(unaccounted(body) for body in bodies.values())
    plain, asked = fr.Simulator(bare, STEP), fr.Simulator(bare, STEP, scene=empty)
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
        f"the energy account closes to 1e-12: {gap:.1e}": gap < 1e-12,
        "nothing touches what is out of reach": seen["nothing in reach"].touching == 0,
    }
    for name, (close, stiff, step, *_) in errors.items():
        claims[f"{name}: the force is at most half as far off as without residual compliance"] = close < stiff / 2
        claims[f"{name}: and at most twice as far as the step itself makes"] = close < 2 * step
    if not quick:
        for name in ON_THE_GROUND:
            times = rates["neither"] / rates[name]
            claims[f"{name}: a step takes at most {SLOWER:g} times as long as without contact: {times:.1f}"] = (
                times <= SLOWER
            )
        claims |= reached
    for claim, holds in claims.items():
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    if not all(claims.values()):
        sys.exit(1)


def unaccounted(body: fr.Simulator) -> float:
    """What its energy account misses, as a share of the largest of its sums."""
    account = body.ledger
    assert account is not None
    size = max(body.energy, account.supplied, account.dissipated)
    return abs(body.energy - account.supplied + account.dissipated) / size if size else 0.0


if __name__ == "__main__":
    main()
