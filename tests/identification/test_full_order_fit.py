"""Bodies that deform largely: a fit ends where one at full order does, with its intervals; materials and ranks."""

import numpy as np
import pytest
import scipy.optimize
from bodies import box_arrays, box_surfaces, write_arrays
from measuring import TRUTH, box_mesh, film, found_by, scene_of, text_of, write
from ranks import run_ranks

import fenics_rom as fr
from fenics_rom.identification.marker_data import read_markers
from fenics_rom.identification.parameters import values_at, values_of
from fenics_rom.identification.recording import Recording
from fenics_rom.identification.tilt import tilted
from fenics_rom.identification.uncertainty import interval_half_widths
from fenics_rom.identification.write import summary_lines
from fenics_rom.io.progress import silent
from fenics_rom.scene.file import parse_scene

BENDS = "large_deformation = {}"
HARD = 'dt = 0.02\nduration = 0.8\nload = [{ contact = "right", stop = 0.2, force = [0.0, 0.0, 160.0] }]'
FALLS = "dt = 0.02\nduration = 0.6"
DOWN, TILT = np.array([0.0, 0.0, -5.0]), np.array([3.0, -2.0])  # m/s2, degrees


def heavy(g):
    return f"{BENDS}\ngravity = {{ acceleration = {g.tolist()} }}"


def full_order_jacobian(scene, file, result, h=1e-3):
    """Central differences of full-order runs with respect to the q of all that was found, at the values found."""
    parameters, start = [one.parameter for one in result.found], values_of(scene, 1)
    q = np.array(
        [
            scipy.optimize.brentq(lambda q, one=one: one.parameter.value(q) - one.value, -3.0, 3.0, xtol=1e-14)
            for one in result.found
        ]
    )
    recording, columns = Recording(scene, [read_markers(file, scene)], 0), []
    for step in h * np.eye(len(q)):
        ends = [values_at(start, parameters, q + side * step) for side in (1, -1)]
        after, before = (recording.answer_at(θ, silent).predictions(recording.experiment, θ) for θ in ends)
        columns.append((after - before) / (2 * h))
    return np.column_stack(columns)


@pytest.mark.parametrize("sought", [("young", "tilt"), pytest.param(("young", "poisson"), marks=pytest.mark.slow)])
def test_a_fit_ends_where_full_order_squares_end_with_their_intervals(tmp_path, sought):
    """Where bodies deform largely a model's own derivatives are off: of a tilt, with few shapes to go by, by half."""
    mesh, tilts = box_mesh(tmp_path), "tilt" in sought
    run, start = (FALLS, heavy(DOWN)) if tilts else (HARD, BENDS)
    file = film(
        tmp_path / "film.csv", scene_of(mesh, TRUTH, heavy(tilted(DOWN, TILT)) if tilts else BENDS, run=run), noise=1e-3
    )
    scene = scene_of(mesh, {**TRUTH, "young": 1.7e4, **({} if tilts else {"poisson": 0.3})}, start, run=run)
    told = []
    result = found_by(scene, [file], parameters=sought, report=lambda *progress: told.append(progress))
    assert np.ptp(result.experiment.measured) > 0.2  # m, of a body of 1 m
    J, residual = full_order_jacobian(scene, file, result), result.experiment.measured - result.full
    widths = interval_half_widths(residual, J)
    assert (np.linalg.norm(result.jacobian - J, axis=0) <= 2e-3 * np.linalg.norm(J, axis=0)).all()
    assert interval_half_widths(residual, result.jacobian) == pytest.approx(widths, rel=2e-3)
    assert (np.abs(np.linalg.lstsq(J, residual, rcond=None)[0]) <= 0.03 * widths).all()
    assert result.full == pytest.approx(result.predicted, abs=1e-9)
    truth = {**TRUTH, "tilt.x": TILT[0], "tilt.y": TILT[1]}
    assert all(one.low < truth[one.parameter.name] < one.high for one in result.estimates)
    assert summary_lines(result)["intervals"] == "by differences of full-order runs"
    assert ("full-order derivatives", len(result.found), len(result.found)) in told


def two_materials(mesh, soft, hard, beta):
    """Text of a scene of a soft and a harder half, of which each has its own damping."""
    damping = f"alpha = 2.0, beta = 5e-3, materials.soft = {{ alpha = 1.0, beta = {beta!r} }}"
    parts = {
        "material": None,
        "materials.soft": f'young = {soft!r}\npoisson = 0.35\ndensity = 1200.0\ncells = "inner"',
        "materials.hard": f'young = {hard!r}\npoisson = 0.2\ndensity = 1500.0\ncells = "outer"',
        "effects": f"inertia = {{}}\ndamping = {{ {damping} }}\n{heavy(DOWN)}",
    }
    return text_of(mesh, TRUTH, run="dt = 0.02\nduration = 0.24", **parts)


