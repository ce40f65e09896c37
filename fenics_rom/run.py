"""A run of whatever can be run: a scene or a system at full order, or a ROM; the same call, the same trajectory."""

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fenics_rom.arguments import check_flag
from fenics_rom.errors import SceneError, shown
from fenics_rom.io.progress import Report, silent
from fenics_rom.lazy_import import load
from fenics_rom.rom.rom import Rom
from fenics_rom.scene.scene import Scene
from fenics_rom.scene.world_format import WorldScene
from fenics_rom.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from fenics_rom.mechanics.active_environment import SignalLike
    from fenics_rom.runtime.exceedings import Enriches
    from fenics_rom.system.system import System


def simulate(
    model: "Scene | WorldScene | System | Rom | str | PathLike[str]",
    *,
    scene: Scene | None = None,
    dt: float | None = None,
    every: int | None = None,
    signals: "Mapping[str, SignalLike] | None" = None,
    profile: bool = False,
    rate: bool = False,
    stepper: str | None = None,
    step_error: float | None = None,
    errors: bool | None = None,
    error_tolerance: float | None = None,
    enrich: "System | Enriches | None" = None,
    finer: Rom | None = None,
    arc_length: bool = False,
    report: Report = silent,
) -> Trajectory:
    """Runs a model through a load history from rest.

    A scene, or the system assembled from it, is run at full order, which every MPI rank must call; a ROM is run
    reduced, and a world with its ROMs. `scene`, `profile`, `rate`, `stepper`, `step_error`, `errors`,
    `error_tolerance`, `enrich` and `finer` are for ROMs; a world has `rate`, too; `arc_length` is for full order.

    Args:
        model: what to run, or the name of the file of a scene, a world or a ROM.
        scene: whose run, effects and outputs' names to take instead of those of the scene in the ROM.
        dt: time step instead of the scene's, s.
        every: outputs, forces and account are kept after every so many steps, and at the end, instead of the scene's.
        signals: of loads and obstacles by name, instead of the scene's: numbers, or functions of time; as in
            Simulator.
        profile: whether to run it once more to measure what each effect costs in a step.
        rate: whether to run it once more to measure the wall clock of its steps, `settings["seconds"]`; a run at
            full order always measures it.
        stepper: of a body with large deformation, as in Simulator.
        step_error: which error its steps may have, as a share of the largest displacement: the stepper is chosen that
            costs least of those that have it, as runs with whole and half steps measure; where none has, it is told
            which dt would do.
        errors: whether the run is to state its own error, a bound and an estimate; None: if the ROM was made for that.
        error_tolerance: what the estimate of any output's error is to be no larger than, m, as in Simulator; the first
            time that it is, a ToleranceWarning says so at once, and `tolerance` of the run keeps it.
        enrich: the system that the ROM was reduced of: where the tolerance is exceeded, directions are added to the
            basis, and the run goes on without a jump; or an Enrichment, whose `rom` has them afterwards.
        finer: a ROM of higher order of the same scene, which takes the same steps beside: for bodies that do not state
            errors of themselves the difference of outputs and readings is an estimate.
        arc_length: whether loads are to grow and shrink along the equilibrium path of a body that deforms largely and
            has no inertia, on beyond its limit points: from nothing to what the run has at its end, in as many steps as
            the run has, or fewer, the first with about an equal share. Beside them there is what always acts; `inputs`
            tells how much there was of each, and `warnings` of limit points.
        report: called with the stage, how much of it is done, and of how much.

    Raises:
        SceneError: there is no load history, or it does not fit the model; or an option that the model has not.
        MeshError, SolverError: as `assemble`.
        StepError: a step could not be taken.
        MissingPackageError: a run at full order without FEniCSx.

    Example:
        >>> full, reduced = fr.simulate(system, dt=0.01), fr.simulate(rom, dt=0.01)
        >>> fr.compare(reduced, full)["shape"].relative < 1e-3
        True
    """
    check_flag("arc_length", arc_length, SceneError)
    if isinstance(model, str | PathLike):
        reader = ("rom.file", "read_rom") if is_rom_file(model) else ("scene.file", "read_scene")
        if reader[1] == "read_scene" and is_world_file(model):
            reader = ("scene.world_file", "read_world")
        model = load(*reader)(model)
    if isinstance(model, WorldScene):
        refused: dict[str, Any] = {"scene": scene, "signals": signals, "profile": profile, "stepper": stepper}
        told: dict[str, Any] = {"step_error": step_error, "errors": errors, "error_tolerance": error_tolerance}
        refused |= told | {"enrich": enrich, "finer": finer, "arc_length": arc_length}
        given = [name for name, value in refused.items() if value]
        if given:
            raise SceneError(f"simulate: {', '.join(given)} cannot be used with a WorldScene")
        from fenics_rom.world_run import run_world

        return run_world(model, dt, every, rate, report)
    of_any: dict[str, Any] = {"dt": dt, "every": every, "signals": signals, "report": report}
    of_roms: dict[str, Any] = {"scene": scene, "profile": profile, "rate": rate}
    of_roms |= {"stepper": stepper, "step_error": step_error, "errors": errors, "error_tolerance": error_tolerance}
    of_roms |= {"enrich": enrich, "finer": finer}
    if isinstance(model, Rom):
        if arc_length:
            raise SceneError("simulate: arc_length cannot be used with a Rom; use it with a Scene or a System")
        from fenics_rom.runtime.simulate import simulate as simulate_rom

        del of_roms["enrich"]
        adding: Any = (
            load("reduction.enrichment", "Enrichment")(model, enrich) if hasattr(enrich, "stiffness") else enrich
        )
        return simulate_rom(model if adding is None else adding.rom, **of_roms, enrichment=adding, **of_any)
    if not (isinstance(model, Scene) or hasattr(model, "stiffness")):
        raise SceneError(
            f"simulate: {shown(model)} was given; use a Scene, a WorldScene, a System, a Rom, or a file's name"
        )
    given = [name for name, value in of_roms.items() if value is not None and value is not False]
    if given:
        raise SceneError(
            f"simulate: {', '.join(given)} cannot be used with a {type(model).__name__}, which is run at full order; "
            "use it with a Rom"
        )
    trajectory: Trajectory = load("fem.simulate", "simulate")(model, arc_length=arc_length, **of_any)
    return trajectory


def is_rom_file(file: str | PathLike[str]) -> bool:
    """Whether a file is to be read as a ROM: it is one, or is called as if; what so ends, and is none, is told so."""
    from fenics_rom.io.hdf5 import is_sealed  # here, as not everyone reads files

    return is_sealed(Path(file)) or Path(file).suffix in (".h5", ".hdf5")


def is_world_file(file: str | PathLike[str]) -> bool:
    """Whether a file is a world's: TOML with bodies."""
    import tomllib  # here, as not everyone reads files

    try:
        with Path(file).open("rb") as stream:
            return "bodies" in tomllib.load(stream)
    except (OSError, ValueError, RecursionError):
        return False
