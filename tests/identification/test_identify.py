"""Identification as a whole: what is found, how sure that is, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from measuring import PUSHES, START, TRUTH, film, found_by, scene_of, weigh, write

import fenics_rom as fr
from fenics_rom.errors import DataError, SceneError, SolverError
from fenics_rom.identification.affine import AffineSystem
from fenics_rom.identification.experiment import Experiments, make_experiment
from fenics_rom.identification.fit import FitProblem, fit_parameters
from fenics_rom.identification.marker_data import read_markers
from fenics_rom.identification.parameters import select_parameters, values_of
from fenics_rom.identification.recording import JointModel
from fenics_rom.identification.reduced_model import ReducedModel
from fenics_rom.identification.uncertainty import interval_half_widths
from fenics_rom.identification.write import parameter_rows

GRAVITY = "gravity = { acceleration = [0.0, 0.0, -0.5] }"
FROM_REST = "dt = 0.01\nduration = 0.6"


@pytest.fixture(scope="module")
def files(mesh, tmp_path_factory):
    """Data without noise, of a motion and of equilibria."""
    folder, truth = tmp_path_factory.mktemp("data"), scene_of(mesh, TRUTH)
    return film(folder / "motion.csv", truth), weigh(folder / "rest.csv", truth, PUSHES)


def test_without_noise_the_truth_is_found_from_far_away(mesh, files):
    result = found_by(scene_of(mesh, START), files)
    for name, value in TRUTH.items():
        assert result.values[name] == pytest.approx(value, rel=1e-6)
    assert result.residual < 1e-8
    assert result.full_residual < 1e-7
    assert result.scene.materials["material"].young == result.values["young"]
    assert result.scene.effects.damping.beta == result.values["beta"]


def test_a_start_ten_times_off_is_no_matter_for_a_motion(mesh, files):
    result = found_by(scene_of(mesh, {**TRUTH, "young": 2e5}), files[:1])
    assert result.values["young"] == pytest.approx(TRUTH["young"], rel=1e-6)


def test_only_the_parameters_that_were_asked_for_move(mesh, files):
    start = {**TRUTH, "young": 3e4, "alpha": 3.0}
    result = found_by(scene_of(mesh, start), files, parameters=["alpha", "young"])
    assert list(result.values) == ["alpha", "young"]
    assert result.values == pytest.approx({"alpha": TRUTH["alpha"], "young": TRUTH["young"]}, rel=1e-6)
    assert result.scene.materials["material"].poisson == TRUTH["poisson"]


def test_noise_is_told_and_the_truth_is_within_reach(mesh, tmp_path):
    noisy = film(tmp_path / "motion.csv", scene_of(mesh, TRUTH), noise=1e-4)
    result = found_by(scene_of(mesh, START), [noisy])
    assert result.noise == pytest.approx(1e-4, rel=0.15)
    for one in result.estimates:
        assert one.low < one.value < one.high
        assert abs(TRUTH[one.parameter.name] - one.value) < one.high - one.low  # within twice the interval
    assert result.full_residual == pytest.approx(result.residual, rel=1e-6)
    assert not any("not like noise" in message for message in result.warnings)


@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_say(mesh, files):
    """95 % intervals of 60 seeds, on the full basis."""
    scene = scene_of(mesh, TRUTH)
    parameters, affine = select_parameters(scene, None, moving=True), AffineSystem(scene)
    read = [read_markers(file, scene) for file in files]
    exact = make_experiment(
        scene, [replace(read[0], measured=read[0].measured[:, [2, 5, 7]], **thinned(read[0])), read[1]], affine.plain
    )
    model = JointModel((ReducedModel(affine.parts(np.eye(affine.plain.size))),))
    rng, q, held = np.random.default_rng(0), np.zeros(len(parameters)), []
    for _ in range(60):
        seen = exact.measured + 1e-4 * rng.standard_normal(len(exact.measured))
        noisy = Experiments((replace(exact, measured=seen),))
        problem = FitProblem(values_of(scene), parameters, noisy, lambda θ: model, affine.plain.algebra.comm)
        fit = fit_parameters(problem, q, model, lambda done, of: None)
        held.append(np.abs(fit.q) <= interval_half_widths(noisy.measured - fit.predicted, fit.jacobian))
    assert 0.91 <= np.mean(held) <= 0.985


def thinned(motion):
    """Of a motion three of its markers."""
    kept = [2, 5, 7]
    return {"columns": tuple(motion.columns[k] for k in kept), "markers": tuple(motion.markers[k] for k in kept)}


def test_data_at_rest_do_not_know_density_unless_there_is_gravity(mesh, files, tmp_path):
    start = scene_of(mesh, START)
    alone = found_by(start, files[1:])
    assert list(alone.values) == ["young", "poisson"]
    assert alone.values == pytest.approx({"young": TRUTH["young"], "poisson": TRUTH["poisson"]}, rel=1e-6)
    asked = found_by(start, files[1:], parameters=["young", "poisson", "density", "alpha"])
    held = {one.parameter.name: one for one in asked.estimates if one.held}
    assert list(held) == ["density", "alpha"]
    assert held["density"].value == START["density"]
    assert held["density"].low is None
    assert "the data do not depend on density" in asked.warnings
    assert asked.values["young"] == pytest.approx(TRUTH["young"], rel=1e-6)
    heavy = weigh(tmp_path / "heavy.csv", scene_of(mesh, TRUTH, GRAVITY), PUSHES, [1.0])
    weighed = found_by(scene_of(mesh, START, GRAVITY), [heavy])
    assert weighed.values == pytest.approx({key: TRUTH[key] for key in ("young", "poisson", "density")}, rel=1e-6)


def test_without_a_force_in_newton_only_the_ratio_of_modulus_and_density_is_told(mesh, tmp_path):
    falls = film(tmp_path / "falls.csv", scene_of(mesh, TRUTH, GRAVITY, run=FROM_REST))
    result = found_by(scene_of(mesh, START, GRAVITY, run=FROM_REST), [falls])
    assert [one.parameter.name for one in result.estimates if one.held] == ["density"]
    assert any("young and density appear only as their ratio" in message for message in result.warnings)
    ratio = TRUTH["young"] / TRUTH["density"]
    assert result.values["young"] / START["density"] == pytest.approx(ratio, rel=1e-6)
    assert result.values["alpha"] == pytest.approx(TRUTH["alpha"], rel=1e-6)


def test_what_noise_hides_is_held_and_not_fitted_to_it(mesh, tmp_path):
    noisy = film(tmp_path / "motion.csv", scene_of(mesh, TRUTH), noise=1e-3, every=6)
    result = found_by(scene_of(mesh, START), [noisy])
    held = {one.parameter.name: one.value for one in result.estimates if one.held}
    assert 1 <= len(held) <= 3
    assert held == {name: START[name] for name in held}
    assert any("the intervals of the others rest on that" in message for message in result.warnings)
    assert any("hardly depend" in message or "nearly the same data" in message for message in result.warnings)


def test_a_model_that_cannot_fit_is_said_to_be_poor(mesh, files):
    result = found_by(scene_of(mesh, {**START, "density": 400.0}), files[:1], parameters=["young"])
    assert any("the fit is poor" in message for message in result.warnings)
    assert any("the residuals are not like noise" in message for message in result.warnings)


def test_steps_that_are_too_long_for_the_intervals_are_named(mesh, files):
    result = found_by(scene_of(mesh, TRUTH), files[:1])  # without noise any step is too long
    assert any("the time step moves" in message and "smaller run.dt" in message for message in result.warnings)
    assert result.shifts["reduction"].max() == 0.0


def test_a_fit_that_does_not_settle_says_what_it_reached(mesh, files, monkeypatch):
    monkeypatch.setattr("fenics_rom.identification.fit.MAX_BASES", 1)
    with pytest.raises(SolverError, match=r"did not settle .* it reached young = .* residual of"):
        fr.identify(scene_of(mesh, START), files[:1])


def test_an_interval_that_rests_on_a_held_value_says_so_and_by_how_much(mesh, tmp_path):
    noisy = film(tmp_path / "motion.csv", scene_of(mesh, TRUTH), noise=1e-5)
    wrong = {**TRUTH, "density": 1.05 * TRUTH["density"]}
    young, alpha = found_by(scene_of(mesh, wrong), [noisy], parameters=["young", "alpha"]).estimates
    assert not young.low <= TRUTH["young"] <= young.high  # as density is held at a wrong value
    rests_on = {given.parameter.name: given for given in young.given}
    density = rests_on["density"]
    assert density.step == 0.01 * wrong["density"]
    more = found_by(
        scene_of(mesh, {**wrong, "density": 1.06 * TRUTH["density"]}), [noisy], parameters=["young", "alpha"]
    )
    moved = (more.values["young"] - young.value) / (0.01 * TRUTH["density"])
    assert density.shift / density.step == pytest.approx(moved, rel=0.1)  # a difference of two fits, of first order
    corrected = young.value + density.shift * (TRUTH["density"] - wrong["density"]) / density.step
    assert abs(corrected - TRUTH["young"]) < 0.1 * abs(young.value - TRUTH["young"])
    assert {given.parameter.name for given in alpha.given} <= {"poisson", "density", "beta"}


def test_what_rests_on_nothing_held_says_nothing(mesh, files):
    result = found_by(scene_of(mesh, START), files[1:], parameters=["young", "poisson", "density"])
    assert list(result.values) == ["young", "poisson"]  # a start value is not among what was found
    assert [one.given for one in result.estimates] == [(), (), ()]  # at rest without gravity density is no matter
    table = {row[0]: row[3:] for row in parameter_rows(result)}
    assert table["density"] == ("not determined", "-", "held at its start value")
    assert table["young"][2] == "-"


def test_the_table_names_what_is_held_beside_the_interval(mesh, files):
    result = found_by(scene_of(mesh, TRUTH), files[1:], parameters=["young"])
    ((*_, interval, given),) = parameter_rows(result)
    assert " to " in interval
    assert given.startswith("poisson = 0.35 (+0.01: ")


OBSTACLE = '[effects.contact.obstacles.floor]\nshape = "half-space"\npoint = [0, 0, -1]\nnormal = [0, 0, 1]'
WEIGHED = "[effects.point_masses.knob]\npoint = [1.0, 0.2, 0.1]\nmass = 0.1"
MOVED = '[effects.prescribed.push]\npoint = [1.0, 0.2, 0.1]\ntable = "push.csv"'


def test_scenes_that_cannot_be_identified_are_refused(mesh, files, tmp_path):
    with pytest.raises(SceneError, match=r"effects.contact: where obstacles push is not known"):
        fr.identify(scene_of(mesh, START, OBSTACLE, run=None), files)
    with pytest.raises(SceneError, match=r"data with times need effects.inertia"):
        fr.identify(scene_of(mesh, START, effects=GRAVITY), files)
    with pytest.raises(SceneError, match=r"effects.prescribed.push: changes with time, so it has no value in an"):
        fr.identify(scene_of(mesh, START, MOVED, tables={"push.csv": np.eye(2, 4)[::-1]}), files)
    with pytest.raises(SceneError, match="is not wholly held, so it has no equilibria"):
        fr.identify(scene_of(mesh, START, supports=None), files)
    with pytest.raises(SceneError, match=r"no parameter 'yung'.*did you mean 'young'"):
        fr.identify(scene_of(mesh, START), files, parameters=["yung"])
    with pytest.raises(SceneError, match="needs a start value above 0"):
        fr.identify(scene_of(mesh, {**START, "alpha": 0.0}), files, parameters=["alpha"])
    with pytest.raises(SceneError, match="use each name once"):
        fr.identify(scene_of(mesh, START), files, parameters=["young", "young"])


def test_data_that_tell_nothing_are_refused(mesh, files, tmp_path):
    scene = scene_of(mesh, START)
    with pytest.raises(DataError, match="no data were given"):
        fr.identify(scene, [])
    write(tmp_path / "few.csv", ["time (s)", "side.x (m)"], [[0.1, 1e-3], [0.2, 1e-3]])
    with pytest.raises(DataError, match="2 values were measured; to find 5 parameters, use more"):
        fr.identify(scene, [tmp_path / "few.csv"])
    write(tmp_path / "empty.csv", ["time (s)", "side.x (m)"], [[0.1, ""], [0.2, ""]])
    with pytest.raises(DataError, match="no marker was seen"):
        fr.identify(scene, [tmp_path / "empty.csv"])
    with pytest.raises(DataError, match="tell none of the parameters: the data do not depend on density"):
        fr.identify(scene, files[1:], parameters=["density"])


@pytest.mark.parametrize("young", [2e5, 2e7])
def test_many_periods_of_a_frequency_that_is_far_off_are_found_little_by_little(mesh, tmp_path, young):
    """Some twenty periods, and a start ten times off: seen all at once, the fit would end in another minimum."""
    run = """dt = 0.02
