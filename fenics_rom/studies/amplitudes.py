"""What large deformation costs, over the size of the load: linear and nonlinear, at full order and reduced.

The reference at each load is the nonlinear full order at the scene's step; its own error is known from the run at
twice the step.
"""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

import fenics_rom as fr
from fenics_rom.errors import FenicsRomError, FenicsRomWarning, FileError, SceneError
from fenics_rom.fem.ranks import run_on_rank_0
from fenics_rom.io.overwriting import check_outputs_in
from fenics_rom.io.progress import Report, silent
from fenics_rom.mechanics.step import FINITE_STRAIN_STEPPERS
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.simulate import rate
from fenics_rom.scene.scene import Scene
from fenics_rom.studies import reference
from fenics_rom.studies.json_record import discard_record, read_earlier, write_record
from fenics_rom.studies.study_results import Record, Timed
from fenics_rom.trajectory.comparison import Difference, ForceErrors, compare, force_errors
from fenics_rom.trajectory.trajectory import Trajectory

LOAD_SHARES = (1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0)  # of the scene's loads
QUICK_LOAD_SHARES = (1 / 8, 1.0)
EFFECT = "large_deformation"
RESULTS_FILE = "amplitudes.json"
ROM_FILES = {"linear": "linear.h5", "nonlinear": "rom.h5"}
FILES = {RESULTS_FILE: "", **dict.fromkeys(ROM_FILES.values(), "rom")}  # and what ours hold


@dataclass(frozen=True)
class AmplitudeRow(Timed):
    """A model at one load."""

    share: float  # of the scene's loads
    displacement: float  # largest of any node at any instant, in the reference, m
    model: str  # "linear" or "nonlinear", "full order" or "reduced", and of the nonlinear reduced one the stepper
    order: int  # displacements
    dt: float  # s
    # of the whole shape, L² in time and mass, as a share of the reference's size; of the reference itself an estimate
    error: float
    rate: float  # steps per second
    # errors of each obstacle's force over the run, its peak and its impulse; of the reference as `error`
    forces: Mapping[str, ForceErrors] = field(default_factory=dict)


@dataclass(frozen=True)
class AmplitudeResults(Record):
    """What a study of amplitudes has measured."""

    name: str  # of the scene
    fingerprint: str  # of what it was measured for
    unknowns: int  # at full order
    offline: Mapping[str, float]  # seconds that the reductions took, by ROM
    # error of the nonlinear ROM on a run that it was not trained on; None where it was not measured
    validation: float | None
    rows: tuple[AmplitudeRow, ...] = ()  # by load, the smallest first
    notes: tuple[str, ...] = ()  # what the user should know


def study_amplitudes(
    scene: Scene,
    folder: str | Path,
    *,
    quick: bool = False,
    resume: bool = False,
    force: bool = False,
    report: Report = silent,
) -> AmplitudeResults:
    """Compares linear and large-deformation models, reduced and at full order; every rank must call it.

    Arguments and errors are those of `study`; the folder gets amplitudes.json and the ROMs.

    Raises:
        SceneError: no large_deformation, or nothing to scale.
    """
    run = reference.measurable_run(scene)
    if scene.effects.large_deformation is None:
        raise SceneError(f"{scene.source}: a study of amplitudes is of scenes that name effects.{EFFECT}")
    if not (run.loads or scene.effects.prescribed):
        raise SceneError(f"{scene.source}: has no [[run.load]] and no prescribed force whose size could be varied")
    check_outputs_in(Path(folder), FILES, FILES, inputs=scene.files, force=force)
    amplitude_study = _AmplitudeStudy(scene, Path(folder), resume, report)
    results, roms = amplitude_study.prepare()
    shares = QUICK_LOAD_SHARES if quick else LOAD_SHARES
    for done, share in enumerate(shares):
        report("loads", done, len(shares))
        if any(row.share == share for row in results.rows):
            continue
        rows, notes = amplitude_study.measure(share, roms)
        results = amplitude_study.write(
            replace(
                results,
                rows=tuple(sorted((*results.rows, *rows), key=lambda row: row.share)),
                notes=tuple(dict.fromkeys((*results.notes, *notes))),
            )
        )
    report("loads", len(shares), len(shares))
    return results


def scaled(scene: Scene, share: float) -> Scene:
    """The scene under a share of its loads: [[run.load]] and prescribed forces."""
    assert scene.run is not None
    loads = tuple(replace(load, signal=load.signal.scaled(share)) for load in scene.run.loads)
    prescribed = {name: force.scaled(share) for name, force in scene.effects.prescribed.items()}
    effects = replace(scene.effects, prescribed=prescribed)
    return replace(scene, run=replace(scene.run, loads=loads), effects=effects)


def linear(scene: Scene) -> Scene:
    """The scene without large deformation, and what its reduction says of it."""
    effects = replace(scene.effects, large_deformation=None)
    return replace(scene, effects=effects, reduction=replace(scene.reduction, method=None))


