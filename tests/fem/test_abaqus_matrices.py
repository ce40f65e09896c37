"""Matrices that Abaqus has written, beside the input file they are of.

The rotor is that of demos/own_matrices, whose first frequency Exudyn's tests state for the matrices that Abaqus wrote.
"""

import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.linalg
import scipy.sparse

import fenics_rom as fr
from fenics_rom.cli.main import main
from fenics_rom.errors import FenicsRomError
from fenics_rom.fem.abaqus_matrices import EDGES

sys.path.append(str(Path(__file__).parents[2] / "demos" / "own_matrices"))

from abaqus_rotor import FREQUENCY, NATURAL, brick_matrices, rotor_mesh, write_inp, write_matrix


@pytest.fixture(scope="module")
def rotor():
    points, cells = rotor_mesh()
    return points, cells, *brick_matrices(points, cells)


@pytest.fixture
def files(rotor, tmp_path, monkeypatch):
    """Works beside the files of the rotor, and gives what to read them with."""
    monkeypatch.chdir(tmp_path)
    points, cells, M, K = rotor
    write_inp(tmp_path / "rotor.inp", points, cells)
    for name, matrix in (("rotor_MASS1.mtx", M), ("rotor_STIF1.mtx", K)):
        write_matrix(tmp_path / name, matrix, "labels")
    return {
        **{"mass": "rotor_MASS1.mtx", "stiffness": "rotor_STIF1.mtx", "nodes": "rotor.inp", "rayleigh": (0.0, 1e-5)},
        **{"contacts": {"end": "End"}, "outputs": {"middle": "Middle"}},
    }


def first_frequency(system):
    """Of what strains it, Hz."""
    K, M = system.stiffness.toarray(), system.mass.toarray()
    return np.sqrt(scipy.linalg.eigvalsh(K, M, subset_by_index=[6, 6])[0]) / (2 * np.pi)


@pytest.mark.parametrize("style", ["labels", "both", "half"])
def test_free_rotor_has_the_frequency_that_its_source_states(rotor, files, tmp_path, style):
    points, _, M, K = rotor
    write_matrix(tmp_path / files["mass"], M, style)
    write_matrix(tmp_path / files["stiffness"], K, style)
    system = fr.read_system(**files)
    assert system.size == 345
    assert system.rigid.shape[1] == 6
    assert first_frequency(system) == pytest.approx(FREQUENCY, rel=1e-6)
    np.testing.assert_allclose(system.body.nodes, points, atol=1e-9)


def test_rotor_has_a_closed_surface_and_columns_of_its_sets(rotor, files):
    points, _, M, _ = rotor
    system = fr.read_system(**files)
    a, b, c = system.body.nodes[system.body.triangles].transpose(1, 0, 2)
    mass = M[::3, ::3].sum()
    assert np.einsum("fi,fi->", a, np.cross(b, c)) / 6 == pytest.approx(mass / 7850, rel=1e-8)
    assert np.abs(np.cross(b - a, c - a).sum(axis=0)).max() <= 1e-15
    end = system.contacts["end"].reshape(-1, 3, 3)
    np.testing.assert_allclose(end.sum(axis=0), np.eye(3), atol=1e-15)
    np.testing.assert_array_equal(np.flatnonzero(end.any(axis=(1, 2))), np.flatnonzero(points[:, 2] == 0.5))
    assert system.outputs["middle"][3 * 57, 0] == 1


SOLIDS = {  # of a unit cube, or half of one
    "C3D4": (1 / 6, [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]),
    "C3D6": (1 / 2, [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (0, 1, 1)]),
    "C3D8R": (1.0, ((NATURAL + 1) / 2).tolist()),
}
MIDDLES = {"C3D4": "C3D10", "C3D6": "C3D15", "C3D8R": "C3D20"}


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("kind", SOLIDS)
def test_surface_of_any_solid_is_outward_and_goes_through_its_nodes(tmp_path, kind, order):
    volume, corners = SOLIDS[kind]
    points = np.array(corners, dtype=float)
    if order == 2:
        points = np.concatenate([points, [points[list(edge)].mean(axis=0) for edge in EDGES[len(corners)]]])
        kind = MIDDLES[kind]
    write_inp(tmp_path / "solid.inp", points, [np.arange(len(points))], kind)
    write_matrix(tmp_path / "M.mtx", np.eye(3 * len(points)), "both")
    read = dict.fromkeys(("mass", "stiffness"), tmp_path / "M.mtx")
    given = {"nodes": tmp_path / "solid.inp", "rayleigh": (0.0, 1.0), "contacts": {"end": "End"}}
    body = fr.read_system(**read, **given).body
    a, b, c = body.nodes[body.triangles].transpose(1, 0, 2)
    assert np.einsum("fi,fi->", a, np.cross(b, c)) / 6 == pytest.approx(volume, rel=1e-8)
    assert set(body.triangles.ravel()) == set(range(len(points)))


