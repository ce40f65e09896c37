"""Recordings of what real bodies do: weights, starts that are not at rest, clocks, positions, large deformation."""

import numpy as np
import pytest
from measuring import START, TRUTH, film, found_by, scene_of, text_of
from ranks import run_ranks
from test_agreement import changed, scaled

import fenics_rom as fr
from fenics_rom.errors import DataError, SceneError
from fenics_rom.identification.marker_data import read_markers
from fenics_rom.identification.parameters import directions_at, select_parameters, values_at, values_of
from fenics_rom.identification.recording import Recording
from fenics_rom.io.progress import silent

GRAVITY = "gravity = { acceleration = [0.0, 0.0, -0.5] }"
WEIGHT = f"{GRAVITY}\npoint_masses.knob = {{ point = [1.0, 0.2, 0.15], mass = 40.0 }}"
FALLS = "dt = 0.01\nduration = 0.6"
LETS_GO = f'{FALLS}\ninitial.shape = "equilibrium"\nload = [{{ contact = "right", stop = 0.05, force = [0, 0, 4.0] }}]'
THROWN = f"{FALLS}\ninitial.velocity = [0.0, 0.05, 0.02]"
BENDS = "large_deformation = {}"  # by a quarter of its length
HARD = 'dt = 0.02\nduration = 0.8\nload = [{ contact = "right", stop = 0.2, force = [0.0, 0.0, 160.0] }]'


def late(file, seconds):
    """A film whose clock is late."""
    first, *rows = file.read_text().splitlines()
    rows = [row.split(",", 1) for row in rows]
    file.write_text("\n".join([first, *(f"{float(time) + seconds!r},{values}" for time, values in rows)]) + "\n")
    return file


def positions(file, start):
    """A film of positions in mm, with two frames before the run in which the markers are at `start`, with a gap."""
    first, *rows = file.read_text().splitlines()
    moved = np.array([row.split(",")[1:] for row in rows], float) + start
    rows = [",".join([row.split(",")[0], *map(repr, place.tolist())]) for row, place in zip(rows, moved, strict=True)]
    still = ",".join(map(repr, start.tolist()))
    rows[3] = ",".join([*rows[3].split(",")[:4], "", *rows[3].split(",")[5:]])
    file.write_text("\n".join([first, f"-0.02,{still}", f"-0.01,{still}", *rows]) + "\n")
    return file


@pytest.mark.parametrize(("more", "run"), [(GRAVITY, LETS_GO), (WEIGHT, FALLS), ("", THROWN)])
def test_starts_and_weights_are_those_of_the_scene(mesh, tmp_path, more, run):
    film(tmp_path / "film.csv", scene_of(mesh, TRUTH, more, run=run))
    start = scene_of(mesh, {**TRUTH, "young": 1.6e4, "beta": 8e-3}, more, run=run)
    result = found_by(start, [tmp_path / "film.csv"], parameters=["young", "beta"])
    assert result.values == pytest.approx({"young": TRUTH["young"], "beta": TRUTH["beta"]}, rel=1e-6)


def test_a_weight_of_one_of_two_recordings_sets_the_scale(mesh, tmp_path):
    """Alone, E and ρ of a body that falls are known by their ratio."""
    film(tmp_path / "alone.csv", scene_of(mesh, TRUTH, GRAVITY, run=FALLS))
    film(tmp_path / "loaded.csv", scene_of(mesh, TRUTH, WEIGHT, run=FALLS))
    scene, loaded = (scene_of(mesh, START, more, run=FALLS) for more in (GRAVITY, WEIGHT))
    result = found_by(scene, [tmp_path / "alone.csv", read_markers(tmp_path / "loaded.csv", loaded)])
    assert result.values == pytest.approx(TRUTH, rel=1e-5)
    other = scene_of(mesh, TRUTH, WEIGHT, run=FALLS)
    with pytest.raises(SceneError, match="use scenes that begin with the same values"):
        found_by(scene, [read_markers(tmp_path / "loaded.csv", other)])


