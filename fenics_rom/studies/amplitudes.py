"""What large deformation costs, over the size of the load: linear and nonlinear, at full order and reduced.

The reference at each load is the nonlinear full order at the scene's step; its own error is known from the run at
twice the step.
"""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import fenics_rom as fr
from fenics_rom.errors import FenicsRomError, FenicsRomWarning, FileError, SceneError
from fenics_rom.fem.ranks import run_on_rank_0
from fenics_rom.io.atomic_write import make_folder
from fenics_rom.io.json_record import read_record, write_record
from fenics_rom.io.markdown import markdown
from fenics_rom.io.progress import Report, silent
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.simulate import rate
from fenics_rom.scene.scene import STEPPERS, Scene
from fenics_rom.studies import reference
from fenics_rom.trajectory.comparison import compare
from fenics_rom.trajectory.trajectory import Trajectory

SHARES = (1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0)  # of the scene's loads
QUICK = (1 / 8, 1.0)
EFFECT = "large_deformation"
FOUND = "amplitudes.json"
ROMS = {"linear": "linear.h5", "nonlinear": "rom.h5"}
HEADING = ("load", "largest displacement", "model", "step", "error", "steps per second", "times real time")


@dataclass(frozen=True)
class Row:
    """A model at one load.

    Attributes:
        share: of the scene's loads.
        displacement: largest of any node at any instant, in the reference, m.
        model: "linear" or "nonlinear", "full order" or "reduced", and of the nonlinear reduced one the stepper.
        order: displacements.
        dt: s.
        error: of the whole shape, L² in time and mass, as a share of the reference's size; of the reference itself an
            estimate.
        rate: steps per second.
    """

    share: float
    displacement: float
    model: str
    order: int
    dt: float
    error: float
    rate: float

    @property
    def real_time(self) -> float:
        """Seconds simulated in a second."""
        return self.rate * self.dt


@dataclass(frozen=True)
class Amplitudes:
    """What was found.

    Attributes:
        name: of the scene.
        fingerprint: of what it was found for.
        unknowns: at full order.
        offline: seconds that the reductions took, by ROM.
        validation: error of the nonlinear ROM on a run that it was not trained on; None where it was not measured.
        rows: by load, the smallest first.
        notes: what the user should know.
    """

    name: str
    fingerprint: str
    unknowns: int
    offline: Mapping[str, float]
    validation: float | None
    rows: tuple[Row, ...] = ()
    notes: tuple[str, ...] = ()


def study_of_amplitudes(
    scene: Scene,
    folder: str | Path,
    *,
    quick: bool = False,
    resume: bool = False,
    report: Report = silent,
) -> Amplitudes:
    """Compares linear and large-deformation models, reduced and at full order; every rank must call it.

    Args:
        scene: with large_deformation and a run in which loads act.
        folder: for amplitudes.json and the ROMs, from which an interrupted study can go on; made where it is missing.
        quick: fewer loads.
        resume: go on from what an interrupted study left in the folder.
        report: called with the stage, how much of it is done, and of how much.

    Raises:
        SceneError: no large_deformation, or nothing to scale.
        FileError: the folder cannot be written, or holds another study.
        SolverError: as `simulate` and `reduce`.
    """
    reference.check_measurable(scene, ())
    if scene.effects.large_deformation is None:
        raise SceneError(f"{scene.source}: a study of amplitudes is of scenes that name effects.{EFFECT}")
    if scene.run is not None and not (scene.run.loads or scene.effects.prescribed):
        raise SceneError(f"{scene.source}: has no [[run.load]] and no prescribed force whose size could be varied")
    work = _Work(scene, Path(folder), resume, report)
    found, roms = work.begun()
    shares = QUICK if quick else SHARES
    for done, share in enumerate(shares):
        report("loads", done, len(shares))
        if any(row.share == share for row in found.rows):
            continue
        rows, notes = work.at(share, roms)
        found = work.kept(
            replace(
                found,
                rows=tuple(sorted((*found.rows, *rows), key=lambda row: row.share)),
                notes=tuple(dict.fromkeys((*found.notes, *notes))),
            )
        )
    report("loads", len(shares), len(shares))
    return found


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


def report_of(found: Amplitudes, command: str) -> str:
    """The study as Markdown."""
    offline = ", ".join(f"{name} {seconds:.0f} s" for name, seconds in found.offline.items())
    validation = "was not measured" if found.validation is None else f"is {found.validation:.1e}"
    return "\n\n".join(
        [
            f"# What large deformation costs: {found.name}",
            f"Made by `{command}`.",
            f"{found.unknowns:,} unknowns; reductions: {offline}. The error of the nonlinear ROM on a run that it was "
            f"not trained on {validation}. Errors are of the whole shape over the run, in the mass norm, against the "
            "nonlinear full order, whose own error is estimated from twice its step.",
            markdown(HEADING, cells(found)),
            *(f"- {note}" for note in found.notes),
        ]
    )


