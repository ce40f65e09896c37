"""What the reduced model says of markers, against the full order, and its Jacobian against differences of that."""

import numpy as np
import pytest
from measuring import START, TRUTH, box_mesh, film, scene_of, weigh

import fenics_rom as fr
from fenics_rom.identification.affine import AffineSystem
from fenics_rom.identification.experiment import interpolate_instants, make_experiment
from fenics_rom.identification.full_order import answer_of
from fenics_rom.identification.marker_data import read_markers
from fenics_rom.identification.parameters import directions_at, scene_with, select_parameters, values_at, values_of
from fenics_rom.identification.reduced_model import ReducedModel, make_basis

LOADS = """gravity = { acceleration = [0.0, 0.0, -0.1] }
[effects.base_motion.quake]
direction = [0, 1, 0]
table = "quake.csv"
[effects.prescribed.pull]
point = [1.0, 0.2, 0.15]
force = [0.2, 0.0, 0.1]
"""
TABLES = {"quake.csv": np.array([[0.0, 0.0], [0.13, 0.3], [0.31, -0.2], [0.6, 0.1]])}  # s, m/s2
AT_REST = [1.0, 0.0, 0.2, 0.0, 0.1]  # gravity, quake, pull
PUSHES = [("right", (0.0, 0.0, 2.0)), ("top", (1.0, 0.5, 0.0))]


def quiet(stage, done, of):
    pass


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """A scene with loads of all kinds, and data of it in motion and at rest."""
    folder = tmp_path_factory.mktemp("case")
    mesh = box_mesh(folder, (6, 3, 2))
    truth = scene_of(mesh, TRUTH, LOADS, TABLES)
    files = film(folder / "motion.csv", truth), weigh(folder / "rest.csv", truth, PUSHES, AT_REST)
    scene = scene_of(mesh, START, LOADS, TABLES)
    affine = AffineSystem(scene)
    return scene, truth, make_experiment(scene, [read_markers(file, scene) for file in files], affine.plain), affine


def test_full_order_answers_with_what_was_measured_on_it(case):
    _, truth, experiment, _ = case
    answer = answer_of(fr.assemble(truth), experiment, quiet)
    said, messages = answer.predictions(experiment, values_of(truth)), answer.warnings
    assert len(said) == 30 * 9 + 2 * 6
    assert np.abs(said - experiment.measured).max() <= 1e-12 * np.abs(said).max()
    assert messages == ()


def test_on_all_displacements_the_model_is_the_full_order(case):
    _, truth, experiment, affine = case
    model = ReducedModel(affine.parts(np.eye(affine.plain.size)))
    said = model.predict(experiment, values_of(truth))
    assert np.abs(said - experiment.measured).max() <= 1e-10 * np.abs(said).max()


def test_jacobian_is_that_of_differences_of_the_full_order(case, monkeypatch):
    monkeypatch.setattr(
        "fenics_rom.identification.reduced_model.BALANCED_TOLERANCE", 1e-3
    )  # so small a body has nothing to leave out
    scene, _, experiment, affine = case
    parameters, start = select_parameters(scene, None, moving=True), values_of(scene)
    q, h = np.array([0.1, -0.2, 0.05, 0.3, -0.1]), 3e-4
    θ = values_at(start, parameters, q)
    whole = ReducedModel(affine.parts(np.eye(affine.plain.size)))
    reduced = ReducedModel(affine.parts(make_basis(fr.assemble(scene_with(scene, θ)), experiment)))
    assert reduced.order < 0.8 * affine.plain.size
    differences = []
    for step in h * np.eye(len(q)):
        after, before = (
            answer_of(fr.assemble(scene_with(scene, values_at(start, parameters, at))), experiment, quiet).predictions(
                experiment, start
            )
            for at in (q + step, q - step)
        )
        differences.append((after - before) / (2 * h))
    for model, tolerance in ((whole, 1e-6), (reduced, 2e-4)):
        _, J = model.linearize(experiment, θ, directions_at(start, parameters, q))
        for column, difference in zip(J.T, differences, strict=True):
            assert np.linalg.norm(column - difference) <= tolerance * np.linalg.norm(difference)


def test_what_is_seen_later_does_not_count_until_then(case):
    _, truth, experiment, affine = case
    model = ReducedModel(affine.parts(np.eye(affine.plain.size)))
    part = experiment.until(0.2)
    assert len(part.times) == 10 * 9
    assert part.steps < experiment.steps
    said = model.predict(part, values_of(truth))
    assert np.abs(said - part.measured).max() <= 1e-10 * np.abs(said).max()


@pytest.mark.parametrize("steps", [1, 2, 3, 7])
def test_interpolation_is_exact_for_cubics_and_at_step_ends(steps):
    degree, dt = min(3, steps), 0.2
    cubic = np.polynomial.Polynomial(np.arange(1.0, degree + 2))
    times = np.append(np.linspace(0, steps * dt, 23), dt * np.arange(steps + 1))
    nodes, weights = interpolate_instants(times, dt, steps)
    assert nodes.min() >= 0
    assert nodes.max() <= steps
    np.testing.assert_allclose((weights * cubic(nodes * dt)).sum(axis=1), cubic(times), rtol=1e-12)
    assert np.isclose(weights[23:], np.round(weights[23:]), rtol=0, atol=1e-12).all()