@pytest.mark.slow
def test_recordings_of_two_scenes_are_named_on_the_command_line(mesh, tmp_path):
    """Their clocks are found, too, and the scene that is written is the first one's."""
    for name, more in (("alone", GRAVITY), ("loaded", WEIGHT)):
        late(film(tmp_path / f"{name}.csv", scene_of(mesh, TRUTH, more, run=FALLS)), -0.004)
        (tmp_path / f"{name}.toml").write_text(text_of(mesh, {**TRUTH, "young": 1.6e4}, more, run=FALLS))
    words = ["alone.toml", "--data", "alone.csv", "--also", "loaded.toml", "loaded.csv", "-o", "found"]
    done = run_ranks(1, "-m", "fenics_rom", "identify", *words, "--parameters", "young,density,clock", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "clock of loaded.csv" in (tmp_path / "found" / "identification.md").read_text()
    found = fr.read_scene(tmp_path / "found" / "identified.toml")
    assert not found.effects.point_masses
    again = run_ranks(1, "-m", "fenics_rom", "identify", *words[:-3], "nowhere.csv", "-o", "more", cwd=tmp_path)
    assert again.returncode == 1
    assert "nowhere.csv" in again.stderr


def test_late_clocks_are_found_each_by_itself(mesh, tmp_path):
    truth = scene_of(mesh, TRUTH)
    files = [late(film(tmp_path / f"{name}.csv", truth), delay) for name, delay in (("a", -0.006), ("b", 0.0))]
    result = found_by(scene_of(mesh, {**TRUTH, "young": 1.5e4}), files, parameters=["young", "clock"])
    found = {"young": TRUTH["young"], "clock of a.csv": -0.006, "clock of b.csv": 0.0}
    assert result.values == pytest.approx(found, rel=1e-3, abs=2e-5)


def test_positions_count_from_where_the_run_begins_and_gaps_are_counted(mesh, tmp_path):
    run = LETS_GO
    place = np.arange(9.0) - 3
    file = positions(film(tmp_path / "film.csv", scene_of(mesh, TRUTH, GRAVITY, run=run)), place)
    first = fr.simulate(scene_of(mesh, TRUTH, GRAVITY, run=run))
    offset = 1e3 * np.concatenate([first.outputs["tip"][0].ravel(), first.outputs["side"][0].ravel()])
    text = file.read_text()
    still = ",".join(map(repr, place.tolist()))
    file.write_text(text.replace(still, ",".join(map(repr, (place + offset).tolist()))))
    start = scene_of(mesh, {**TRUTH, "young": 1.5e4}, GRAVITY, run=run)
    result = found_by(start, [file], parameters=["young"])
    assert result.values["young"] == pytest.approx(TRUTH["young"], rel=1e-6)
    assert result.experiment.unseen == 1


@pytest.fixture(scope="module")
def bent(mesh, tmp_path_factory):
    """A scene that deforms largely, and what was measured on the truth."""
    folder = tmp_path_factory.mktemp("bent")
    file = film(folder / "film.csv", scene_of(mesh, TRUTH, BENDS, run=HARD), noise=1e-3)
    return scene_of(mesh, {**TRUTH, "young": 1.6e4}, BENDS, run=HARD), file


def test_a_body_that_deforms_largely_is_identified_as_the_full_order_says(bent):
    scene, file = bent
    result = found_by(scene, [file], parameters=["young"])
    assert np.ptp(result.experiment.measured) > 0.2
    assert result.shifts["reduction"].max() < 0.01
    for one in result.estimates:
        assert abs(TRUTH[one.parameter.name] - one.value) < one.high - one.low  # within twice the interval


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (scaled("(m", 1e3), r"its displacements measure .*e\+0[23] times .* mm are written under a heading in m\."),
        (scaled("(m", -1.0), r"seems that the sign of .* is turned \(a factor of -1\): so read"),
        (scaled(".z (m", -1.0), r"seems that the sign of z is turned \(a factor of -1\): so read"),
    ],
)
def test_data_that_a_body_that_deforms_largely_cannot_give_are_refused(bent, tmp_path, change, message):
    scene, file = bent
    with pytest.raises(DataError, match=rf"film.csv: .*{message}"):
        found_by(scene, [changed(file, tmp_path, change)], parameters=["young"])


@pytest.mark.slow
def test_derivatives_of_a_model_of_one_run_are_those_of_the_full_order(bent):
    scene, file = bent
    recording, q, h = Recording(scene, [read_markers(file, scene)], 0), np.zeros(5), 1e-3
    parameters, start = select_parameters(scene, None, moving=True), values_of(scene, 1)
    model = recording.model_at(start, silent)
    said, J = model.linearize(recording.experiment, start, directions_at(start, parameters, q))
    full = recording.answer_at(start, silent).predictions(recording.experiment, start)
    assert np.abs(said - full).max() <= 1e-10 * np.abs(full).max()
    for column, step, tolerance in zip(J.T, h * np.eye(5), (0.05, 0.15, 0.05, 0.05, 0.1), strict=True):
        values = [values_at(start, parameters, sign * step) for sign in (1, -1)]
        after, before = (recording.answer_at(θ, silent).predictions(recording.experiment, θ) for θ in values)
        difference = (after - before) / (2 * h)
        assert np.linalg.norm(column - difference) <= tolerance * np.linalg.norm(difference)
