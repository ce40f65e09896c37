"""One reduced model, measured against the reference at every step of the grid."""

import tempfile
import time
from dataclasses import replace
from pathlib import Path

import fenics_rom as fr
from fenics_rom.errors import SceneError, StepError
from fenics_rom.io.progress import Report, silent
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.simulate import rate
from fenics_rom.scene.scene import Scene
from fenics_rom.studies.method_configs import METHOD_CONFIGS, StudyGrid
from fenics_rom.studies.pareto import format_step
from fenics_rom.studies.study_results import BenchmarkRow
from fenics_rom.system.system import System
from fenics_rom.trajectory.comparison import compare, force_errors
from fenics_rom.trajectory.trajectory import Trajectory

VALIDATION_ERRORS = ("static_error", "transfer_error", "neglected")
# Shares of the trace, tried until the paper's selection has as many eigenvectors as asked.
TRACE_SHARES = (1 - 1e-5, 1 - 1e-8, 1 - 1e-11)


def reduce_timed(system: System, method: str, order: int, report: Report = silent) -> tuple[Rom, float]:
    """The model and the seconds that its reduction took; errors are those of `reduce`; every rank must call it."""
    for share in TRACE_SHARES:
        start = time.perf_counter()
        named = METHOD_CONFIGS[method].method
        held = share if method == "selection" else None
        rom = fr.reduce(system, order=order, method=named, switching="energy", share=held, report=report)
        seconds = time.perf_counter() - start
        most, least = (of(mode.order - mode.rigid for mode in rom.contact_models.values()) for of in (max, min))
        if method != "selection" or least >= order:
            break
    if most > order:  # the paper's selection takes more eigenvectors than directions
        rom = fr.truncate(rom, order)
    return rom, seconds


def largest_order(rom: Rom) -> int:
    """Displacements of the contact mode that has most."""
    return max(mode.order for mode in rom.contact_models.values())


def measure_model(
    rom: Rom, seconds: float, method: str, scene: Scene, reference: Trajectory, grid: StudyGrid, report: Report
) -> tuple[tuple[BenchmarkRow, ...], tuple[str, ...]]:
    """Errors, rates and costs of a reduced model at each step of a grid; and why there are none of some.

    Raises:
        StepError: the run at the reference's own step could not be made.
    """
    at_reference_step = fr.simulate(rom, scene=scene, dt=reference.settings["dt"], report=report)
    reduction = compare(at_reference_step, reference)["shape"].relative
    known = {key: [e for c in rom.validation.values() if (e := c[key]) is not None] for key in VALIDATION_ERRORS}
    worst = {key: max(errors, default=None) for key, errors in known.items()}
    with tempfile.TemporaryDirectory() as folder:
        fr.write_rom(file := Path(folder, "rom.h5"), rom)
        size = file.stat().st_size
    rows, notes = [], []
    for dt in grid.steps:
        try:
            run = fr.simulate(rom, scene=scene, dt=dt, report=report)
        except (SceneError, StepError) as error:  # a load too short for the step, or contact that it cannot resolve
            notes.append(f"{METHOD_CONFIGS[method].label}, order {largest_order(rom)}, step {format_step(dt)}: {error}")
            continue
        differences = compare(run, reference)
        shape = differences["shape"]
        rows.append(
            BenchmarkRow(
                method=method,
                order=largest_order(rom),
                dt=dt,
                error=shape.relative,
                largest=shape.largest / shape.largest_reference,
                outputs={
                    name.removeprefix("output "): (d.relative, d.largest / d.largest_reference if d.largest else 0.0)
                    for name, d in differences.items()
                    if name.startswith("output ") or name == "elastic shape"
                },
                energy=differences["energy"].relative,
                reduction=reduction,
                time_step=compare(run, at_reference_step)["shape"].relative,
                rate=rate(rom, scene=scene, dt=dt, runs=grid.rate_runs),
                offline=seconds,
                file_size=size,
                forces=force_errors(differences),
                **worst,
            )
        )
    if scene.effects.contact is None:  # then a step costs the same whatever its length, and noise is all that differs
        rows = [replace(row, rate=max(other.rate for other in rows)) for row in rows]
    return tuple(rows), tuple(notes)
