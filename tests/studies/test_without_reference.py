"""A study that does not run full order: its errors and its advice beside those of one that does."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bodies import PLATE, scene_text

import fenics_rom as fr
from fenics_rom.errors import FileError, SceneError
from fenics_rom.scene.file import parse_scene
from fenics_rom.studies.pareto import describe_choice, select_per_decade
from fenics_rom.studies.report import csv_table, markdown_report, remarks, write_report
from fenics_rom.studies.study import study_for_tolerance

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")

GRID = {"methods": ["balanced", "modal"], "orders": [5, 10, 20], "steps": [4e-3, 2e-3]}
PUSH = "dt = 0.01\nduration = 0.4\nload = [{ contact = 'right', stop = 0.2, force = [1.0, 2.0, -5.0] }]"
INERT = "inertia = {}\ndamping = { alpha = 1.0, beta = 1e-3 }"
FLOOR = """
[effects.contact]
switching = "scene"
obstacles.floor = { shape = "half-space", point = [0, 0, -1e-4], normal = [0, 0, 1] }
"""


def box_scene(mesh, effects=INERT, head="", **parts):
    text = head + scene_text(mesh, run=PUSH, effects=effects, **({"outputs.tip": "points = [[1.0, 0.0, 0.3]]"} | parts))
    return parse_scene(text, folder=Path(mesh).parent, source="box")


@pytest.fixture(scope="module")
def plate():
    scene = fr.read_scene(PLATE)
    return replace(scene, run=replace(scene.run, duration=0.4))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("studies")


@pytest.fixture(scope="module")
def alone(plate, folder):
    stages = set()
    found = fr.study(
        plate, folder / "alone", without_reference=True, **GRID, report=lambda stage, *_: stages.add(stage)
    )
    assert "full order" not in stages
    return found


@pytest.fixture(scope="module")
def beside(plate, folder):
    return fr.study(plate, folder / "beside", **GRID)


@pytest.mark.slow
def test_errors_are_within_a_factor_of_two_and_the_advice_is_the_same(alone, beside):
    assert len(alone.rows) == len(beside.rows) == 2 * 3 * 2
    for told, measured in zip(alone.rows, beside.rows, strict=True):
        assert (told.method, told.order, told.dt) == (measured.method, measured.order, measured.dt)
        assert 0.5 < told.error / measured.error < 2
        assert 0.5 < told.reduction / measured.reduction < 2
        assert 0.5 < told.outputs["tip"][0] / measured.outputs["tip"][0] < 2
        assert told.time_step == pytest.approx(measured.time_step, rel=1e-6)
    advice = [
        [(tolerance, row.method, row.order, row.dt) for tolerance, row in select_per_decade(results.rows)]
        for results in (alone, beside)
    ]
    assert advice[0] == advice[1]
    assert len(advice[0]) >= 2
    assert alone.reference_error == pytest.approx(beside.reference_error, rel=0.1)


def test_the_stated_error_of_the_shape_is_that_in_mass_and_the_bound_one_of_energy(plate, alone):
    scene = replace(plate, run=replace(plate.run, snapshots=20))
    system = fr.assemble(scene)
    rom = fr.reduce(system, order=10, method="balanced", switching="energy", errors=True)
    step = alone.reference_step
    full, reduced = fr.simulate(system, dt=step), fr.simulate(rom, scene=scene, dt=step)
    off = (full.snapshots - reduced.snapshots).reshape(len(full.snapshots), -1)[:, system.body.free]
    expected = np.sqrt([e @ (system.mass @ e[:, None])[:, 0] for e in off])
    at = np.searchsorted(reduced.times, reduced.snapshot_times)
    estimate, bound = reduced.errors["estimate"], reduced.errors["bound"]
    assert np.linalg.norm(estimate.shape[at] - expected) < 0.05 * np.linalg.norm(expected)
    assert bound.shape is None
    (row, _) = alone.of("balanced", 10)
    assert row.bound == pytest.approx(np.linalg.norm(bound.norm) / np.sqrt(2 * reduced.energy.sum()), rel=0.05)


def test_files_and_batches_keep_the_error_of_the_shape(plate, tmp_path):
    rom = fr.reduce(fr.assemble(plate), order=5, errors=True)
    run = fr.simulate(rom, scene=replace(plate, run=replace(plate.run, duration=0.02)))
    fr.write_trajectory(tmp_path / "run.h5", run)
    again = fr.read_trajectory(tmp_path / "run.h5")
    assert (again.errors["estimate"].shape == run.errors["estimate"].shape).all()
    assert again.errors["bound"].shape is None
    bodies, body = fr.Batch(rom, 2, 1e-3), fr.Simulator(rom, 1e-3)
    for _ in range(5):
        bodies.step(np.array([[0.0, 0.0, 0.5]] * 2))
        body.step([0.0, 0.0, 0.5])
    assert bodies.error_estimate.shape.tolist() == [body.error_estimate.shape] * 2
    assert body.error_estimate.shape > 0


def test_tables_and_pictures_say_what_they_are(alone, folder):
    assert not (folder / "alone" / "reference.h5").exists()
    assert alone.full_rate is None
    write_report(folder / "alone", alone, "study")
    text = markdown_report(alone, "study")
    assert "full order was not run. Errors are estimates" in text
    assert "| estimated error |" in text
    assert "## Estimated error of the reduction alone" in text
    assert "times full order" not in text
    assert "as fast as full order" not in text
    assert any("how fast full order is, and errors of energy are not known" in r for r in remarks(alone))
    assert describe_choice(alone, 0.01, alone.rows[0]).startswith("For 1e-2 of the whole shape, as estimated: ")
    rows = list(csv.DictReader(csv_table(alone).splitlines()))
    for row, found in zip(rows, alone.rows, strict=True):
        assert float(row["estimated error of shape"]) == pytest.approx(found.error, rel=1e-3)
        assert float(row["bound of reduction, energy norm"]) == pytest.approx(found.bound, rel=1e-3)
        assert row["error of energy"] == row["largest estimated error of shape"] == ""


def test_goes_on_only_from_one_of_its_kind(plate, alone, beside, folder):
    again = fr.study(plate, folder / "alone", without_reference=True, **GRID, resume=True)
    assert again == alone  # nothing was measured anew
    for name, kind, has in (("alone", False, "no"), ("beside", True, "a")):
        with pytest.raises(FileError, match=f"has {has} reference, other than this; start without resume"):
            fr.study(plate, folder / name, without_reference=kind, **GRID, resume=True)


def test_for_a_tolerance(plate, tmp_path):
    results, row, rom = study_for_tolerance(plate, tmp_path, 3e-3, without_reference=True)
    assert results.without_reference
    assert row.error <= 3e-3
    full = fr.simulate(fr.assemble(replace(plate, run=replace(plate.run, snapshots=50))), dt=row.dt / 4)
    assert fr.compare(fr.simulate(rom, scene=plate, dt=row.dt), full)["shape"].relative <= 2 * 3e-3


def test_a_first_look_takes_the_whole_run(box_file, tmp_path, monkeypatch):
    monkeypatch.setattr("fenics_rom.studies.method_configs.QUICK_WORK", 1.0)
    found = fr.study(box_scene(box_file), tmp_path, quick=True, without_reference=True, orders=[5, 10])
    assert found.duration == pytest.approx(0.4)
    assert {row.order for row in found.rows} == {5, 10}
    assert found.notes == ("a first look: rates are of one run",)


def test_among_obstacles_runs_are_compared_with_that_of_a_larger_model(box_file, tmp_path):
    """Which finds forces of its own: errors that runs state under the forces that they found are half as large."""
    scene = box_scene(box_file, f"{INERT}\n{FLOOR}")
    choices = {"methods": ["balanced", "modal"], "orders": [8, 20], "steps": [0.01]}
    told = fr.study(scene, tmp_path / "alone", without_reference=True, **choices)
    measured = fr.study(scene, tmp_path / "beside", **choices)
    assert told.compared_with == 60
    assert measured.compared_with is None
    assert len(told.rows) == len(measured.rows) == 4
    for one, other in zip(told.rows, measured.rows, strict=True):
        assert one.bound is None
        known = [(row.error, row.reduction, row.forces["floor"][0]) for row in (one, other)]
        assert np.all((np.divide(*known) > 0.5) & (np.divide(*known) < 2)), known
    advice = [[(row.method, row.order) for _, row in select_per_decade(found.rows)] for found in (told, measured)]
    assert advice[0] == advice[1]
    text = markdown_report(told, "study")
    assert "Errors are estimates: distances from the run of a model of order 60" in text
    assert "by a reduced model of order 60; how fast full order is, is not known" in text
    assert fr.study(scene, tmp_path / "alone", without_reference=True, **choices, resume=True) == told


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({"effects": f"{INERT}\nlarge_deformation = {{}}"}, "large deformation"),
        ({"head": 'frame = "moving"\n', "supports": None}, "a moving frame"),
        ({"effects": ""}, "no inertia"),
    ],
)
def test_bodies_whose_runs_do_not_state_their_errors_are_refused(box_file, tmp_path, given, reason):
    said = f"without_reference: the study takes errors that runs state; errors: a run with {reason} does not know"
    with pytest.raises(SceneError, match=said):
        fr.study(box_scene(box_file, **given), tmp_path, without_reference=True, methods=["modal"])
    with pytest.raises(SceneError, match=said):
        study_for_tolerance(box_scene(box_file, **given), tmp_path, 0.01, without_reference=True)


def test_bad_choices_are_refused(box_file, tmp_path):
    with pytest.raises(SceneError, match="meshes: are compared at full order, which is not run"):
        fr.study(box_scene(box_file), tmp_path, without_reference=True, meshes=[box_file])
    with pytest.raises(SceneError, match="without_reference"):
        fr.study(box_scene(box_file), tmp_path, without_reference="yes")
    with pytest.raises(SceneError, match=r"without_reference: .* no damping, no bound: the body has none; use"):
        fr.study(box_scene(box_file, "inertia = {}"), tmp_path, without_reference=True, methods=["modal"], orders=[5])