duration = 10.0
load = [{ contact = "right", stop = 0.1, force = [0.0, 0.0, 30.0] }]"""
    truth = {**TRUTH, "young": 2e6, "alpha": 0.3, "beta": 1e-4}
    film(tmp_path / "motion.csv", scene_of(mesh, truth, run=run), every=1)
    start = scene_of(mesh, {**truth, "young": young}, run=run)
    result = found_by(start, [tmp_path / "motion.csv"], parameters=["young"])
    assert result.values["young"] == pytest.approx(truth["young"], rel=1e-6)


def test_what_is_identified_is_looked_at_before_it_is_fitted(mesh, files, tmp_path, monkeypatch):
    """Data in mm under a heading in m, and a scene whose frame moves."""
    monkeypatch.delattr("fenics_rom.identification.identify.fit_parameters")
    in_mm = tmp_path / "in_mm.csv"
    in_mm.write_text(files[0].read_text().replace("(mm)", "(m)"))
    with pytest.raises(
        DataError, match=r"in_mm.csv: along x, y, z, its displacements measure .* under a heading in m\."
    ):
        fr.identify(scene_of(mesh, START), [in_mm])
    moving = replace(scene_of(mesh, START), frame="moving")
    with pytest.raises(SceneError, match=r"frame = 'moving': a fit has no models of a body that turns"):
        fr.identify(moving, files)
    with pytest.raises(SceneError, match=r"frame = 'moving': use linear bodies, with frame = 'fixed'"):
        fr.differentiate_scene(moving, lambda outputs, energies: (0.0, {}, None))
