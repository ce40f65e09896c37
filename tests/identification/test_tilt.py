"""Gravity's direction as an unknown: two angles, their derivatives, and data that know them."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest
from measuring import TRUTH, film, found_by, scene_of, text_of, weigh

import fenics_rom as fr
from fenics_rom.errors import SceneError
from fenics_rom.identification.affine import AffineSystem
from fenics_rom.identification.marker_data import read_markers
from fenics_rom.identification.parameters import directions_at, scene_with, select_parameters, values_at, values_of
from fenics_rom.identification.recording import Recording
from fenics_rom.identification.tilt import tilt_axes, tilted, tilted_slope
from fenics_rom.io.progress import silent

LEVEL, TILT = np.array([0.0, 0.0, -0.5]), np.array([3.0, -2.0])  # m/s2, degrees about x and y
FALLS = "dt = 0.01\nduration = 0.6"
LETS_GO = f'{FALLS}\ninitial.shape = "equilibrium"\nload = [{{ contact = "right", stop = 0.05, force = [0, 0, 4.0] }}]'
ATTACHED = """
[effects.springs.bed]
surface = "front"
stiffness = 50.0
[effects.pressure.air]
surface = "back"
[effects.prescribed.pull]
surface = "top"
force = [0.0, 2.0, 0.0]
[effects.point_masses.knob]
point = [1.0, 0.2, 0.15]
mass = 40.0
direction = [0, 1, 1]
[effects.rigid_parts.cap]
surface = "right"
mass = 30.0
center = [1.1, 0.2, 0.1]
"""
OBLIQUE = '[[supports.held]]\nsurface = "bottom"\nnormal = [0.3, 0, 1]'


def pulled(g):
    return f"gravity = {{ acceleration = {np.asarray(g).tolist()} }}"


def test_gravity_is_turned_about_the_two_axes_that_it_is_not_along():
    assert [tilt_axes(np.array(g)) for g in ([0, 0, -9.81], [9, 1, 1], [0, -2, 1])] == [[0, 1], [1, 2], [0, 2]]
    c, s = np.cos(np.radians(TILT)), np.sin(np.radians(TILT))
    once = 9.81 * np.array([0.0, s[0], -c[0]])
    both = np.array([s[1] * once[2], once[1], c[1] * once[2]])
    assert np.abs(tilted(np.array([0, 0, -9.81]), TILT) - both).max() < 1e-14
    rng, h = np.random.default_rng(0), 1e-3
    for g, tilt, change in rng.standard_normal((5, 3, 3)):
        assert np.isclose(np.linalg.norm(tilted(g, tilt[:2])), np.linalg.norm(g), rtol=1e-14)
        after, before = (tilted(g, tilt[:2] + side * change[:2]) for side in (h, -h))
        assert np.abs(tilted_slope(g, tilt[:2], change[:2]) - (after - before) / (2 * h)).max() < 1e-9


@pytest.mark.parametrize("more", [ATTACHED, f"{ATTACHED}{OBLIQUE}"])
def test_inputs_are_those_assembled_with_gravity_tilted(mesh, more):
    """And their derivatives those of differences; also on supports that are oblique to the axes."""
    scene = scene_of(mesh, TRUTH, f"{pulled([0.1, -0.3, -9.0])}{more}")
    affine = AffineSystem(scene)
    parts = affine.parts(np.eye(affine.plain.size))
    parameters, start = select_parameters(scene, ["density", "tilt", "young"], moving=True), values_of(scene)
    q, h = np.array([0.3, 0.4, -0.7, 0.1]), 1e-5
    θ = values_at(start, parameters, q)
    system = fr.assemble(scene_with(scene, θ))
    for name in scene.contacts:
        wanted, found = system.input_matrix(name), parts.input_matrix(name, θ)
        assert (np.abs(found - wanted).max(axis=0) <= 1e-12 * np.abs(wanted).max(axis=0)).all()
        u = np.random.default_rng(0).standard_normal((3, wanted.shape[1]))
        assert np.abs(parts.forces({name: u}, 3, θ) - u @ wanted.T).max() <= 1e-12 * np.abs(u @ wanted.T).max()
        for step, dθ in zip(h * np.eye(4), directions_at(start, parameters, q), strict=True):
            ends = (parts.forces({name: u}, 3, values_at(start, parameters, q + side * step)) for side in (1, -1))
            difference, along = np.subtract(*ends) / (2 * h), parts.forces_along({name: u}, 3, θ, dθ)
            assert np.abs(along - difference).max() <= 1e-8 * np.abs(u @ wanted.T).max()


@pytest.mark.parametrize("run", [FALLS, LETS_GO])
def test_tilt_and_modulus_are_found_from_a_motion(mesh, tmp_path, run):
    film(tmp_path / "film.csv", scene_of(mesh, TRUTH, pulled(tilted(LEVEL, TILT)), run=run))
    start = {**TRUTH, "young": 1.6e4}
    result = found_by(
        scene_of(mesh, start, pulled(LEVEL), run=run), [tmp_path / "film.csv"], parameters=["young", "tilt"]
    )
    assert result.values == pytest.approx({"young": TRUTH["young"], "tilt.x": TILT[0], "tilt.y": TILT[1]}, rel=1e-6)
    assert result.scene.effects.gravity.acceleration == pytest.approx(tilted(LEVEL, TILT).tolist(), rel=1e-6)


def test_tilt_is_found_at_rest_and_written(mesh, tmp_path):
    weigh(
        tmp_path / "rest.csv", scene_of(mesh, TRUTH, pulled(tilted(LEVEL, TILT))), [("right", (0.0, 0.1, 2.0))], [1.0]
    )
    (tmp_path / "scene.toml").write_text(text_of(mesh, TRUTH, pulled(LEVEL)))
    scene = fr.read_scene(tmp_path / "scene.toml")
    result = found_by(scene, [tmp_path / "rest.csv"], parameters=["tilt"])
    fr.write_identification(tmp_path / "found", result)
    found = fr.read_scene(tmp_path / "found" / "identified.toml").effects
    assert replace(found, gravity=None) == replace(result.scene.effects, gravity=None)
    written = tomllib.loads((tmp_path / "found" / "identified.toml").read_text())
    assert written["effects"]["gravity"]["acceleration"] == pytest.approx(tilted(LEVEL, TILT).tolist(), rel=1e-6)
    assert "| tilt.y    | deg  | 0     | -2    |" in (tmp_path / "found" / "identification.md").read_text()


@pytest.mark.slow
def test_tilt_is_within_its_interval_where_a_body_is_let_go_from_a_large_deformation(mesh, tmp_path):
    more, truth = "\nlarge_deformation = {}", {"young": TRUTH["young"], "tilt.x": TILT[0], "tilt.y": TILT[1]}
    film(tmp_path / "film.csv", scene_of(mesh, TRUTH, pulled(10 * tilted(LEVEL, TILT)) + more, run=LETS_GO), noise=1e-3)
    scene = scene_of(mesh, {**TRUTH, "young": 1.6e4}, pulled(10 * LEVEL) + more, run=LETS_GO)
    result = found_by(scene, [tmp_path / "film.csv"], parameters=["young", "tilt"])
    assert all(one.low < truth[one.parameter.name] < one.high for one in result.estimates)
    assert all(one.high - one.low < 0.3 for one in result.estimates[1:])  # degrees


def test_derivatives_of_a_model_are_those_of_the_full_order(mesh, tmp_path):
    scene = scene_of(mesh, {**TRUTH, "young": 1e5}, pulled(LEVEL), run=LETS_GO)
    file = film(tmp_path / "film.csv", scene)
    recording, h = Recording(scene, [read_markers(file, scene)], 0, tilting=True), 3e-3
    parameters, start = select_parameters(scene, ["tilt"], moving=True), values_of(scene, 1)
    q = np.array([0.03, -0.02])
    θ = values_at(start, parameters, q)
    J = recording.model_at(θ, silent).linearize(recording.experiment, θ, directions_at(start, parameters, q))[1]
    for column, step in zip(J.T, h * np.eye(2), strict=True):
        values = [values_at(start, parameters, q + side * step) for side in (1, -1)]
        after, before = (recording.answer_at(at, silent).predictions(recording.experiment, at) for at in values)
        difference = (after - before) / (2 * h)
        assert np.linalg.norm(column - difference) <= 1e-6 * np.linalg.norm(difference)


def test_tilt_needs_gravity_that_is_the_same_for_all(mesh, tmp_path):
    scene = scene_of(mesh, TRUTH, pulled(LEVEL), run=FALLS)
    file = film(tmp_path / "film.csv", scene)
    with pytest.raises(SceneError, match=r"no parameter 'tilt'.*tilt needs effects.gravity"):
        fr.identify(scene_of(mesh, TRUTH), [file], parameters=["tilt"])
    with pytest.raises(SceneError, match="use each name once"):
        fr.identify(scene, [file], parameters=["tilt", "tilt.y"])
    with pytest.raises(SceneError, match=r"no parameter 'tilt.z'; .* tilt, tilt.x, tilt.y, young"):
        fr.identify(scene, [file], parameters=["tilt.z"])
    other = scene_of(mesh, TRUTH, pulled(-LEVEL), run=FALLS)
    with pytest.raises(SceneError, match=r"effects.gravity is not that of .*as one tilt is sought"):
        fr.identify(scene, [file, read_markers(file, other)], parameters=["tilt"])
