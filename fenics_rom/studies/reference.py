"""The full-order run that reduced ones are measured against, and what is known of its own error."""

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import fenics_rom as fr
from fenics_rom.errors import CompareError, SceneError
from fenics_rom.io.progress import Report
from fenics_rom.mechanics.environment import Run
from fenics_rom.reduction.error_model import UNDAMPED, check_errors_known, is_touched
from fenics_rom.scene.scene import Scene
from fenics_rom.studies.study_results import MeshRow
from fenics_rom.system.system import System


def measurable_run(scene: Scene, meshes: Sequence[Path] = ()) -> Run:
    """The run of a scene; raises what can be known before any work.

    Raises:
        SceneError: no run, nothing that acts, or finer meshes without outputs to compare.
    """
    if scene.run is None:
        raise SceneError(f"{scene.source}: has no [run], so there is nothing to measure; add one with a load")
    acting = scene.environment
    if not (scene.run.loads or scene.run.initial or acting.base_path or acting.loads or acting.obstacles):
        raise SceneError(
            f"{scene.source}: nothing acts in its run, so there is nothing to measure; add [[run.load]], gravity, "
            "base_motion, a base path, prescribed forces, an obstacle or run.initial"
        )
    if meshes and not scene.outputs:
        raise SceneError(
            f"{scene.source}: meshes are compared at outputs, and the scene names none; add [outputs.NAME]"
        )
    return scene.run


def check_dispensable(system: System) -> None:
    """A SceneError where reduced runs of a body do not state their errors, so that it takes a reference."""
    try:
        check_errors_known(system)
        if system.rayleigh is not None and max(system.rayleigh) <= 0 and not is_touched(system):
            raise SceneError(UNDAMPED.format("the body has none"))
    except SceneError as error:
        source = system.scene.source if system.scene else "system"
        raise SceneError(f"{source}: without_reference: the study takes errors that runs state; {error}") from error


def richardson_divisor(scene: Scene) -> float:
    """By what the distance of two runs, of which one has half the step, is to be divided for the error of that one.

    Richardson's 2ᵖ - 1, where the error goes with the p-th power of the step: p = 2 of the midpoint rule, and 1 where
    contact makes forces jump.
    """
    return 3.0 if scene.effects.contact is None else 1.0


def compare_meshes(system: System, files: Sequence[Path], dt: float, report: Report) -> tuple[MeshRow, ...]:
    """The scene's outputs on its own mesh and on others at full order, against those of the finest.

    All runs have the same step; what it does to them is the same, and drops out.

    Raises:
        SceneError, MeshError: as `assemble`, or no mesh is finer than the scene's.
    """
    scene = system.scene
    assert scene is not None
    runs = {scene.mesh_file: (system.size, fr.simulate(system, dt=dt))}
    for k, file in enumerate(files):
        report("meshes", k, len(files))
        other = fr.assemble(replace(scene, mesh_file=file))
        runs[file] = other.size, fr.simulate(other, dt=dt)
    report("meshes", len(files), len(files))
    finest, finest_run = max(runs.values(), key=lambda run: run[0])
    if finest == system.size:
        raise SceneError(f"{scene.mesh_file.name} has {system.size} unknowns; use meshes that are finer")
    rows = [
        MeshRow(
            file.name, size, {name: _distance(values, finest_run.outputs[name]) for name, values in run.outputs.items()}
        )
        for file, (size, run) in runs.items()
    ]
    return (rows[0], *sorted(rows[1:], key=lambda row: row.size))


def _distance(values: np.ndarray, reference: np.ndarray) -> float:
    size = np.linalg.norm(reference)
    if size == 0:
        raise CompareError("an output does not move, so meshes cannot be compared at it")
    return float(np.linalg.norm(values - reference) / size)


def fingerprint(scene: Scene, reference_step: float, shapes: int, without_reference: bool = False) -> str:
    """What two studies share only when they measure against the same run, or both against none."""
    digest = hashlib.sha256(scene.text.encode())
    for name in sorted(scene.tables):
        digest.update(np.ascontiguousarray(scene.tables[name]).tobytes())
    try:
        digest.update(scene.mesh_file.read_bytes())
    except OSError as error:
        raise SceneError(f"{scene.mesh_file}: cannot be read: {error.strerror}") from error
    duration = 0.0 if scene.run is None else scene.run.duration
    digest.update(repr((reference_step, shapes, duration) + ("alone",) * without_reference).encode())
    return digest.hexdigest()