class _AmplitudeStudy:
    """What a study does; every rank calls every method."""

    def __init__(self, scene: Scene, folder: Path, resume: bool, report: Report):
        run = reference.measurable_run(scene)
        self._scene, self._folder, self._report, self._dt = scene, folder, report, run.dt
        self._fingerprint = reference.fingerprint(scene, run.dt, run.snapshots)
        self._systems = {"linear": fr.assemble(linear(scene)), "nonlinear": fr.assemble(scene)}
        self._comm = self._systems["linear"].algebra.comm  # type: ignore[attr-defined]
        self._earlier = run_on_rank_0(self._comm, lambda: self._resume_results(resume))

    def _resume_results(self, resume: bool) -> AmplitudeResults | None:
        """What an earlier study left; on rank 0."""
        file = self._folder / RESULTS_FILE
        earlier = read_earlier(file, AmplitudeResults, "a study of amplitudes", resume)
        if earlier is not None and earlier.fingerprint != self._fingerprint:
            raise FileError(f"{file}: is of another scene, mesh or step; start without resume")
        return earlier

    def prepare(self) -> tuple[AmplitudeResults, dict[str, Rom]]:
        """What is known before the first load, or was left, and the linear and the nonlinear ROM."""
        files = {name: self._folder / file for name, file in ROM_FILES.items()}
        if self._earlier is not None:  # it is written after them
            roms = run_on_rank_0(self._comm, lambda: {name: fr.read_rom(file) for name, file in files.items()})
            return self._earlier, roms
        roms = {name: fr.reduce(self._systems[name], report=self._report) for name in files}
        discard_record(self._folder / RESULTS_FILE)
        for name, file in files.items():
            fr.write_rom(file, roms[name], force=True)  # or it was refused at the beginning
        deformation = roms["nonlinear"].deformation
        results = AmplitudeResults(
            name=self._scene.name,
            fingerprint=self._fingerprint,
            unknowns=self._systems["linear"].size,
            offline={name: sum(stage.seconds for stage in rom.stages) for name, rom in roms.items()},
            validation=None if deformation is None else deformation.validation_error,
        )
        return self.write(results), roms

    def write(self, results: AmplitudeResults) -> AmplitudeResults:
        """Writes the results so far, and returns them."""
        write_record(self._folder / RESULTS_FILE, results)
        return results

    def measure(self, share: float, roms: Mapping[str, Rom]) -> tuple[list[AmplitudeRow], list[str]]:
        """All models at one load."""
        scene = scaled(self._scene, share)
        stage = f"full order, {share:g} of the load"
        coarse, full = (self._full("nonlinear", scene, dt, stage) for dt in (2 * self._dt, self._dt))
        linear_run = self._full("linear", linear(scene), self._dt, stage)
        largest_displacement = float(np.linalg.norm(full.snapshots, axis=-1).max())
        notes: list[str] = []

        def row(model: str, run: Trajectory, errors: Mapping[str, Difference], rate: float) -> AmplitudeRow:
            estimate = reference.richardson_divisor(scene) if run is full else 1.0
            error = errors["shape"].relative / estimate
            forces = {name: tuple(e / estimate for e in of) for name, of in force_errors(errors).items()}
            order = int(run.settings["order"])
            return AmplitudeRow(share, largest_displacement, model, order, self._dt, error, rate, forces)  # type: ignore[arg-type]

        def run_reduced() -> list[AmplitudeRow]:
            measured = []
            for model, name, run_scene, stepper in (
                ("linear, reduced", "linear", linear(scene), None),
                *((f"nonlinear, reduced, {s}", "nonlinear", scene, s) for s in FINITE_STRAIN_STEPPERS),
            ):
                try:
                    run = fr.simulate(roms[name], scene=run_scene, stepper=stepper)
                    steps_per_second = rate(roms[name], scene=run_scene, stepper=stepper, runs=2)
                    measured.append(row(model, run, compare(run, full), steps_per_second))
                except FenicsRomError as error:
                    notes.append(f"{model}, {share:g} of the load: {error}")
            return measured

        rows = [
            row(model, run, errors, run.steps / run.settings["seconds"])
            for model, run, errors in (
                ("nonlinear, full order", full, compare(coarse, full)),
                ("linear, full order", linear_run, compare(linear_run, full)),
            )
        ]
        with warnings.catch_warnings(action="ignore", category=FenicsRomWarning):  # the study shows what is wrong
            rows += run_on_rank_0(self._comm, run_reduced)
        return rows, notes

    def _full(self, model: str, scene: Scene, dt: float, stage: str) -> Trajectory:
        system = replace(self._systems[model], scene=scene)
        with warnings.catch_warnings(action="ignore", category=FenicsRomWarning):
            return fr.simulate(system, dt=dt, report=lambda _, done, of: self._report(f"{model} {stage}", done, of))
