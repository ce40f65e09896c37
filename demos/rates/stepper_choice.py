"""Which stepper of large deformation comes to an error sooner: what the choice of `make_stepper` rests on.

    python demos/rates/stepper_choice.py           # two minutes, most of them to reduce
    python demos/rates/stepper_choice.py --quick   # a coarse arm of low order, to see that it works

The arm of `large_deformation.py`, of two materials, is pulled by its tendon, by a tension and by a stroke, for four
periods of its slowest mode. Errors are of the tip, beside Newton's steps of a sixteenth of the shortest, as shares of
its largest displacement; rates are of processor time. Both steppers are of second order, so the linearly implicit one
comes to any error sooner where its own is below Newton's times the square of how many times as fast it is.

Everything is written to demos/rates/out/stepper_choice/.
"""

import argparse
import math
import os
import sys
import time
import warnings
from dataclasses import replace
from pathlib import Path

import large_deformation as arm
import numpy as np
from findings import Findings

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.mechanics.step import FINITE_STRAIN_STEPPERS
from fenics_rom.runtime.steppers.selection import LINEARLY_IMPLICIT_STEPS
from fenics_rom.scene.file import parse_scene
from fenics_rom.scene.scene import Scene

OUT = Path(__file__).parent / "out" / "stepper_choice"
STEPS = (96, 48, 24, 12, 8)  # in a period
PERIODS, FINER = 4, 16
LARGEST = {"tension": 2.0, "stroke": 3e-3}  # N and m
ORDER, COARSE_ORDER, ROUNDS = 20, 8, 5
MOST_LESS_EXACT = 4.0  # times Newton's error, the most that a step may have which is chosen for being faster

Array = np.ndarray


def main() -> None:
    """Runs the demo."""
    parser = argparse.ArgumentParser(description="Measures which stepper comes to an error sooner.")
    parser.add_argument("--quick", action="store_true", help="a coarse mesh and few steps; rates are not judged")
    quick = parser.parse_args().quick
    if not arm.ONE_THREAD.items() <= os.environ.items():  # read when NumPy is loaded, so it takes another start
        os.execve(sys.executable, [sys.executable, *sys.argv], os.environ | arm.ONE_THREAD)
    out = OUT / "quick" if quick else OUT
    out.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore", FenicsRomWarning)
    arm.mesh(out / "arm.msh", arm.COARSE if quick else arm.BRICKS)
    findings, rows = Findings(judge_rates=not quick), list[tuple[object, ...]]()
    newton, implicit = FINITE_STRAIN_STEPPERS
    counts = STEPS[-2:] if quick else STEPS
    finest = FINER * counts[0]
    for law, poisson in arm.LAWS.items():
        text = arm.SCENE.format(file="arm.msh", law=law, poisson=poisson, step=arm.STEP)
        scene = parse_scene(text, folder=out, source="arm")
        rom = fr.reduce(fr.assemble(scene), order=COARSE_ORDER if quick else ORDER)
        period = period_of(rom)
        for drive in LARGEST:
            driven = scene_of(text, out, drive, period)
            exact, _ = run(rom, driven, period / finest, newton)
            for steps in counts:
                found = {
                    each: run(rom, driven, period / steps, each, 1 if quick else ROUNDS) for each in (newton, implicit)
                }
                times = finest // steps
                errors = {each: arm.distance(tip, exact[::times]) for each, (tip, _) in found.items()}
                less_exact, faster = errors[implicit] / errors[newton], found[implicit][1] / found[newton][1]
                rows.append(
                    (law, drive, steps, *(f"{e:.0e}" for e in errors.values()), f"{less_exact:.1f}", f"{faster:.1f}")
                )
                case = f"{law}, {drive}, {steps} steps in a period"
                if steps >= LINEARLY_IMPLICIT_STEPS:
                    findings.at_most(
                        f"{case}: error of linearly implicit steps, in Newton's", less_exact, MOST_LESS_EXACT
                    )
                    findings.at_least(f"{case}: squared rate, in that", faster**2 / less_exact, 1, rate=True)
    columns = (
        "material",
        "given",
        "steps in a period",
        "error, Newton",
        "error, linearly implicit",
        "times",
        "rate, times",
    )
    findings.table("## Linearly implicit steps beside Newton's", columns, rows)
    held = findings.verdict()
    (out / "stepper_choice.md").write_text("\n".join(findings.tables))
    if not held:
        sys.exit(1)


def scene_of(text: str, folder: Path, drive: str, period: float) -> Scene:
    """The scene, whose tendon is given a tension or a stroke that comes and goes."""
    times = np.linspace(0, PERIODS * period, 500)
    table = np.column_stack([times, LARGEST[drive] * np.sin(np.pi * times / times[-1]) ** 2])
    np.savetxt(folder / f"{drive}.csv", table, delimiter=",", header="time,value", comments="")
    text = text.replace("force = [3.0]       # N", f'table = "{drive}.csv"')
    if drive == "stroke":
        text = text.replace("[effects.tendon.flexor]", '[effects.tendon.flexor]\ncontrol = "length"')
    return parse_scene(text, folder=folder, source="arm")


def run(rom: fr.Rom, scene: Scene, dt: float, stepper: str, rounds: int = 1) -> tuple[Array, float]:
    """Displacements (steps + 1, 3) of the tip, m, and steps per second, the best of some rounds."""
    assert scene.run is not None
    scene, best = replace(scene, run=replace(scene.run, dt=dt, duration=PERIODS * period_of(rom))), math.inf
    for _ in range(rounds):
        begun = time.process_time()
        trajectory = fr.simulate(rom, scene=scene, stepper=stepper)
        best = min(best, time.process_time() - begun)
    return trajectory.outputs["tip"][:, 0], trajectory.steps / best


def period_of(rom: fr.Rom) -> float:
    """Of the slowest mode, s."""
    return 2 * math.pi / math.sqrt(next(iter(rom.contact_models.values())).eigenvalues[0])


if __name__ == "__main__":
    main()
