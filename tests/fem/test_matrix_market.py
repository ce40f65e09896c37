"""Matrix Market files on the command line: the model of their matrices, and what is refused."""

import re

import numpy as np
import pytest
import scipy.io
import scipy.sparse
from ranks import run_ranks

import fenics_rom as fr
from fenics_rom.cli.main import main
from fenics_rom.errors import StructureError

SIZE = 31
MATRICES = ("--mass", "M.mtx", "--damping", "D.mtx", "--stiffness", "K.mtx")
BANNER = "%%MatrixMarket matrix coordinate real general\n"
FREE = (
    BANNER.replace("general", "symmetric")
    + "31 31 61\n"
    + "".join(f"{k} {k} {1 if k in (1, 31) else 2}\n" for k in range(1, 32))
)
FREE += "".join(f"{k + 1} {k} -1\n" for k in range(1, 31))


def chain():
    """Masses between springs, two of them with dashpots to the ground."""
    K = scipy.sparse.diags([-np.ones(SIZE - 1), 2 * np.ones(SIZE), -np.ones(SIZE - 1)], [-1, 0, 1]).tocsr()
    M = scipy.sparse.diags(1 + np.arange(SIZE) / SIZE).tocsr()
    return M, 0.1 * M + 0.05 * K + scipy.sparse.diags(1.0 * (np.arange(SIZE) % 13 == 0)).tocsr(), K


ENDS, MIDDLE, MEANS = np.eye(SIZE)[:, [0, -1]], np.eye(SIZE)[:, [15]], np.ones((SIZE, 2)) / SIZE


def written(folder):
    """The chain in files of every form: symmetric, general, dense, whole numbers."""
    M, D, K = chain()
    scipy.io.mmwrite(folder / "M.mtx", M, symmetry="symmetric")
    scipy.io.mmwrite(folder / "D.mtx", D, symmetry="general")
    scipy.io.mmwrite(folder / "K.mtx", K.astype(int), symmetry="symmetric")
    scipy.io.mmwrite(folder / "ends.mtx", scipy.sparse.coo_matrix(ENDS))
    scipy.io.mmwrite(folder / "middle.mtx", MIDDLE)
    scipy.io.mmwrite(folder / "means.mtx", MEANS)
    return folder


@pytest.fixture
def inside(tmp_path, monkeypatch):
    """Works in a folder with the chain's files."""
    monkeypatch.chdir(tmp_path)
    return written(tmp_path)


@pytest.fixture
def say(capfd):
    """Runs `reduce` in this process: its exit status and what it printed."""

    def run(*arguments):
        with pytest.raises(SystemExit) as end:
            main(["reduce", *map(str, arguments), "-o", "rom.h5"])
        return end.value.code, *capfd.readouterr()

    return run


def of_memory(**parts):
    M, D, K = chain()
    given = {"mass": M, "damping": D, "stiffness": K, "contacts": {"ends": ENDS}}
    return fr.System(**given | parts)


def hankel(rom, contact="ends"):
    return rom.contact_models[contact].hankel_singular_values[:8]


def test_files_are_the_model_of_their_matrices(inside, say, capfd):
    status, out, err = say(
        *(*MATRICES, "--contact", "ends=ends.mtx", "--contact", "middle=middle.mtx", "--actuator", "pull=ends.mtx"),
        *("--observe", "mean=means.mtx", "--order", "8", "--weighting", "outputs"),
    )
    assert (status, err) == (0, "")
    assert "31 displacements, 0 nodes" in out
    rom = fr.read_rom("rom.h5")
    system = of_memory(contacts={"ends": ENDS, "middle": MIDDLE}, actuators={"pull": ENDS}, outputs={"mean": MEANS})
    expected = fr.reduce(system, order=8, weighting="outputs")
    assert rom.contacts == {"ends": 2, "middle": 1}
    assert rom.actuators == {"pull": 2}
    assert rom.outputs["mean"].shape[0] == 2
    for name in ("ends", "middle"):
        np.testing.assert_allclose(hankel(rom, name), hankel(expected, name), rtol=1e-9)
    with pytest.raises(SystemExit) as end:
        main(["info", "rom.h5"])
    assert (end.value.code, *capfd.readouterr()) == (0, out, "")


def test_rayleigh_in_place_of_a_file(inside, say):
    options = ("--mass", "M.mtx", "--stiffness", "K.mtx", "--rayleigh", "0.1", "0.05", "--contact", "ends=ends.mtx")
    assert say(*options, "--order", "8")[0] == 0
    M, _, K = chain()
    expected = fr.reduce(of_memory(damping=0.1 * M + 0.05 * K), order=8)
    np.testing.assert_allclose(hankel(fr.read_rom("rom.h5")), hankel(expected), rtol=1e-9)
    assert fr.read_rom("rom.h5").contact_models["ends"].damping.ndim == 1


MASSES = np.array([1.0, 2.0, 3.0, 4.0])


