"""What a study over the size of the load says, against runs of its own; what it leaves, takes over and refuses."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import scene_text, write_box

import fenics_rom as fr
from fenics_rom.cli.main import main
from fenics_rom.errors import FileError, SceneError
from fenics_rom.mechanics.signals import Signal
from fenics_rom.scene.effects import PrescribedForce
from fenics_rom.studies.amplitude_report import markdown_report
from fenics_rom.studies.amplitudes import AmplitudeResults, AmplitudeRow, linear, scaled, study_amplitudes
from fenics_rom.studies.json_record import read_record, write_record

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")]

BEND = """dt = 5e-3
duration = 0.15
load = [{ contact = "right", stop = 0.1, force = [0.0, 0.0, 0.25] }]"""
EFFECTS = "inertia = {}\ndamping = { alpha = 1.0, beta = 2e-3 }\nlarge_deformation = {}"


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    folder = tmp_path_factory.mktemp("beam")
    mesh = write_box(folder / "beam.msh", (0.2, 0.02, 0.02), (8, 1, 1))
    text = scene_text(
        mesh, run=BEND, effects=EFFECTS, reduction="order = 8", material="young = 2e5\npoisson = 0.3\ndensity = 1000.0"
    )
    (folder / "beam.toml").write_text(text)
    return folder / "beam.toml"


@pytest.fixture(scope="module")
def results(file):
    return study_amplitudes(fr.read_scene(file), file.parent / "study", quick=True)


def of(results, model, share=1.0) -> AmplitudeRow:
    return next(row for row in results.rows if (row.model, row.share) == (model, share))


def test_small_loads_are_linear_and_large_ones_are_not(results):
    for model in ("linear, full order", "linear, reduced"):
        assert of(results, model, 0.125).error < 0.2 * of(results, model).error
        assert of(results, model).error > 0.1
    for stepper in ("newton", "linearly-implicit"):
        assert of(results, f"nonlinear, reduced, {stepper}").error < 0.2 * of(results, "linear, reduced").error
    assert of(results, "nonlinear, full order").error < of(results, "nonlinear, reduced, newton").error
    assert of(results, "nonlinear, full order").displacement > 0.03


def test_errors_are_those_of_runs(file, results):
    scene = fr.read_scene(file)
    full, linear_run = fr.simulate(scene), fr.simulate(linear(scene))
    assert of(results, "linear, full order").error == pytest.approx(
        fr.compare(linear_run, full)["shape"].relative, rel=1e-6
    )
    rom = fr.read_rom(file.parent / "study" / "rom.h5")
    reduced = fr.simulate(rom, stepper="newton")
    error = fr.compare(reduced, full)["shape"].relative
    assert of(results, "nonlinear, reduced, newton").error == pytest.approx(error, rel=1e-6)


def test_a_share_of_the_loads_is_that(file, tmp_path):
    scene = fr.read_scene(file)
    assert scaled(scene, 0.5).run.loads[0].signal == Signal(np.array([0.0, 0.0, 0.125]))
    times, values = np.array([0.0, 1.0]), np.array([[0.0, 0, 0], [1.0, 2, 3]])
    load = replace(scene.run.loads[0], signal=Signal(values, times))
    push = PrescribedForce(surface="right", table=Signal(values, times))
    pull = PrescribedForce(surface="right", force=(0.0, 0.0, 2.0))
    effects = replace(scene.effects, prescribed={"push": push, "pull": pull})
    half = scaled(replace(scene, run=replace(scene.run, loads=(load,)), effects=effects), 0.5)
    assert half.run.loads[0].signal == Signal(0.5 * values, times)
    assert half.environment.loads["push"].signal == Signal(0.5 * values, times)
    assert half.environment.loads["pull"].signal == Signal(np.array([0.0, 0.0, 1.0]))


def test_what_was_found_is_taken_over(file, results):
    again = study_amplitudes(fr.read_scene(file), file.parent / "study", quick=True, resume=True)
    assert (
        again
        == results
        == read_record(file.parent / "study" / "amplitudes.json", AmplitudeResults, "a study of amplitudes")
    )
    touched = replace(results, rows=(replace(results.rows[0], forces={"stop": (0.1, 0.2, 0.3)}),))
    write_record(file.parent / "touched.json", touched)
    assert read_record(file.parent / "touched.json", AmplitudeResults, "a study of amplitudes") == touched
    assert "2.0e-01" in markdown_report(touched, "").partition("Contact forces:")[2]
    other = replace(fr.read_scene(file), text=fr.read_scene(file).text + "\n# changed")
    with pytest.raises(FileError, match="of another scene"):
        study_amplitudes(other, file.parent / "study", resume=True)


def test_the_command_writes_table_and_picture(file, results, capsys):
    folder = file.parent / "study"
    with pytest.raises(SystemExit) as ended:
        main(["study", str(file), "-o", str(folder), "--quick", "--resume"])
    assert not ended.value.code
    assert "nonlinear, reduced, newton, order 8" in (folder / "amplitudes.md").read_text()
    assert (folder / "amplitudes.png").stat().st_size > 20_000
    assert (folder / "amplitudes.pdf").exists()
    with pytest.raises(SystemExit) as ended:
        main(["study", str(file), "-o", str(folder), "--orders", "5"])
    assert ended.value.code == 2
    assert "--orders" in capsys.readouterr().err


def test_what_cannot_be_studied_is_said(file, tmp_path):
    scene = fr.read_scene(file)
    with pytest.raises(SceneError, match="large_deformation"):
        study_amplitudes(linear(scene), tmp_path)
    (tmp_path / "amplitudes.json").write_text("{}")
    with pytest.raises(FileError, match="does not hold"):
        read_record(tmp_path / "amplitudes.json", AmplitudeResults, "a study of amplitudes")