def test_millimetres_and_tonnes_are_the_same_body(rotor, files, tmp_path):
    points, cells, M, K = rotor
    metres = fr.read_system(**files)
    write_inp(tmp_path / "rotor.inp", 1e3 * points, cells)
    write_matrix(tmp_path / files["mass"], 1e-3 * M, "labels")
    write_matrix(tmp_path / files["stiffness"], 1e-3 * K, "labels")
    system = fr.read_system(**files, units="mm-t-s")
    np.testing.assert_allclose(system.body.nodes, metres.body.nodes, atol=1e-9)
    assert abs(system.mass - metres.mass).max() <= 1e-12 * abs(metres.mass).max()
    assert abs(system.stiffness - metres.stiffness).max() <= 1e-12 * abs(metres.stiffness).max()


def test_rotor_is_reduced_on_the_command_line(files, capfd):
    options = ("--mass", files["mass"], "--stiffness", files["stiffness"], "--rayleigh", "0", "1e-5")
    with pytest.raises(SystemExit) as end:
        main(["reduce", *options, "--nodes", "rotor.inp", "--contact", "end=End", "--order", "8", "-o", "rom.h5"])
    out, err = capfd.readouterr()
    assert (end.value.code, err) == (0, "")
    assert "0.392 x 0.392 x 0.5 m" in out.replace("×", "x")
    rom = fr.read_rom("rom.h5")
    assert rom.rigid == 6
    assert len(rom.triangles)


LINE = "1,1, 1,1, 1.0\n"
BAD = {
    "no-such.mtx": (None, "no-such.mtx: cannot be read: No such file"),
    "words.mtx": ("1,1, 1,one, 1.0\n", "words.mtx: cannot be read as a matrix of Abaqus"),
    "empty.mtx": ("** nothing\n", "empty.mtx: holds no entries"),
    "ragged.mtx": (LINE + "1, 1, 1, 1\n", "ragged.mtx: cannot be read as a matrix of Abaqus"),
    "four.mtx": ("1, 1, 1, 1\n", "four.mtx: has 4 numbers in a line; use node, degree of freedom"),
    "market.mtx": ("%%MatrixMarket matrix coordinate real general\n1 1 1\n1 1 1\n", "cannot be read as a matrix"),
    "half.mtx": (LINE + "1.5,1, 1,1, 1.0\n", "half.mtx: holds nodes or rows that are no whole numbers"),
    "nan.mtx": (LINE + "2,1, 1,1, nan\n", "or entries that are not finite"),
    "twice.mtx": (LINE + LINE, "twice.mtx: has row 1, column 1 twice"),
    "held.mtx": (LINE.replace("1.0", "1.0e36"), "held.mtx: holds 1 degrees of freedom, row 1 for one"),
    "shell.mtx": (LINE + "1,6, 1,6, 1.0\n", "shell.mtx: has degree of freedom 6; use 1, 2 or 3"),
    "other.mtx": (LINE + "400,1, 1,1, 1.0\n", "other.mtx: names nodes that rotor.inp does not hold, 400"),
    "own.mtx": (LINE + "-1,1, 1,1, 1.0\n", "own.mtx: names nodes that rotor.inp does not hold, -1 for one"),
    "small.mtx": ("1 1 1.0\n12 12 1.0\n", "rotor.inp: has 115 nodes of solids and 115 in all, but the matrices have"),
    "zero.mtx": ("0 0 1.0\n345 345 1.0\n", "zero.mtx: rows and columns count from 1"),
}


@pytest.mark.parametrize("name", BAD)
def test_matrices_that_cannot_be_used_are_told(files, tmp_path, name):
    text, said = BAD[name]
    if text is not None:
        (tmp_path / name).write_text(text)
    one_format = {} if name not in ("small.mtx", "zero.mtx") else {"stiffness": name}
    with pytest.raises(FenicsRomError) as caught:
        fr.read_system(**files | {"mass": name} | one_format)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_sets_and_units_that_are_not_there_are_told(files):
    with pytest.raises(FenicsRomError, match=r"contacts\['end'\]: no set of nodes 'Ende'; there is End, Middle"):
        fr.read_system(**files | {"contacts": {"end": "Ende"}})
    with pytest.raises(FenicsRomError, match=r"units: no system of units 'mm'; there is m-kg-s, mm-t-s"):
        fr.read_system(**files, units="mm")
    scipy.io.mmwrite("I.mtx", scipy.sparse.identity(3))
    market = {"mass": "I.mtx", "stiffness": "I.mtx", "rayleigh": (0.0, 1.0), "contacts": {"all": "I.mtx"}}
    with pytest.raises(FenicsRomError, match=r"units = 'mm-t-s': use it with nodes of Abaqus' input file"):
        fr.read_system(**market, units="mm-t-s")
