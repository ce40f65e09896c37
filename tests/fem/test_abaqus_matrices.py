"""Matrices that Abaqus has written, beside the input file they are of.

The rotor is that of Exudyn's test `compareAbaqusAnsysRotorEigenfrequencies` (J. Gerstmayr, S. Holzinger; BSD licence):
115 nodes, 48 C3D8, free. It is made here anew from its dimensions, with the element that Abaqus' manual describes, and
its first frequency is the one which that test states for the matrices that Abaqus wrote.
"""

import numpy as np
import pytest
import scipy.io
import scipy.linalg
import scipy.sparse

import fenics_rom as fr
from fenics_rom.cli.main import main
from fenics_rom.errors import FenicsRomError
from fenics_rom.fem.abaqus_matrices import EDGES

FREQUENCY = 104.6370132606291  # Hz, as stated there; Young's modulus is 2.1e9 Pa
CORNERS = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
NATURAL = np.vstack([np.column_stack([CORNERS, np.full(4, ζ)]) for ζ in (-1, 1)])  # of C3D8


def rotor_mesh():
    """Points (115, 3), m, and bricks (48, 8): a square shaft, and a disc around it."""
    shaft = 0.05 * np.array([-1.0, 0.0, 1.0])
    squares = [(shaft[i], shaft[j], shaft[i + 1], shaft[j + 1]) for i in (0, 1) for j in (0, 1)]
    bricks = [
        [(x, y, z) for z in (0.05 * k, 0.05 * k + 0.05) for x, y in ((a, b), (c, b), (c, d), (a, d))]
        for k in range(10)
        for a, b, c, d in squares
    ]
    turns = np.array([(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)])
    rim = turns * np.where(turns.all(axis=1), 0.138581932, 0.195984438)[:, None]
    for k in range(8):
        section = [0.05 * turns[k], rim[k], rim[(k + 1) % 8], 0.05 * turns[(k + 1) % 8]]
        bricks.append([(x, y, z) for z in (0.1, 0.15) for x, y in section])
    corners = np.array(bricks).reshape(-1, 3)
    points, cells = np.unique(np.round(corners, 9), axis=0, return_inverse=True)
    return points.astype(np.float32).astype(float), cells.reshape(-1, 8)


def brick_matrices(points, cells, young=2.1e9, poisson=0.3, density=7850.0):
    """M, lumped by the sums of its rows, and K, with the mean dilatation of each brick."""
    size = 3 * len(points)
    M, K = np.zeros((size, size)), np.zeros((size, size))
    λ, μ = young * poisson / ((1 + poisson) * (1 - 2 * poisson)), young / (2 * (1 + poisson))
    C = np.diag([2 * μ, 2 * μ, 2 * μ, μ, μ, μ])
    C[:3, :3] += λ
    for cell in cells:
        gauss = []
        for place in NATURAL / np.sqrt(3):
            factors = 1 + NATURAL * place
            slopes = np.stack([NATURAL[:, i] * np.delete(factors, i, 1).prod(axis=1) for i in range(3)], axis=1) / 8
            J = slopes.T @ points[cell]
            gauss.append((factors.prod(axis=1) / 8, slopes @ np.linalg.inv(J).T, np.linalg.det(J)))
        volume = sum(weight for *_, weight in gauss)
        mean = sum(weight * gradient for _, gradient, weight in gauss) / volume
        at = (3 * cell[:, None] + np.arange(3)).ravel()
        for shape, (gx, gy, gz), weight, gradient in ((s, g.T, w, g) for s, g, w in gauss):
            o = 0 * gx
            rows = [(gx, o, o), (o, gy, o), (o, o, gz), (gy, gx, o), (gz, o, gx), (o, gz, gy)]
            B = np.array([np.stack(row, axis=1).ravel() for row in rows])
            B[:3] += ((mean - gradient) / 3).ravel()
            K[np.ix_(at, at)] += weight * B.T @ C @ B
            M[at, at] += density * weight * np.repeat(shape, 3)
    return M, K


def write_inp(file, points, cells, kind="C3D8"):
    """As Abaqus/CAE does, with nine digits."""
    nodes = "\n".join(f"{n}, {x:.9g}, {y:.9g}, {z:.9g}" for n, (x, y, z) in enumerate(points, 1))
    bricks = "\n".join(f"{e}, {', '.join(str(n + 1) for n in cell)}" for e, cell in enumerate(cells, 1))
    ends = [n for n, z in enumerate(points[:, 2], 1) if z == points[:, 2].max()]
    sets = f"*Nset, nset=End, instance=rotor-1\n {', '.join(map(str, ends))}\n*Nset, nset=Middle\n 58,"
    file.write_text(f"*Heading\n*Node\n{nodes}\n*Element, type={kind}\n{bricks}\n{sets}\n")


def write_matrix(file, A, style):
    """One half in MATRIX INPUT, both or one in COORDINATE."""
    rows, columns = np.nonzero(A)
    kept = rows >= columns if style != "both" else rows >= 0
    with file.open("w") as stream:
        for i, j in zip(rows[kept], columns[kept], strict=True):
            of_row, of_column = (
                (f"{i // 3 + 1},{i % 3 + 1}", f" {j // 3 + 1},{j % 3 + 1}, ")
                if style == "labels"
                else (f"{i + 1}", f" {j + 1} ")
            )
            stream.write(f"{of_row}{',' if style == 'labels' else ''}{of_column}{A[i, j]: .15e}\n")


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
    "four.mtx": ("1, 1, 1, 1\n", "four.mtx: has 4 numbers in a line; allowed are node, degree of freedom"),
    "market.mtx": ("%%MatrixMarket matrix coordinate real general\n1 1 1\n1 1 1\n", "cannot be read as a matrix"),
    "half.mtx": (LINE + "1.5,1, 1,1, 1.0\n", "half.mtx: holds nodes or rows that are no whole numbers"),
    "nan.mtx": (LINE + "2,1, 1,1, nan\n", "or entries that are not finite"),
    "twice.mtx": (LINE + LINE, "twice.mtx: has row 1, column 1 twice"),
    "held.mtx": (LINE.replace("1.0", "1.0e36"), "held.mtx: holds 1 degrees of freedom, row 1 for one"),
    "shell.mtx": (LINE + "1,6, 1,6, 1.0\n", "shell.mtx: has degree of freedom 6; allowed are 1, 2 and 3"),
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
    with pytest.raises(FenicsRomError, match=r"units = 'mm-t-s': allowed is with nodes of Abaqus' input file"):
        fr.read_system(**market, units="mm-t-s")