@pytest.mark.slow
@pytest.mark.ranks
def test_several_materials_that_deform_largely_are_told_apart_on_two_ranks(tmp_path):
    points, cells = box_arrays((1.0, 0.4, 0.3), (2, 1, 1), shake=0.2)
    halves = {"inner": np.arange(6), "outer": np.arange(6, len(cells))}
    mesh = write_arrays(tmp_path / "two.msh", points, cells, box_surfaces(points, cells), halves)
    film(tmp_path / "film.csv", parse_scene(two_materials(mesh, 2e4, 6e4, 8e-3)))
    (tmp_path / "two.toml").write_text(two_materials(mesh, 2.4e4, 5e4, 6e-3))
    sought = "soft.young,hard.young,soft.beta"
    words = ["identify", "two.toml", "--data", "film.csv", "--parameters", sought, "-o", "found"]
    done = run_ranks(2, "-m", "fenics_rom", *words, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    found = fr.read_scene(tmp_path / "found" / "identified.toml")
    assert found.materials["soft"].young == pytest.approx(2e4, rel=1e-6)
    assert found.materials["hard"].young == pytest.approx(6e4, rel=1e-6)
    assert found.effects.damping.materials["soft"].beta == pytest.approx(8e-3, rel=1e-5)


OFF = [[1.0, 0.2, 0.4], [1.1, 0.2, 0.1]]  # m, above the tip and before it
AXES = ("x", "y", "z")


@pytest.mark.slow
def test_markers_off_a_body_that_bends_far_are_readings_that_turn_with_it(tmp_path):
    """From a motion and an equilibrium without noise."""
    mesh = box_mesh(tmp_path)
    parts = {f"readings.ball{k}": f'quantity = "marker"\npoint = {place}' for k, place in enumerate(OFF)}
    run = fr.simulate(scene_of(mesh, TRUTH, BENDS, run=HARD, **parts))
    seen = 1e3 * np.hstack([run.readings[f"ball{k}"].values for k in range(2)])[2::2]
    rows = np.column_stack([run.times[2::2], seen]).tolist()
    write(tmp_path / "film.csv", ["time (s)", *(f"ball{k}.{axis} (mm)" for k in range(2) for axis in AXES)], rows)
    still = 'dt = 0.1\nduration = 0.1\nload = [{ contact = "right", force = [0.0, 0.0, 90.0] }]'
    rest = fr.simulate(scene_of(mesh, TRUTH, run=still, **parts, effects=BENDS)).readings
    columns = [f"ball{k}.{axis} (m)" for k in range(2) for axis in AXES]
    seen = np.concatenate([rest[f"ball{k}"].values[-1] for k in range(2)]).tolist()
    write(tmp_path / "rest.csv", ["contact", "force.z (N)", *columns], [["right", 90.0, *seen]])
    files, start = [tmp_path / "film.csv", tmp_path / "rest.csv"], {**TRUTH, "young": 1.8e4}
    result = found_by(scene_of(mesh, start, BENDS, run=HARD, **parts), files, parameters=["young"])
    assert result.values["young"] == pytest.approx(TRUTH["young"], rel=1e-6)


@pytest.mark.parametrize("name", ["balls", "ball"])
def test_markers_off_a_linear_body_are_outputs_or_readings(tmp_path, name):
    """Of an output of several each counts as itself."""
    mesh = box_mesh(tmp_path)
    outputs = {"outputs.balls": f"markers = {OFF}"}
    parts = outputs if name == "balls" else {"readings.ball": f'quantity = "marker"\npoint = {OFF[1]}'}
    run = fr.simulate(scene_of(mesh, TRUTH, **outputs))
    label = "balls[1]" if name == "balls" else "ball"
    rows = np.column_stack([run.times[2::2], 1e3 * run.outputs["balls"][2::2, 1]]).tolist()
    write(tmp_path / "film.csv", ["time (s)", *(f"{label}.{axis} (mm)" for axis in AXES)], rows)
    result = found_by(
        scene_of(mesh, {**TRUTH, "young": 1.6e4}, **parts), [tmp_path / "film.csv"], parameters=["young", "beta"]
    )
    assert result.values == pytest.approx({"young": TRUTH["young"], "beta": TRUTH["beta"]}, rel=1e-6)
