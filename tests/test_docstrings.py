"""What a REPL shows of the package: examples in the help that run, what an object is, and the public names alone."""

import doctest
import inspect
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from bodies import PLATE

import fenics_rom as fr
from fenics_rom.scene.reference import WORLD_EXAMPLE

PUBLIC = [getattr(fr, name) for name in fr.__all__ if not hasattr(fr.errors, name) and name != "errors"]
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


@pytest.fixture(scope="module")
def folder(tmp_path_factory, plate_system, plate_rom):
    """Files that examples name: the plate's scene, ROM, run and matrices, and its tip at rest under known forces."""
    place = tmp_path_factory.mktemp("examples")
    mesh = PLATE.parents[2] / "meshes" / "plate.msh"
    shutil.copy(mesh, place)
    (place / "plate.toml").write_text(PLATE.read_text().replace("../../meshes/", ""))
    large = '\n[effects.large_deformation]\nmaterial = "yeoh"\nconstants = [1.0]\n'
    (place / "rubber.toml").write_text((place / "plate.toml").read_text() + large)
    rows = [f"{x},{0.4 * (x - x**-2)},{0.4 * (x - x**-3)}" for x in (1.2, 1.5, 2.0)]
    (place / "rubber.csv").write_text("\n".join(["stretch,uniaxial (MPa),planar (MPa)", *rows]) + "\n")
    shutil.copy(WORLD_EXAMPLE, place / "stack.toml")
    for name in ("arm.urdf", "plate.obj"):
        shutil.copy(Path(__file__).parent / "data" / "robots" / name, place)
    fr.write_rom(place / "plate.h5", plate_rom)
    fr.write_trajectory(place / "run.h5", fr.simulate(plate_rom, dt=0.01))
    s = plate_system
    K, B, C = s.stiffness @ np.eye(s.size), s.contacts["tip_left"], s.outputs["tip"]
    for name, matrix in (("M", s.mass @ np.eye(s.size)), ("K", K), ("B", B)):
        scipy.io.mmwrite(place / f"{name}.mtx", (matrix + matrix.T) / 2 if name != "B" else matrix)
    rows = [[0.0, 0.0, force, *(C.T @ np.linalg.solve(K, force * B[:, 2]))] for force in (0.1, 0.2, 0.3)]
    heading = ["contact", *(f"force.{axis} (N)" for axis in "xyz")]
    heading += [f"tip[{point}].{axis} (m)" for point in (0, 1) for axis in "xyz"]
    lines = [",".join(["tip_left", *map(repr, map(float, row))]) for row in rows]
    (place / "markers.csv").write_text("\n".join([",".join(heading), *lines]) + "\n")
    return place


@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")  # the plate locks
@pytest.mark.parametrize("public", PUBLIC, ids=lambda public: public.__name__)
def test_example_of_every_public_name_runs(public, folder, monkeypatch, plate_system, plate_rom, small_zoo):
    monkeypatch.chdir(folder)
    names = {
        "fr": fr,
        "np": np,
        "scene": fr.read_scene("plate.toml"),
        "system": plate_system,
        "rom": plate_rom,
        "run": fr.read_trajectory("run.h5"),
    }
    name = f"fenics_rom.{public.__name__}"
    example = doctest.DocTestParser().get_doctest(inspect.getdoc(public), names, name, None, 0)
    assert example.examples
    said = []
    doctest.DocTestRunner(optionflags=FLAGS).run(example, out=said.append)
    assert "".join(said) == ""


def test_an_object_says_what_it_is(plate_rom):
    body, bodies = fr.Simulator(plate_rom, dt=1e-3), fr.Batch(plate_rom, size=8, dt=1e-3)
    body.step([0.0, 0.0, 0.5])
    for shown, expected in (
        (
            plate_rom,
            """\
Rom 'plate': balanced, energy switching, 180 displacements of 66 nodes
  contact modes: tip_left (order 20, 3 inputs), middle (order 20, 3 inputs); inputs in N
  effects: inertia, damping; outputs: tip""",
        ),
        (plate_rom.contact_models["middle"], "ContactModel: order 20, 3 input columns, from 1.01 Hz"),
        (
            body,
            """\
Simulator of 'plate': contact mode tip_left (order 20), dt = 0.001 s, 1 step taken, midpoint
  input: 3 of the contact in N""",
        ),
        (
            bodies,
            """\
Batch of 8 bodies of 'plate': dt = 0.001 s, 0 steps taken, float64
  contact modes: tip_left (order 20), middle (order 20)""",
        ),
        (
            fr.simulate(plate_rom, dt=0.01),
            """\
Trajectory 'plate': reduced (order 20), 300 steps of 0.01 s, contact modes tip_left, middle
  outputs: tip (2 points); inputs: tip_left; effects: inertia, damping; 100 snapshots of 66 nodes""",
        ),
    ):
        assert repr(shown) == expected


def test_only_public_names_are_listed():
    run = subprocess.run([sys.executable, "-c", "import fenics_rom; print(*dir(fenics_rom))"], capture_output=True)
    names = run.stdout.decode().split()
    assert [name for name in names if not name.startswith("__")] == sorted(fr.__all__)
    assert {"__all__", "__doc__", "__version__"} <= set(names)
    assert all(public.__doc__ for public in PUBLIC)
