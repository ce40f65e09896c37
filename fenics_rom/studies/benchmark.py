"""One reduced model, measured against the reference at every step of the grid."""

import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import fenics_rom as fr
from fenics_rom.errors import SceneError, StepError
from fenics_rom.io.progress import Report, silent
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.simulate import rate
from fenics_rom.scene.scene import Scene
from fenics_rom.studies.method_configs import METHOD_CONFIGS, StudyGrid
from fenics_rom.studies.pareto import format_step
from fenics_rom.studies.row_errors import against_reference, without_reference
from fenics_rom.studies.study_results import BenchmarkRow
from fenics_rom.system.system import System
from fenics_rom.trajectory.trajectory import Trajectory

ERROR_STAGE = "error model"  # of a reduction
VALIDATION_ERRORS = ("static_error", "transfer_error", "neglected")
# Shares of the trace, tried until the paper's selection has as many eigenvectors as asked.
TRACE_SHARES = (1 - 1e-5, 1 - 1e-8, 1 - 1e-11)


def reduce_timed(
    system: System, method: str, order: int, report: Report = silent, *, errors: bool | None = None
) -> tuple[Rom, float]:
    """The model and the seconds that its reduction took, without what it needs to tell errors; every rank must call it.

    Errors are those of `reduce`.
    """
    for share in TRACE_SHARES:
        start = time.perf_counter()
        named = METHOD_CONFIGS[method].method
        held = share if method == "selection" else None
        rom = fr.reduce(system, order=order, method=named, switching="energy", share=held, errors=errors, report=report)
        seconds = time.perf_counter() - start - sum(s.seconds for s in rom.stages if s.name == ERROR_STAGE)
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
    rom: Rom, seconds: float, method: str, scene: Scene, reference: Trajectory | None, grid: StudyGrid, report: Report
) -> tuple[tuple[BenchmarkRow, ...], tuple[str, ...]]:
    """Errors, rates and costs of a reduced model at each step of a grid; and why there are none of some.

    Without a reference errors are those that its run states, which a ROM with an error model does.

    Raises:
        StepError: the run at the reference's own step could not be made, or does not state its errors.
    """
    every = round(grid.steps[-1] / grid.reference_step) if reference is None else None  # telling errors takes long
    at_reference_step = fr.simulate(rom, scene=scene, dt=grid.reference_step, every=every, report=report)
    if reference is None:
        errors_of = without_reference(at_reference_step)
        rom = replace(rom, error_model=None)  # which is not what the others cost
    else:
        errors_of = against_reference(at_reference_step, reference)
    known = {key: [e for c in rom.validation.values() if (e := c[key]) is not None] for key in VALIDATION_ERRORS}
    worst: dict[str, Any] = {key: max(errors, default=None) for key, errors in known.items()}
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
        rows.append(
            BenchmarkRow(
                method=method,
                order=largest_order(rom),
                dt=dt,
                rate=rate(rom, scene=scene, dt=dt, runs=grid.rate_runs),
                offline=seconds,
                file_size=size,
                **errors_of(run),
                **worst,
            )
        )
    if scene.effects.contact is None:  # then a step costs the same whatever its length, and noise is all that differs
        rows = [replace(row, rate=max(other.rate for other in rows)) for row in rows]
    return tuple(rows), tuple(notes)