def truss():
    """Writes the files of four masses with springs between all of them; what to give, and where they are, m."""
    X = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    i, j = np.triu_indices(4, 1)
    along = (X[i] - X[j]) / np.linalg.norm(X[i] - X[j], axis=1)[:, None]
    stretch = np.zeros((6, 4, 3))
    stretch[np.arange(6), i], stretch[np.arange(6), j] = along, -along
    matrices = {"K": stretch.reshape(6, 12).T @ stretch.reshape(6, 12), "M": np.diag(np.repeat(MASSES, 3))}
    for name, matrix in matrices.items():
        scipy.io.mmwrite(f"{name}.mtx", scipy.sparse.coo_matrix(matrix))
    scipy.io.mmwrite("B.mtx", np.eye(12)[:, [1]])
    np.savetxt("X.csv", 1e3 * X, delimiter=",", header="x (mm), y (mm), z (mm)", comments="")
    given = ("--mass", "M.mtx", "--stiffness", "K.mtx", "--rayleigh", "0.1", "0.05", "--contact", "tip=B.mtx")
    return given, X


def test_free_body_of_files_and_its_nodes(inside, say):
    """Of the chain with both ends free, and of a frame of four nodes between springs in the three directions."""
    (inside / "K.mtx").write_text(FREE)
    assert say(*MATRICES, "--contact", "middle=middle.mtx", "--order", "8")[0] == 0
    assert fr.read_rom("rom.h5").rigid == 1
    given, X = truss()
    assert say(*given, "--nodes", "X.csv", "--frame", "moving", "--order", "4")[0] == 0
    rom = fr.read_rom("rom.h5")
    assert rom.rigid == 6
    np.testing.assert_allclose(rom.nodes, X)
    np.testing.assert_allclose(rom.moving_frame.origin, [0.2, 0.3, 0.4])
    np.savetxt("X.csv", X[:3], delimiter=",", header="x, y, z", comments="")
    assert "X.csv: nodes has shape (3, 3); use (4, 3)" in say(*given, "--nodes", "X.csv")[2]
    np.savetxt("X.csv", X, delimiter=",", header="x, y, w", comments="")
    assert "X.csv, line 1: has columns x, y, w; use x, y and z" in say(*given, "--nodes", "X.csv")[2]
    assert "nodes are needed" in say(*given, "--frame", "moving")[2]


@pytest.mark.ranks
def test_two_ranks_find_what_a_stiffness_does_not_see(inside):
    (inside / "K.mtx").write_text(FREE)
    run = reduce_on_two(*MATRICES, "--contact", "middle=middle.mtx", "--order", "8")
    assert run.returncode == 0, run.stderr
    assert fr.read_rom("rom.h5").rigid == 1


@pytest.mark.ranks
def test_two_ranks_have_whole_nodes_of_a_body_in_a_moving_frame(inside):
    given, X = truss()
    run = reduce_on_two(*given, "--nodes", "X.csv", "--frame", "moving", "--order", "4")
    assert run.returncode == 0, run.stderr
    np.testing.assert_allclose(fr.read_rom("rom.h5").moving_frame.origin, MASSES @ X / MASSES.sum())


@pytest.mark.slow
@pytest.mark.ranks
def test_two_ranks_spread_the_rows(inside):
    run = reduce_on_two(*MATRICES, "--contact", "ends=ends.mtx", "--order", "8")
    assert run.returncode == 0, run.stderr
    assert run.stdout.count("ROM system: rom.h5") == 1
    np.testing.assert_allclose(hankel(fr.read_rom("rom.h5")), hankel(fr.reduce(of_memory(), order=8)), rtol=1e-9)


def reduce_on_two(*arguments):
    return run_ranks(2, "-m", "fenics_rom", "reduce", *arguments, "-o", "rom.h5")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("no matrix", "K.mtx: is not a Matrix Market file"),
        (BANNER + "31 31 1\n1 1 -2.0\n", "K.mtx: stiffness is not positive definite: mumps could not factor"),
    ],
)
@pytest.mark.ranks
def test_two_ranks_say_once_what_is_wrong_and_end(inside, content, said):
    """Also that it is PETSc's matrix that is reduced then."""
    (inside / "K.mtx").write_text(content)
    run = reduce_on_two(*MATRICES, "--contact", "ends=ends.mtx")
    assert run.returncode == 1
    (line,) = (line for line in run.stderr.splitlines() if "fenics-rom: error:" in line)
    assert said in line
    assert "Traceback" not in run.stderr


