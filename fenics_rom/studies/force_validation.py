"""How far the contact forces of a reduced model are off, in as much of its scene's run as is affordable."""

import time
import warnings
from dataclasses import replace

import numpy as np

import fenics_rom as fr
from fenics_rom.errors import FenicsRomError, FenicsRomWarning
from fenics_rom.fem.ranks import run_on_rank_0
from fenics_rom.io.progress import Report, silent
from fenics_rom.io.stages import Stage, peak_memory
from fenics_rom.mechanics.environment import Run
from fenics_rom.rom.rom import ForceValidation, Rom
from fenics_rom.scene.scene import Scene
from fenics_rom.system.system import System
from fenics_rom.trajectory.comparison import FORCE_MEASURES, ForceErrors, compare, force_errors
from fenics_rom.trajectory.trajectory import Trajectory

WORK = 2e6  # full-order steps times (unknowns + OVERHEAD): five to ten seconds of one core
OVERHEAD = 2000  # unknowns that a step costs even of the smallest body
WARNING_ERROR = 0.1  # of a contact force, beyond which the user is told


def validate_forces(system: System, rom: Rom, *, report: Report = silent) -> Rom:
    """Measures how far contact forces are off: the beginning of the scene's run, reduced and at full order.

    Both take the scene's time step, so what the step does is not in that; it is told apart, by the reduced model at
    half of it. So many steps are taken from rest as some seconds pay for, whatever the size: 330 of 4,000 unknowns, 20
    of 100,000. `fenics-rom reduce` calls it; every rank must.

    Args:
        system: the full-order model.
        rom: reduced from it.
        report: called with the stage, how much of it is done, and of how much.

    Returns:
        The ROM with `force_validation`, and a stage that says what that cost; the same ROM where the scene has no
        obstacles or no run, or deforms largely. Where forces are off by more than a tenth, it warns.

    Example:
        >>> fr.validate_forces(system, rom).force_validation is None  # nothing here is touched
        True
    """
    scene = system.scene
    if scene is None or scene.run is None or not scene.environment.obstacles or system.deformation is not None:
        return rom
    start = time.perf_counter()
    run = _beginning(scene.run, system.size)
    validation: ForceValidation | None = None
    try:
        validation, messages = _validation(system, rom, replace(scene, run=run), run, report)
    except FenicsRomError as error:
        messages = [f"contact forces were not validated: {error}"]
    for message in messages:
        warnings.warn(message, FenicsRomWarning, stacklevel=2)
    stage = Stage("validation of contact forces", time.perf_counter() - start, peak_memory())
    return replace(rom, force_validation=validation, stages=(*rom.stages, stage), warnings=(*rom.warnings, *messages))


def _beginning(run: Run, size: int) -> Run:
    """As many of its steps as WORK pays for."""
    duration = min(run.duration, max(int(WORK / (size + OVERHEAD)), 1) * run.dt)
    return replace(
        run, duration=duration, snapshots=1, loads=tuple(a for a in run.loads if a.start < duration - run.dt)
    )


def _validation(system: System, rom: Rom, scene: Scene, run: Run, report: Report) -> tuple[ForceValidation, list[str]]:
    comm = system.algebra.comm  # type: ignore[attr-defined]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FenicsRomWarning)  # whoever runs it is told

        def reduced(dt: float) -> Trajectory:
            return run_on_rank_0(comm, lambda: fr.simulate(rom, scene=scene, dt=dt))

        at_step = reduced(run.dt)
        touched = any(force.any() for force in at_step.forces.values())
        if not touched:
            return ForceValidation(run.dt, run.duration, {}, {}), []
        full = fr.simulate(replace(system, scene=scene), report=lambda _, k, of: report("contact forces", k, of))
        reduction = force_errors(compare(at_step, full))
        time_step = force_errors(compare(at_step, reduced(run.dt / 2)))
    known = [name for name in reduction if np.isfinite([*reduction[name], *time_step[name]]).all()]
    messages = [
        f"{name} touches the body in the reduced model alone, in the first {run.duration:g} s of the run"
        for name in reduction
        if name not in known
    ]
    messages += [_doubt(name, reduction[name], run) for name in known if max(reduction[name]) > WARNING_ERROR]
    by_name = ({name: errors[name] for name in known} for errors in (reduction, time_step))
    return ForceValidation(run.dt, run.duration, *by_name), messages


def _doubt(name: str, errors: ForceErrors, run: Run) -> str:
    said = ", ".join(f"{what} {error:.0%}" for what, error in zip(FORCE_MEASURES, errors, strict=True))
    return (
        f"contact forces of {name} are off the full order's at the same step ({said}, in the first {run.duration:g} s "
        "of the run): a higher order brings them closer"
    )
