"""Data of another unit, sign or axis than the scene predicts are refused before a fit begins; honest data are not."""

import csv

import numpy as np
import pytest
from measuring import PUSHES, START, TRUTH, film, scene_of, weigh, write

from fenics_rom.errors import DataError
from fenics_rom.identification.affine import AffineSystem
from fenics_rom.identification.agreement import check_agreement
from fenics_rom.identification.experiment import Experiments, make_experiment
from fenics_rom.identification.fit import FitProblem
from fenics_rom.identification.marker_data import read_markers
from fenics_rom.identification.parameters import select_parameters, values_of
from fenics_rom.identification.recording import JointModel
from fenics_rom.identification.reduced_model import ReducedModel


@pytest.fixture(scope="module")
def files(mesh, tmp_path_factory):
    folder, truth = tmp_path_factory.mktemp("data"), scene_of(mesh, TRUTH)
    noisy = film(folder / "motion.csv", truth, noise=1e-4)
    return {"motion": noisy, "rest": weigh(folder / "rest.csv", truth, PUSHES)}


@pytest.fixture(scope="module")
def affine(mesh):
    return AffineSystem(scene_of(mesh, START))


def check(file, mesh, affine, values=START, parameters=None):
    """Looks at a file, on the full basis, from start values."""
    scene = scene_of(mesh, values)
    data = read_markers(file, scene)
    experiment = Experiments((make_experiment(scene, [data], affine.plain),))
    model = JointModel((ReducedModel(affine.parts(np.eye(affine.plain.size))),))
    late = [("motion.csv", 0.02)]
    sought = select_parameters(scene, parameters, moving=True, clocks=late if parameters else ())
    problem = FitProblem(values_of(scene, 1), sought, experiment, lambda θ: model, affine.plain.algebra.comm)
    check_agreement(problem, model)


def changed(file, folder, change):
    """The same file with displacements (columns by name) changed."""
    with file.open(newline="") as stream:
        heading, *rows = list(csv.reader(stream))
    columns = {name: [row[k] for row in rows] for k, name in enumerate(heading)}
    columns = change(columns)
    write(folder / file.name, list(columns), [list(row) for row in zip(*columns.values(), strict=True)])
    return folder / file.name


def scaled(which, factor):
    """A change: columns whose names hold some text, times a factor."""
    return lambda columns: {
        name: [float(cell) * factor for cell in cells] if which in name and "time" not in name else cells
        for name, cells in columns.items()
    }


def headed(names):
    """A change: columns whose axes have other names."""
    return lambda columns: {
        (name.translate(str.maketrans(*names)) if "." in name and "force" not in name else name): cells
        for name, cells in columns.items()
    }


@pytest.mark.parametrize("kind", ["motion", "rest"])
@pytest.mark.parametrize("young", [1.0, 1 / 30, 30.0])
def test_honest_data_pass_from_moduli_thirty_times_off(mesh, files, affine, kind, young):
    check(files[kind], mesh, affine, {**START, "young": young * TRUTH["young"]})


def test_a_load_that_is_some_degrees_off_is_honest(mesh, affine, tmp_path):
    """By 14 degrees: what it does along the weak axis has the other sign."""
    truth = scene_of(mesh, TRUTH)
    pushed = weigh(tmp_path / "pushed.csv", truth, [("right", (0.0, 0.25, 2.0)), ("right", (0.0, 0.5, 4.0))])
    check(changed(pushed, tmp_path, lambda c: {**c, "force.y (N)": [-0.25, -0.5]}), mesh, affine)


@pytest.mark.parametrize("kind", ["motion", "rest"])
@pytest.mark.parametrize("young", [1.0, 8.0])
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (scaled("(m", 1e3), r"its displacements measure .*e\+0[34] times .* mm are written under a heading in m\."),
        (scaled("(m", 1e-3), r"its displacements measure 0\.00\d+ times .* m are written under a heading in mm\."),
        (scaled("(m", -1.0), r"seems that the sign of x and y and z is turned \(a factor of -1\): so read"),
        (scaled(".z (m", -1.0), r"seems that the sign of z is turned \(a factor of -1\): so read"),
        (headed(("yz", "zy")), r"seems that y is the scene's z, z is the scene's y: so read"),
    ],
)
def test_units_signs_and_axes_are_told(mesh, files, affine, tmp_path, kind, young, change, message):
    file, start = changed(files[kind], tmp_path, change), {**TRUTH, "young": TRUTH["young"] * young}
    with pytest.raises(DataError, match=rf"{kind}.csv: .*{message}"):
        check(file, mesh, affine, start)


def test_one_column_is_named(mesh, files, affine, tmp_path):
    with pytest.raises(DataError, match=r"along z, tip\[1\]\.z measure 1e\+03 times"):
        check(changed(files["rest"], tmp_path, scaled("tip[1].z", 1e3)), mesh, affine, TRUTH)
    with pytest.raises(DataError, match=r"the sign of tip\[1\]\.z is turned"):
        check(changed(files["motion"], tmp_path, scaled("tip[1].z", -1.0)), mesh, affine, TRUTH)


def test_an_axis_that_no_column_is_of_is_found(mesh, files, affine, tmp_path):
    """Columns of z alone, called y: under these forces one is at rest where the other moves."""

    def alone(columns):
        kept = {name: cells for name, cells in columns.items() if "tip" not in name or ".z" in name}
        return {name.replace(".z", ".y") if "tip" in name else name: cells for name, cells in kept.items()}

    with pytest.raises(DataError, match="seems that y is the scene's z"):
        check(changed(files["rest"], tmp_path, alone), mesh, affine, TRUTH)


def test_a_late_clock_may_turn_a_motion(mesh, files, affine, tmp_path):
    turned = changed(files["motion"], tmp_path, scaled("(mm)", -1.0))
    check(turned, mesh, affine, TRUTH, ["young", "clock"])
