"""The study: the full order once, then reduced models over methods, orders and steps; what is found is kept at once."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import fenics_rom as fr
from fenics_rom.arguments import check_flag, path_in
from fenics_rom.errors import FileError, SceneError, SolverError, StepError, check_type
from fenics_rom.fem.ranks import run_on_rank_0
from fenics_rom.fem.simulate import plain_rate
from fenics_rom.io.overwriting import check_outputs_in
from fenics_rom.io.progress import Report, silent
from fenics_rom.mechanics.environment import Run
from fenics_rom.reduction.error_model import FURTHER, is_touched
from fenics_rom.rom.rom import Rom
from fenics_rom.scene.scene import TOLERANCE, Scene
from fenics_rom.studies import benchmark, pareto, reference
from fenics_rom.studies.json_record import discard_record, read_earlier, write_record
from fenics_rom.studies.method_configs import (
    METHOD_CONFIGS,
    STUDIED_ORDERS,
    StudyGrid,
    first_method,
    make_grid,
    select_compared_instants,
)
from fenics_rom.studies.study_results import BenchmarkRow, StudyResults
from fenics_rom.system.system import System
from fenics_rom.trajectory.comparison import ForceErrors, compare, force_errors
from fenics_rom.trajectory.trajectory import Trajectory

RESULTS_FILE = "study.json"
REFERENCE_FILE = "reference.h5"
FILES = {RESULTS_FILE: "", REFERENCE_FILE: "run"}  # and what ours hold
LARGER = "modal+static"  # method of the model that others are compared with where full order is not run
STEP_EXPONENTS = range(3, -9, -1)  # of two, times the scene's step: what is tried for a tolerance
TIME_STEP_ERROR_SHARE = 0.7  # share of a tolerance that the step may use up
MAX_STEP_HALVINGS = 3  # halvings of a step that turned out too long


def study(
    scene: Scene,
    folder: str | Path,
    *,
    methods: Sequence[str] | None = None,
    orders: Sequence[int] | None = None,
    steps: Sequence[float] | None = None,
    meshes: Sequence[str | Path] = (),
    quick: bool = False,
    without_reference: bool = False,
    resume: bool = False,
    force: bool = False,
    report: Report = silent,
) -> StudyResults:
    """Measures what accuracy costs in a scene; every rank must call it, rank 0 runs the reduced models and writes.

    The reference is the full order at a quarter of the smallest step. Each reduced model is run at its step too, which
    leaves the error of the reduction alone, and at all steps of the grid. Without a reference the full order is not
    run: errors are estimates that the reduced runs state of themselves, or among obstacles distances from the run of a
    larger model, and nothing is said of its speed.

    Args:
        scene: with a run in which something acts.
        folder: for study.json and reference.h5, from which an interrupted study can go on; made where it is missing.
        methods: "balanced", "selection" (the paper's eigenvectors), "modal", "modal+static", "pod", "static".
        orders: displacements of each contact mode.
        steps: s, each a whole multiple of the smallest.
        meshes: files of finer meshes of the same body: how far the scene's own is from the finest at its outputs.
        quick: a first look: a coarser grid and reference, one reduction for each method, the beginning of a long run.
        without_reference: do not run the full order; of bodies whose runs state their errors, and without `meshes`.
        resume: go on from what an interrupted study left in the folder.
        force: whether files of other kinds in the folder are written over.
        report: called with the stage, how much of it is done, and of how much.

    Raises:
        SceneError: nothing to benchmark, a choice that does not exist, or no reference where errors are not stated.
        FileError: the folder cannot be written, holds another study, or a file there is read for this, or of another
            kind.
        SolverError: not one reduced model could be made.

    Example:
        >>> results = fr.study(scene, "studied", methods=["balanced"], orders=[5], steps=[0.01])
        >>> results.rows[0].error < 0.1
        True
    """
    check_type("study", scene, Scene, "fr.read_scene(file)")
    finer = [path_in("meshes", file) for file in (meshes if isinstance(meshes, list | tuple) else [meshes])]
    folder = path_in("study", folder)
    run = reference.measurable_run(scene, finer)
    check_flag("without_reference", without_reference, SceneError)
    if finer and without_reference:
        raise SceneError("meshes: are compared at full order, which is not run without_reference; give one of them")
    check_outputs_in(Path(folder), FILES, FILES, inputs=[*scene.files, *finer], force=force)
    system = fr.assemble(scene)
    if without_reference:
        reference.check_dispensable(system)
    grid = make_grid(scene, run, system.elastic_size, quick=quick, methods=methods, orders=orders, steps=steps)
    results = _StudyRun(scene, system, Path(folder), grid, resume, report, without_reference).run(finer)
    if not results.rows:
        raise SolverError(f"{scene.source}: no reduced model could be measured: {'; '.join(results.notes)}")
    return results


def study_for_tolerance(
    scene: Scene,
    folder: str | Path,
    tolerance: float,
    *,
    without_reference: bool = False,
    resume: bool = False,
    force: bool = False,
    report: Report = silent,
) -> tuple[StudyResults, BenchmarkRow, Rom]:
    """Finds the longest step and the lowest order of a balanced model within a tolerance of the whole shape.

    Arguments and errors are those of `study`, and SolverError where the tolerance was not reached.

    Returns:
        What was measured, the row to choose, and its model.
    """
    TOLERANCE.check(tolerance, "tolerance")
    run = reference.measurable_run(scene)
    check_outputs_in(Path(folder), FILES, FILES, inputs=scene.files, force=force)
    system = fr.assemble(scene)
    if without_reference:
        reference.check_dispensable(system)
    step = _longest_step(scene, run, system, tolerance, report)
    for _ in range(MAX_STEP_HALVINGS):
        grid = make_grid(scene, run, system.elastic_size, methods=[first_method(scene)], steps=[step])
        attempt = _StudyRun(scene, system, Path(folder), grid, resume, report, without_reference, begin_if_other=True)
        results = attempt.run([], enough=lambda row: row.error <= tolerance)
        row = pareto.select_cheapest(results.rows, tolerance)
        if row is not None:
            return results, row, attempt.model(row)
        if not results.rows or min(row.reduction for row in results.rows) > tolerance:
            break
        step /= 2
    raise SolverError(_explain_failure(results, tolerance))


class _StudyRun:
    """A study on its way; rank 0 measures and writes, every rank knows the results so far.

    With `begin_if_other`, where what is there is of another study, it begins instead of refusing. With `alone` full
    order is not run.
    """

    def __init__(
        self,
        scene: Scene,
        system: System,
        folder: Path,
        grid: StudyGrid,
        resume: bool,
        report: Report,
        alone: bool = False,
        begin_if_other: bool = False,
    ):
        self._folder, self._grid, self._report, self._alone = folder, grid, report, alone
        self._states_errors = alone and not is_touched(system)
        self._comm = system.algebra.comm  # type: ignore[attr-defined]
        run, step = reference.measurable_run(scene), grid.reference_step
        part = run.duration if alone else grid.duration(run.duration, system.size)
        duration, shapes = select_compared_instants(part, (*grid.steps, 2 * step, step), len(system.body.nodes))
        loads = tuple(load for load in run.loads if load.start < duration - grid.steps[0])
        self._run = replace(run, duration=duration, snapshots=shapes, loads=loads)
        self._whole, self._is_cut = run.duration, part < run.duration
        self._scene = replace(scene, run=self._run)
        self._system = replace(system, scene=self._scene)
        self._fingerprint = reference.fingerprint(self._scene, step, shapes, alone)
        self._reference: Trajectory | None = None
        self._last: Rom | None = None
        self._largest: dict[str, tuple[Rom, float]] = {}  # of methods, and the seconds of its reduction
        earlier = run_on_rank_0(self._comm, lambda: self._resume_results(resume, begin_if_other))
        self.results = earlier or (self._run_steps if alone else self._run_reference)(step)
        self._add()

    def run(self, meshes: Sequence[Path], enough: Callable[[BenchmarkRow], bool] = lambda row: False) -> StudyResults:
        """Measures what is missing; with `enough`, until a row is."""
        if meshes and not self.results.meshes:
            self._add(meshes=reference.compare_meshes(self._system, meshes, self.results.dt, self._report))
        models = [(method, order) for order in self._grid.orders for method in self._grid.methods]
        for done, (method, order) in enumerate(models):
            alive = self._alive(done, len(models))
            alive("", 0, 0)
            if (method, order) not in self.results.tried:
                self._measure(method, order, alive)
            if any(enough(row) for row in self.results.rows):
                break
        self._report("reduced models", len(models), len(models))
        return self.results

    def _alive(self, done: int, of: int) -> Report:
        """A report that says how many models are done, whatever one is doing."""
        return lambda stage, k, n: self._report("reduced models", done, of)

    def model(self, row: BenchmarkRow) -> Rom:
        """The model of a row; made anew where an earlier study measured it."""
        if self._last is not None and benchmark.largest_order(self._last) == row.order:
            return self._last
        frame, rigid = self._system.moving_frame, self._system.rigid.shape[1]
        order = row.order - (rigid if frame is None else 0)
        return benchmark.reduce_timed(self._system, row.method, order, errors=self._states_errors or None)[0]

    def _resume_results(self, resume: bool, begin_if_other: bool) -> StudyResults | None:
        """What an earlier study left, and its reference; on rank 0."""
        file = self._folder / RESULTS_FILE
        earlier = read_earlier(file, StudyResults, "a study", resume)
        if earlier is None:
            return None
        if earlier.fingerprint != self._fingerprint:
            if begin_if_other:
                return None
            differs = "is of another scene, mesh, smallest step or length"
            if earlier.without_reference != self._alone:
                differs = f"has {'no' if earlier.without_reference else 'a'} reference, other than this"
            raise FileError(f"{file}: {differs}; start without resume")
        if not self._states_errors:
            self._reference = fr.read_trajectory(self._folder / REFERENCE_FILE)
        return earlier

    def _run_reference(self, step: float) -> StudyResults:
        """Runs the reference; what is known of it."""
        stage = "full order"
        coarse, fine = (round(self._run.duration / dt) for dt in (2 * step, step))
        total = coarse + fine
        coarse_run = fr.simulate(self._system, dt=2 * step, report=lambda _, k, of: self._report(stage, k, total))
        full = fr.simulate(self._system, dt=step, report=lambda _, k, of: self._report(stage, coarse + k, total))
        touches = self._scene.effects.contact is not None  # then steps cost what happens in them
        of_run = coarse / coarse_run.settings["seconds"]
        return self._first_results(
            coarse_run,
            full,
            full_rate=of_run if touches else plain_rate(self._system, self._run.dt),
            full_step=2 * step if touches else None,
        )

    def _run_steps(self, step: float) -> StudyResults:
        """What is known without a reference: what its step would do, by the largest model of the first method.

        Runs under the contact forces that they found do not tell what these are wrong by. So among obstacles they are
        compared with that of a larger model, which finds its own.
        """
        if self._states_errors:
            rom, _ = self._reduce(self._grid.methods[0], self._grid.orders[-1], silent)
        else:
            most = min(2 * self._grid.orders[-1] + FURTHER, self._system.elastic_size)
            rom, _ = benchmark.reduce_timed(self._system, LARGER, most)
        of_run: dict[str, Any] = {"scene": self._scene, "errors": False}

        def runs() -> tuple[Trajectory, Trajectory]:
            coarse, fine = (
                fr.simulate(rom, dt=dt, **of_run, report=lambda _, k, of: self._report("time step", k, of))
                for dt in (2 * step, step)
            )
            return coarse, fine

        compared = None if self._states_errors else benchmark.largest_order(rom)
        return self._first_results(*run_on_rank_0(self._comm, runs), full_rate=None, compared_with=compared)

    def _first_results(self, coarse: Trajectory, run: Trajectory, **known: Any) -> StudyResults:
        """What is known before any model, of a run at the reference's step and one at twice that."""
        self._check_moves(run)
        discard_record(self._folder / RESULTS_FILE)
        own, divisor = compare(coarse, run), reference.richardson_divisor(self._scene)
        forces: dict[str, ForceErrors] = {}
        if not self._states_errors:
            fr.write_trajectory(self._folder / REFERENCE_FILE, run, force=True)  # or it was refused at the beginning
            self._reference = run
            forces = {
                name: tuple(error / divisor for error in errors)  # type: ignore[misc]
                for name, errors in force_errors(own).items()
            }
        return StudyResults(
            name=self._scene.name,
            fingerprint=self._fingerprint,
            size=self._system.size,
            dt=self._run.dt,
            duration=self._run.duration,
            reference_step=self._grid.reference_step,
            reference_error=own["shape"].relative / divisor,
            divisor=divisor,
            rate_runs=self._grid.rate_runs,
            reference_forces=forces,
            notes=(*run.warnings, *self._settings(run)),
            **known,
        )

    def _check_moves(self, run: Trajectory) -> None:
        if not run.snapshots.any():
            part = f"the first {self._run.duration:g} s of " if self._is_cut else ""
            raise SceneError(f"{self._scene.source}: nothing moves in {part}its run, so there is nothing to measure")

    def _settings(self, full: Trajectory) -> list[str]:
        """What was done otherwise than in a whole study, and what the run lacks."""
        said = []
        if self._grid.quick:
            part = f", of the {self._whole:g} s of the run the first {self._run.duration:g} s"
            once = "" if self._alone else "each method was reduced once, to its largest order, "
            said.append(f"a first look: {once}rates are of one run" + (part if self._is_cut else ""))
        if full.forces and not any(force.any() for force in full.forces.values()):
            said.append("no obstacle is touched in this run")
        return said

    def _reduce(self, method: str, order: int, report: Report) -> tuple[Rom, float]:
        """The model and the seconds that its reduction took; of a quick study a truncation of the largest.

        Not where they state their errors: truncations do not.
        """
        largest, errors = self._grid.orders[-1], self._states_errors or None
        truncates = self._grid.quick and not self._states_errors
        if not truncates and order < largest:
            return benchmark.reduce_timed(self._system, method, order, report, errors=errors)
        if method not in self._largest:
            self._largest[method] = benchmark.reduce_timed(self._system, method, largest, report, errors=errors)
        rom, seconds = self._largest[method]
        return (fr.truncate(rom, order) if order < benchmark.largest_order(rom) - rom.rigid else rom), seconds

    def _measure(self, method: str, order: int, report: Report) -> None:
        """Reduces to an order, and measures the model that came of it."""
        label = METHOD_CONFIGS[method].label
        try:
            rom, seconds = self._reduce(method, order, report)
        except (SceneError, SolverError) as error:
            self._add(notes=(*self.results.notes, f"{label}, order {order}: {error}"))
            return
        self._last, largest = rom, benchmark.largest_order(rom)
        rows: tuple[BenchmarkRow, ...] = ()
        notes: tuple[str, ...] = ()

        def measure() -> tuple[tuple[BenchmarkRow, ...], tuple[str, ...]]:
            assert self._states_errors or self._reference is not None  # on rank 0 it is there
            return benchmark.measure_model(rom, seconds, method, self._scene, self._reference, self._grid, report)

        if not self.results.of(method, largest):  # else more was asked for than is numerically there
            try:
                rows, notes = run_on_rank_0(self._comm, measure)
            except StepError as error:
                notes = (f"{label}, order {largest}: {error}",)
        hankel = self.results.hankel
        if method == "balanced":
            hankel = {name: tuple(mode.hankel_singular_values) for name, mode in rom.contact_models.items()}
        self._add(
            rows=(*self.results.rows, *rows),
            tried=(*self.results.tried, (method, order)),
            hankel=hankel,
            notes=(*self.results.notes, *notes),
        )

    def _add(self, **changes: Any) -> None:
        """Keeps what was found, in memory and on disk."""
        self.results = replace(self.results, **changes)
        write_record(self._folder / RESULTS_FILE, self.results)


def _longest_step(scene: Scene, run: Run, system: System, tolerance: float, report: Report) -> float:
    """The longest step that leaves room for the reduction within a tolerance, found with a large reduced model."""
    rom, _ = benchmark.reduce_timed(system, first_method(scene), min(STUDIED_ORDERS[-1], system.elastic_size))
    steps = [step for step in (2.0**power * run.dt for power in STEP_EXPONENTS) if step <= run.duration / 2]
    duration, shapes = select_compared_instants(run.duration, steps, len(system.body.nodes))
    compared = replace(scene, run=replace(run, duration=duration, snapshots=shapes))
    weight = reference.richardson_divisor(scene)  # a run is (weight + 1) / weight times as far off as from the next

    def search() -> float:
        last, error = None, math.inf
        for done, step in enumerate(steps):
            report("time step", done, len(steps))
            trajectory = fr.simulate(rom, scene=compared, dt=step)
            if last is not None:
                error = compare(last, trajectory)["shape"].relative * (weight + 1) / weight
                if error <= TIME_STEP_ERROR_SHARE * tolerance:
                    report("time step", len(steps), len(steps))
                    return steps[done - 1]
            last = trajectory
        raise SolverError(
            f"tolerance {tolerance:g}: not reached, as the time step alone leaves an error of {error:.1e} at "
            f"{pareto.format_step(steps[-2])}, the smallest that was tried"
        )

    return run_on_rank_0(system.algebra.comm, search)  # type: ignore[attr-defined]


def _explain_failure(results: StudyResults, tolerance: float) -> str:
    best = min(results.rows, key=lambda row: row.error, default=None)
    if best is None:
        return f"tolerance {tolerance:g}: not reached, as no model could be made: {'; '.join(results.notes)}"
    asked = max(order for _, order in results.tried)
    parts = {
        f"the reduction (order {best.order}"
        + (f"; {asked} was asked for, no more is numerically there)" if best.order < asked else ")"): best.reduction,
        f"the time step ({pareto.format_step(best.dt)})": best.time_step,
    }
    limit = max(parts, key=lambda part: parts[part])
    return (
        f"tolerance {tolerance:g}: not reached; the least error of the whole shape was {best.error:.1e}, of which "
        f"{limit} alone makes {parts[limit]:.1e}"
    )