def cells(found: Amplitudes) -> list[tuple[str, ...]]:
    """The rows of the table, for people."""
    return [
        (
            f"{row.share:.3g}",
            f"{1e3 * row.displacement:.3g} mm",
            f"{row.model}, order {row.order:,}" if "reduced" in row.model else row.model,
            f"{1e3 * row.dt:.3g} ms",
            f"{row.error:.1e}",
            f"{row.rate:,.0f}" if row.rate >= 10 else f"{row.rate:.1f}",
            f"{row.real_time:.3g}",
        )
        for row in found.rows
    ]


class _Work:
    """What a study does; every rank calls every method."""

    def __init__(self, scene: Scene, folder: Path, resume: bool, report: Report):
        assert scene.run is not None
        self._scene, self._folder, self._report, self._dt = scene, folder, report, scene.run.dt
        self._fingerprint = reference.fingerprint(scene, self._dt, scene.run.snapshots)
        self._systems = {"linear": fr.assemble(linear(scene)), "nonlinear": fr.assemble(scene)}
        self._comm = self._systems["linear"].algebra.comm  # type: ignore[attr-defined]
        self._left = run_on_rank_0(self._comm, lambda: self._taken_over(resume))

    def _taken_over(self, resume: bool) -> Amplitudes | None:
        """What an earlier study left; on rank 0."""
        make_folder(self._folder)
        file = self._folder / FOUND
        if not (resume and file.exists()):
            return None
        found = read_amplitudes(file)
        if found.fingerprint != self._fingerprint:
            raise FileError(f"{file}: is of another scene, mesh or step; start without resume")
        return found

    def begun(self) -> tuple[Amplitudes, dict[str, Rom]]:
        """What is known before the first load, or was left, and the linear and the nonlinear ROM."""
        files = {name: self._folder / file for name, file in ROMS.items()}
        if self._left is not None:  # it is written after them
            return self._left, {name: self._read(file) for name, file in files.items()}
        roms = {name: fr.reduce(self._systems[name], report=self._report) for name in files}
        for name, file in files.items():
            fr.write_rom(file, roms[name])
        deformation = roms["nonlinear"].deformation
        found = Amplitudes(
            name=self._scene.name,
            fingerprint=self._fingerprint,
            unknowns=self._systems["linear"].size,
            offline={name: sum(stage.seconds for stage in rom.stages) for name, rom in roms.items()},
            validation=None if deformation is None else deformation.validation_error,
        )
        return self.kept(found), roms

    def _read(self, file: Path) -> Rom:
        return run_on_rank_0(self._comm, lambda: fr.read_rom(file))

    def kept(self, found: Amplitudes) -> Amplitudes:
        """Writes what was found so far, and returns it."""
        write_record(self._folder / FOUND, found)
        return found

    def at(self, share: float, roms: Mapping[str, Rom]) -> tuple[list[Row], list[str]]:
        """All models at one load."""
        scene = scaled(self._scene, share)
        stage = f"full order, {share:g} of the load"
        twice, full = (self._full("nonlinear", scene, dt, stage) for dt in (2 * self._dt, self._dt))
        moved = float(np.linalg.norm(full.snapshots, axis=-1).max())
        straight = self._full("linear", linear(scene), self._dt, stage)
        own = compare(twice, full)["shape"].relative / reference.divisor(scene)

        def row(model: str, run: Trajectory, speed: float, error: float) -> Row:
            return Row(share, moved, model, int(run.settings["order"]), self._dt, error, speed)

        def off(run: Trajectory) -> float:
            return compare(run, full)["shape"].relative

        rows = [row("nonlinear, full order", full, _speed(full), own)]
        rows.append(row("linear, full order", straight, _speed(straight), off(straight)))
        notes: list[str] = []

        def reduced() -> list[Row]:
            found = []
            for model, rom, asked, stepper in (
                ("linear, reduced", roms["linear"], linear(scene), None),
                *((f"nonlinear, reduced, {stepper}", roms["nonlinear"], scene, stepper) for stepper in STEPPERS),
            ):
                try:
                    run = fr.simulate(rom, scene=asked, stepper=stepper)
                    found.append(row(model, run, rate(rom, scene=asked, stepper=stepper, runs=2), off(run)))
                except FenicsRomError as error:
                    notes.append(f"{model}, {share:g} of the load: {error}")
            return found

        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FenicsRomWarning)  # that the linear model is wrong is what is shown
            rows += run_on_rank_0(self._comm, reduced)
        return rows, notes

    def _full(self, model: str, scene: Scene, dt: float, stage: str) -> Trajectory:
        system = replace(self._systems[model], scene=scene)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FenicsRomWarning)
            return fr.simulate(system, dt=dt, report=lambda _, done, of: self._report(f"{model} {stage}", done, of))


def read_amplitudes(file: Path) -> Amplitudes:
    """Reads what a study left.

    Raises:
        FileError: there is no such file, or it holds something else.
    """
    return read_record(file, "a study of amplitudes", _amplitudes)


def _amplitudes(known: dict[str, Any]) -> Amplitudes:
    rows = tuple(Row(**row) for row in known.pop("rows"))
    return Amplitudes(rows=rows, notes=tuple(known.pop("notes")), **known)


def _speed(run: Trajectory) -> float:
    return run.steps / run.settings["seconds"]