@pytest.mark.parametrize(
    ("file", "content", "said"),
    [
        ("K.mtx", "mass = 3\n", "K.mtx: is not a Matrix Market file: its first line must start with %%MatrixMarket"),
        ("K.mtx", "", "K.mtx: is not a Matrix Market file"),
        ("K.mtx", BANNER + "31 31 5\n1 1 2.0\n", "K.mtx: cannot be read as a Matrix Market file: "),
        ("K.mtx", BANNER + "31 31 1\n1 99 2.0\n", "K.mtx: cannot be read as a Matrix Market file: "),
        ("K.mtx", BANNER + "31 31 1\n1 1 two\n", "K.mtx: cannot be read as a Matrix Market file: "),
        (
            "K.mtx",
            BANNER + "31 31 1\n1 2 2.0\n",
            "K.mtx: stiffness is not symmetric: |A - Aᵀ| = 2.0e+00, |A| = 2.0e+00",
        ),
        ("K.mtx", BANNER + "31 31 1\n1 1 2.0\n", "K.mtx: stiffness is not positive definite"),
        ("K.mtx", BANNER + "31 31 1\n1 1 nan\n", "K.mtx: stiffness holds numbers that are not finite"),
        ("K.mtx", BANNER + "30 30 1\n1 1 2.0\n", "K.mtx: stiffness has shape (30, 30); use (31, 31)"),
        ("M.mtx", BANNER + "31 30 1\n1 1 2.0\n", "M.mtx: mass has shape (31, 30); use square"),
        ("D.mtx", BANNER + "31 31 1\n1 1 -2.0\n", "D.mtx: damping is not positive semi-definite"),
        ("M.mtx", BANNER.replace("real", "complex") + "31 31 1\n1 1 2.0 1.0\n", "M.mtx: holds complex numbers"),
        ("M.mtx", BANNER.replace("real", "pattern") + "31 31 1\n1 1\n", "M.mtx: holds pattern numbers; use real"),
        (
            "ends.mtx",
            BANNER + "30 1 1\n1 1 1.0\n",
            "ends.mtx: has shape (30, 1); the mass matrix asks for (31, columns)",
        ),
        ("ends.mtx", BANNER + "31 0 0\n", "ends.mtx: "),
        ("ends.mtx", BANNER + "31 1 1\n1 1 inf\n", "ends.mtx: contacts['ends'] holds numbers that are not finite"),
    ],
)
def test_file_that_cannot_be_used_is_named(inside, say, file, content, said):
    (inside / file).write_text(content)
    status, out, err = say(*MATRICES, "--contact", "ends=ends.mtx")
    assert (status, out) == (1, "")
    assert re.fullmatch(r"fenics-rom: error: [^\n]+\n", err)
    assert err.startswith(f"fenics-rom: error: {said}")
    assert not (inside / "rom.h5").exists()


def test_file_that_is_not_there_is_named(inside, say):
    (inside / "D.mtx").unlink()
    assert (
        say(*MATRICES, "--contact", "ends=.")[2]
        == "fenics-rom: error: D.mtx: cannot be read: No such file or directory\n"
    )
    written(inside)
    assert say(*MATRICES, "--contact", "ends=.")[2] == "fenics-rom: error: .: cannot be read: Is a directory\n"


def test_output_is_none_of_the_files(inside, capfd):
    before = (inside / "M.mtx").read_bytes()
    with pytest.raises(SystemExit):
        main(["reduce", *MATRICES, "--contact", "ends=ends.mtx", "-o", "M.mtx"])
    assert "M.mtx: is read by this command, so it cannot be its output" in capfd.readouterr().err
    assert (inside / "M.mtx").read_bytes() == before


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("", "SCENE is needed, or --mass, --stiffness, --damping (or --rayleigh) and --contact"),
        ("scene.toml --mass M.mtx --rayleigh 0 1", "SCENE and --mass, --rayleigh cannot be used together"),
        ("--mass M.mtx", "matrices instead of SCENE: --stiffness, --contact, --damping or --rayleigh missing"),
        ("--contact a=a.mtx --damping D.mtx", "matrices instead of SCENE: --mass, --stiffness missing"),
        ("--mass M --stiffness K --rayleigh 0 1 --contact a=a --contact a=b", "--contact: each name may be used once"),
        ("--damping D.mtx --rayleigh 0 1", "argument --rayleigh: not allowed with argument --damping"),
        ("--contact ends.mtx", "argument --contact: 'ends.mtx': use NAME=FILE"),
        ("--contact a/b=ends.mtx", "argument --contact: 'a/b=ends.mtx': use NAME=FILE"),
        ("--observe a=", "argument --observe: 'a=': use NAME=FILE"),
        ("--rayleigh 0.1", "argument --rayleigh: "),
    ],
)
def test_wrong_usage_ends_with_status_2(inside, say, options, said):
    status, out, err = say(*options.split())
    assert (status, out) == (2, "")
    assert err.startswith(f"fenics-rom reduce: error: {said}")


def test_negative_coefficients_are_refused(inside, say):
    options = ("--mass", "M.mtx", "--stiffness", "K.mtx", "--rayleigh", "-0.1", "nan", "--contact", "ends=ends.mtx")
    status, _, err = say(*options)
    assert status == 1
    assert err.startswith("fenics-rom: error: rayleigh = (-0.1, nan): use two finite numbers (α, β) from 0")


def test_in_python_the_error_names_the_file_too(inside):
    (inside / "D.mtx").write_text(BANNER + "31 31 1\n1 1 -2.0\n")
    with pytest.raises(StructureError, match=r"^D\.mtx: damping is not positive semi-definite"):
        fr.read_system(mass="M.mtx", damping="D.mtx", stiffness="K.mtx", contacts={"ends": "ends.mtx"})
