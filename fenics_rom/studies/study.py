"""The study: the full order once, then reduced models over methods, orders and steps; what is found is kept at once."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import fenics_rom as fr
from fenics_rom.errors import FileError, SceneError, SolverError, StepError
from fenics_rom.fem.ranks import run_on_rank_0
from fenics_rom.fem.simulate import plain_rate
from fenics_rom.io.atomic_write import make_folder
from fenics_rom.io.progress import Report, silent
from fenics_rom.rom.rom import Rom
from fenics_rom.scene.scene import TOLERANCE, Scene
from fenics_rom.studies import benchmark, pareto, reference
from fenics_rom.studies.method_configs import ORDERS, WAYS, Grid, compared_instants, grid
from fenics_rom.studies.study_results import Findings, Row, read_findings, write_findings
from fenics_rom.system.system import System
from fenics_rom.trajectory.comparison import compare
from fenics_rom.trajectory.trajectory import Trajectory

FINDINGS = "study.json"
REFERENCE = "reference.h5"
POWERS = range(3, -9, -1)  # of two, times the scene's step: what is tried for a tolerance
LEFT_FOR_REDUCTION = 0.7  # share of a tolerance that the step may use up
TRIES = 3  # halvings of a step that turned out too long


def study(
    scene: Scene,
    folder: str | Path,
    *,
    methods: Sequence[str] | None = None,
    orders: Sequence[int] | None = None,
    steps: Sequence[float] | None = None,
    meshes: Sequence[str | Path] = (),
    quick: bool = False,
    resume: bool = False,
    report: Report = silent,
) -> Findings:
    """Measures what accuracy costs in a scene; every rank must call it, rank 0 runs the reduced models and writes.

    The reference is the full order at a quarter of the smallest step. Each reduced model is run at its step too, which
    leaves the error of the reduction alone, and at all steps of the grid.

    Args:
        scene: with a run in which something acts.
        folder: for study.json and reference.h5, from which an interrupted study can go on; made where it is missing.
        methods: "balanced", "selection" (the paper's eigenvectors), "modal", "modal+static", "pod", "static".
        orders: displacements of each contact mode.
        steps: s, each a whole multiple of the smallest.
        meshes: files of finer meshes of the same body: how far the scene's own is from the finest at its outputs.
        quick: a coarser grid, for a first look.
        resume: go on from what an interrupted study left in the folder.
        report: called with the stage, how much of it is done, and of how much.

    Raises:
        SceneError: nothing to benchmark, or a choice that does not exist.
        FileError: the folder cannot be written, or holds another study.
        SolverError: not one reduced model could be made.

    Example:
        >>> findings = fr.study(scene, "studied", methods=["balanced"], orders=[5], steps=[0.01])
        >>> findings.rows[0].error < 0.1
        True
    """
    reference.check_measurable(scene, [Path(file) for file in meshes])
    system = fr.assemble(scene)
    tried = _grid(system, quick=quick, methods=methods, orders=orders, steps=steps)
    findings = _Study(system, Path(folder), tried, resume, report).run([Path(file) for file in meshes])
    if not findings.rows:
        raise SolverError(f"{scene.source}: no reduced model could be measured: {'; '.join(findings.notes)}")
    return findings


def study_for(
    scene: Scene,
    folder: str | Path,
    tolerance: float,
    *,
    resume: bool = False,
    report: Report = silent,
) -> tuple[Findings, Row, Rom]:
    """Finds the longest step and the lowest order of a balanced model within a tolerance; every rank must call it.

    Args:
        scene: with a run in which something acts.
        folder: as of `study`.
        tolerance: of the whole shape, L² in time and mass.
        resume: as of `study`.
        report: as of `study`.

    Returns:
        What was measured, the row to choose, and its model.

    Raises:
        SceneError, FileError: as `study`.
        SolverError: the tolerance was not reached; the message says what was, and what stood in the way.
    """
    TOLERANCE.check(tolerance, "tolerance")
    reference.check_measurable(scene, ())
    system = fr.assemble(scene)
    step = _longest_step(system, tolerance, report)
    for _ in range(TRIES):
        tried = _grid(system, methods=[_usual(scene)], steps=[step])
        work = _Study(system, Path(folder), tried, resume, report, or_begin=True)
        findings = work.run([], enough=lambda row: row.error <= tolerance)
        row = pareto.cheapest(findings.rows, tolerance)
        if row is not None:
            return findings, row, work.model(row)
        if not findings.rows or min(row.reduction for row in findings.rows) > tolerance:
            break
        step /= 2
    raise SolverError(_why_not(findings, tolerance))


def _usual(scene: Scene) -> str:
    """The method to begin with: without inertia there are only shapes at rest to reduce to."""
    return "static" if scene.effects.inertia is None else "balanced"


def _grid(system: System, quick: bool = False, **chosen: Any) -> Grid:
    """What is tried, without steps that are too long for the run."""
    scene = system.scene
    assert scene is not None
    assert scene.run is not None
    found = grid(scene.run.dt, usual=_usual(scene), size=system.elastic_size, quick=quick, **chosen)
    short = tuple(step for step in found.steps if step <= scene.run.duration / 2)
    if not short:
        raise SceneError(f"steps: {found.steps[-1]:g} s is too long for a run of {scene.run.duration:g} s")
    return replace(found, steps=short)


class _Study:
    """A study on its way; rank 0 measures and writes, every rank knows what was found.

    Args:
        system: with the scene.
        folder: for what is found.
        tried: methods, orders and steps.
        resume: go on from what is there.
        report: told of progress.
        or_begin: where what is there is of another study, begin instead of refusing.

    Attributes:
        findings: so far.
    """

    def __init__(self, system: System, folder: Path, tried: Grid, resume: bool, report: Report, or_begin: bool = False):
        assert system.scene is not None
        assert system.scene.run is not None
        self._folder, self._grid, self._report = folder, tried, report
        self._comm = system.algebra.comm  # type: ignore[attr-defined]
        run, step = system.scene.run, tried.reference_step
        duration, shapes = compared_instants(run.duration, (*tried.steps, 2 * step, step), len(system.body.nodes))
        self._scene = replace(system.scene, run=replace(run, duration=duration, snapshots=shapes))
        self._system = replace(system, scene=self._scene)
        self._fingerprint = reference.fingerprint(self._scene, step, shapes)
        self._reference: Trajectory | None = None
        self._last: Rom | None = None
        found = run_on_rank_0(self._comm, lambda: self._taken_over(resume, or_begin))
        self.findings = found or self._begun(step)
        self._add()

    def run(self, meshes: Sequence[Path], enough: Callable[[Row], bool] = lambda row: False) -> Findings:
        """Measures what is missing; with `enough`, until a row is."""
        if meshes and not self.findings.meshes:
            self._add(meshes=reference.of_meshes(self._system, meshes, self.findings.dt, self._report))
        work = [(method, order) for order in self._grid.orders for method in self._grid.methods]
        for done, (method, order) in enumerate(work):
            self._report("reduced models", done, len(work))
            if (method, order) not in self.findings.tried:
                self._measure(method, order)
            if any(enough(row) for row in self.findings.rows):
                break
        self._report("reduced models", len(work), len(work))
        return self.findings

    def model(self, row: Row) -> Rom:
        """The model of a row; made anew where an earlier study measured it."""
        if self._last is not None and benchmark.order_of(self._last) == row.order:
            return self._last
        return benchmark.reduced(self._system, row.method, row.order)[0]

    def _taken_over(self, resume: bool, or_begin: bool) -> Findings | None:
        """What an earlier study left, and its reference; on rank 0."""
        make_folder(self._folder)
        file = self._folder / FINDINGS
        if not (resume and file.exists()):
            return None
        found = read_findings(file)
        if found.fingerprint != self._fingerprint:
            if or_begin:
                return None
            raise FileError(f"{file}: is of another scene, mesh or smallest step; start without resume")
        self._reference = fr.read_trajectory(self._folder / REFERENCE)
        return found

    def _begun(self, step: float) -> Findings:
        """Runs the reference; what is known of it."""
        assert self._scene.run is not None
        stage = "full order"
        coarse, fine = (round(self._scene.run.duration / dt) for dt in (2 * step, step))
        twice = fr.simulate(self._system, dt=2 * step, report=lambda _, k, of: self._report(stage, k, coarse + fine))
        full = fr.simulate(
            self._system, dt=step, report=lambda _, k, of: self._report(stage, coarse + k, coarse + fine)
        )
        reference.check_moves(full, self._scene.source)
        divisor = reference.divisor(self._scene)
        fr.write_trajectory(self._folder / REFERENCE, full)
        self._reference = full
        return Findings(
            name=self._scene.name,
            fingerprint=self._fingerprint,
            size=self._system.size,
            dt=self._scene.run.dt,
            duration=self._scene.run.duration,
            reference_step=step,
            reference_error=compare(twice, full)["shape"].relative / divisor,
            divisor=divisor,
            full_rate=plain_rate(self._system, self._scene.run.dt),
            notes=full.warnings,
        )

    def _measure(self, method: str, order: int) -> None:
        """Reduces to an order, and measures the model that came of it."""
        try:
            rom, seconds = benchmark.reduced(self._system, method, order)
        except (SceneError, SolverError) as error:
            self._add(notes=(*self.findings.notes, f"{WAYS[method].label}, order {order}: {error}"))
            return
        self._last = rom
        rows: tuple[Row, ...] = ()
        notes: tuple[str, ...] = ()
        if not self.findings.of(method, benchmark.order_of(rom)):  # else more was asked for than is numerically there
            rows, notes = run_on_rank_0(self._comm, lambda: self._rows(rom, seconds, method))
        hankel = self.findings.hankel
        if method == "balanced":
            hankel = {name: tuple(mode.hankel_singular_values) for name, mode in rom.contact_models.items()}
        self._add(
            rows=(*self.findings.rows, *rows),
            tried=(*self.findings.tried, (method, order)),
            hankel=hankel,
            notes=(*self.findings.notes, *notes),
        )

    def _rows(self, rom: Rom, seconds: float, method: str) -> tuple[tuple[Row, ...], tuple[str, ...]]:
        assert self._reference is not None  # on rank 0 it is there
        try:
            return benchmark.measured(rom, seconds, method, self._scene, self._reference, self._grid.steps)
        except StepError as error:
            return (), (f"{WAYS[method].label}, order {benchmark.order_of(rom)}: {error}",)

    def _add(self, **more: Any) -> None:
        """Keeps what was found, in memory and on disk."""
        self.findings = replace(self.findings, **more)
        write_findings(self._folder / FINDINGS, self.findings)


def _longest_step(system: System, tolerance: float, report: Report) -> float:
    """The longest step that leaves room for the reduction within a tolerance, found with a large reduced model."""
    scene = system.scene
    assert scene is not None
    assert scene.run is not None
    rom, _ = benchmark.reduced(system, _usual(scene), min(ORDERS[-1], system.elastic_size))
    steps = [2.0**power * scene.run.dt for power in POWERS if 2.0**power * scene.run.dt <= scene.run.duration / 2]
    duration, shapes = compared_instants(scene.run.duration, steps, len(system.body.nodes))
    compared = replace(scene, run=replace(scene.run, duration=duration, snapshots=shapes))
    weight = reference.divisor(scene)  # a run is (weight + 1) / weight times as far from the truth as from the next run

    def search() -> float:
        last, error = None, math.inf
        for done, step in enumerate(steps):
            report("time step", done, len(steps))
            run = fr.simulate(rom, scene=compared, dt=step)
            if last is not None:
                error = compare(last, run)["shape"].relative * (weight + 1) / weight
                if error <= LEFT_FOR_REDUCTION * tolerance:
                    report("time step", len(steps), len(steps))
                    return steps[done - 1]
            last = run
        raise SolverError(
            f"tolerance {tolerance:g}: not reached, as the time step alone leaves an error of {error:.1e} at "
            f"{pareto.length(steps[-2])}, the smallest that was tried"
        )

    return run_on_rank_0(system.algebra.comm, search)  # type: ignore[attr-defined]


def _why_not(findings: Findings, tolerance: float) -> str:
    best = min(findings.rows, key=lambda row: row.error, default=None)
    if best is None:
        return f"tolerance {tolerance:g}: not reached, as no model could be made: {'; '.join(findings.notes)}"
    asked = max(order for _, order in findings.tried)
    parts = {
        f"the reduction (order {best.order}"
        + (f"; {asked} was asked for, no more is numerically there)" if best.order < asked else ")"): best.reduction,
        f"the time step ({pareto.length(best.dt)})": best.time_step,
    }
    limit = max(parts, key=lambda part: parts[part])
    return (
        f"tolerance {tolerance:g}: not reached; the least error of the whole shape was {best.error:.1e}, of which "
        f"{limit} alone makes {parts[limit]:.1e}"
    )
