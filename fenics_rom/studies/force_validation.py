"""How far the contact forces of a reduced model are off, in as much of its scene's run as is affordable."""

import time
import warnings
from dataclasses import replace

import numpy as np

import fenics_rom as fr
from fenics_rom.errors import FenicsRomError, FenicsRomWarning, check_type
from fenics_rom.fem.ranks import run_on_rank_0
from fenics_rom.io.progress import Report, silent
from fenics_rom.io.stages import Stage, peak_memory
from fenics_rom.mechanics.environment import Run
from fenics_rom.rom.rom import ForceValidation, Rom
from fenics_rom.scene.scene import Scene
from fenics_rom.system.system import System
from fenics_rom.trajectory.comparison import FORCE_MEASURES, ForceErrors, compare, force_errors
from fenics_rom.trajectory.trajectory import Trajectory

WORK = 4e6  # full-order steps times (unknowns + OVERHEAD), of both runs: ten seconds or so of one core
LARGE_WORK = 3 * WORK  # of a body that deforms largely, whose reduction takes minutes
NEWTON = 5  # linear steps that cost as much as one of large deformation
OVERHEAD = 2000  # unknowns that a step costs even of the smallest body
STEPS_AFTER = 50  # from the first touch on, at least; else as many as it took to get there
WARNING_ERROR = 0.1  # of a contact force, beyond which the user is told


def validate_forces(system: System, rom: Rom, *, report: Report = silent) -> Rom:
    """Measures how far contact forces are off: the beginning of the scene's run, reduced and at full order.

    Both take the scene's time step, so what the step does is not in that; it is told apart, by the full order at half
    of it. They begin at rest and go on until some time after the reduced model first touches an obstacle, at most as
    far as some seconds pay for, whatever the size: 222 steps of 4,000 unknowns, 13 of 100,000; of large deformation
    three fifths of that, for half a minute. `fenics-rom reduce` calls it; every rank must.

    Args:
        system: the full-order model.
        rom: reduced from it.
        report: called with the stage, how much of it is done, and of how much.

    Returns:
        The ROM with `force_validation`, and a stage that says what that cost; the same ROM where the scene has no
        obstacles or no run. Where forces are off by more than a tenth, and by more than the step makes, it warns.

    Example:
        >>> fr.validate_forces(system, rom).force_validation is None  # nothing here is touched
        True
    """
    check_type("validate_forces", system, System, "fr.assemble(scene)")
    check_type("validate_forces", rom, Rom, "fr.reduce(system)")
    scene = system.scene
    if scene is None or scene.run is None or not scene.environment.obstacles:
        return rom
    start = time.perf_counter()
    validation: ForceValidation | None = None
    try:
        validation, messages = _validation(system, rom, replace(scene, run=_affordable(scene.run, system)), report)
    except FenicsRomError as error:
        messages = [f"contact forces were not validated: {error}"]
    for message in messages:
        warnings.warn(message, FenicsRomWarning, stacklevel=2)
    stage = Stage("validation of contact forces", time.perf_counter() - start, peak_memory())
    return replace(rom, force_validation=validation, stages=(*rom.stages, stage), warnings=(*rom.warnings, *messages))


def _affordable(run: Run, system: System) -> Run:
    """As many of its steps as the work pays for, each of which is one at full order, and two of half its length."""
    work = WORK if system.deformation is None else LARGE_WORK / NEWTON
    return _beginning(run, max(int(work / 3 / (system.size + OVERHEAD)), 1))


def _beginning(run: Run, steps: int) -> Run:
    """So many of its steps, or all."""
    duration = min(run.duration, steps * run.dt)
    loads = tuple(a for a in run.loads if a.start < duration - run.dt)
    return replace(run, duration=duration, snapshots=1, loads=loads)


def _validation(system: System, rom: Rom, scene: Scene, report: Report) -> tuple[ForceValidation, list[str]]:
    comm, run = system.algebra.comm, scene.run  # type: ignore[attr-defined]
    assert run is not None
    with warnings.catch_warnings(action="ignore", category=FenicsRomWarning):  # whoever runs it is told
        reduced = run_on_rank_0(comm, lambda: fr.simulate(rom, scene=scene))
        touching = np.flatnonzero(sum(np.abs(force).sum(axis=1) for force in reduced.forces.values()))
        if not len(touching):
            return ForceValidation(run.dt, run.duration, {}, {}), []
        first = round(reduced.times[touching[0]] / run.dt)
        run = _beginning(run, first + max(first, STEPS_AFTER))
        scene, steps = replace(scene, run=run), 3 * round(run.duration / run.dt)
        reduced = run_on_rank_0(comm, lambda: fr.simulate(rom, scene=scene))

        def full(dt: float, done: int) -> Trajectory:
            system_now = replace(system, scene=scene)
            return fr.simulate(system_now, dt=dt, report=lambda _, k, of: report("contact forces", done + k, steps))

        at_step, at_half = full(run.dt, 0), full(run.dt / 2, steps // 3)
        reduction, time_step = force_errors(compare(reduced, at_step)), force_errors(compare(at_step, at_half))
    messages, known = [], []
    for name, errors in reduction.items():
        if not np.isfinite(errors).all():
            messages.append(f"{name} touches the body in the reduced model alone, {_covered(run)}")
        elif not np.isfinite(time_step[name]).all():
            messages.append(f"{name} touches the full order at a step of {run.dt:g} s alone, {_covered(run)}")
        else:
            known.append(name)
            if any(error > max(WARNING_ERROR, own) for error, own in zip(errors, time_step[name], strict=True)):
                messages.append(_doubt(name, errors, time_step[name], run))
    by_name = ({name: errors[name] for name in known} for errors in (reduction, time_step))
    return ForceValidation(run.dt, run.duration, *by_name), messages


def _covered(run: Run) -> str:
    return f"in the first {run.duration:g} s of the run"


def _doubt(name: str, errors: ForceErrors, own: ForceErrors, run: Run) -> str:
    said, makes = (
        ", ".join(f"{what} {error:.0%}" for what, error in zip(FORCE_MEASURES, values, strict=True))
        for values in (errors, own)
    )
    return (
        f"contact forces of {name} are off the full order's at the same step ({said}, {_covered(run)}; the step itself "
        f"makes {makes}): a higher order brings them closer"
    )
