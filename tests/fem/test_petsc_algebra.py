"""PETSc and SLEPc against LAPACK, and failures that must not be silent."""

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse
from bodies import assembled, box_arrays, box_surfaces, dense, sparse, write_arrays
from petsc4py import PETSc
from scipy.linalg import eigh
from scipy.sparse.linalg import eigsh
from slepc4py import SLEPc

from fenics_rom.errors import SolverError
from fenics_rom.fem import direct, eigenpairs, petsc_algebra
from fenics_rom.fem.direct import HAS_CHOLMOD, ROOMS, MemoryShortage, PetscFactor
from fenics_rom.fem.options import set_options
from fenics_rom.fem.petsc_algebra import require_real
from fenics_rom.fem.petsc_matrix import CHUNK, PetscMatrix, ZeroMatrix, combination, dense_block

SOLVERS = pytest.mark.parametrize("one_by_one", [False, True], ids=["mumps", "cholmod"])


@pytest.fixture(scope="module")
def beam(tmp_path_factory):
    """n = 1050."""
    mesh = write_arrays(tmp_path_factory.mktemp("beam") / "beam.msh", *box_arrays((1.0, 0.1, 0.1), (14, 4, 4)))
    return assembled(mesh)


@pytest.fixture(scope="module")
def twins(tmp_path_factory):
    """Two equal beams apart from each other, n = 768: every eigenvalue is there twice."""
    points, cells = box_arrays((1.0, 0.1, 0.1), (8, 3, 3))
    two = np.concatenate([points, points + np.array([0, 1, 0])]), np.concatenate([cells, cells + len(points)])
    faces = {name: np.concatenate([s, s + len(points)]) for name, s in box_surfaces(points, cells).items()}
    return assembled(write_arrays(tmp_path_factory.mktemp("twins") / "twins.msh", *two, faces))


@pytest.fixture(scope="module")
def lapack(twins):
    return eigh(dense(twins.stiffness, twins.size), dense(twins.mass, twins.size))


def test_products_are_those_of_the_matrix(beam):
    block = np.random.default_rng(0).standard_normal((beam.size, 5))
    expected = sparse(beam.stiffness) @ block
    for k in (0, 1, 5):
        product = beam.stiffness @ block[:, :k]
        assert product.shape == (beam.size, k)
        assert np.abs(product - expected[:, :k]).max(initial=0) <= 1e-14 * np.abs(expected).max()
    product = beam.stiffness @ (block[:, :2] + 1j * block[:, 2:4])
    assert np.abs(product - expected[:, :2] - 1j * expected[:, 2:4]).max() <= 1e-14 * np.abs(expected).max()


def test_wide_blocks_are_taken_in_parts(beam, monkeypatch):
    """So that their copies stay small, however many columns there are."""
    widths = []

    def seen(like, block):
        widths.append(block.shape[1])
        return dense_block(like, block)

    for module in ("petsc_matrix", "direct"):
        monkeypatch.setattr(f"fenics_rom.fem.{module}.dense_block", seen)
    block = np.random.default_rng(0).standard_normal((beam.size, 2 * CHUNK + 44))
    with closing(beam.algebra.factor((1.0, beam.stiffness))) as factor:
        x = factor.solve(block)
    product = beam.stiffness @ x
    assert set(widths) == {CHUNK, 44}
    assert np.abs(product - block).max() <= 1e-9 * np.abs(block).max()
    np.testing.assert_allclose(product[:, -1:], beam.stiffness @ x[:, -1:], rtol=1e-9, atol=1e-9)


def test_combination_is_the_sum(beam):
    total = sparse(beam.mass) * 3.0 + sparse(beam.stiffness) * 1e-4
    made = combination((3.0, beam.mass), (0.0, beam.mass), (1e-4, beam.stiffness))
    start, columns, values = made.getValuesCSR()
    made.destroy()
    assert abs(total - type(total)((values, columns, start)).T).max() <= 2e-15 * abs(total).max()


def test_combination_of_other_patterns_is_the_sum(beam):
    """A dashpot between two distant rows is in no element."""
    dashpot = PETSc.Mat().createAIJ((beam.size,) * 2, nnz=2)
    for row, column, value in ((0, 0, 2.0), (0, beam.size - 1, -2.0), (beam.size - 1, 0, -2.0)):
        dashpot.setValue(row, column, value)
    dashpot.assemble()
    extra = PetscMatrix(dashpot)
    for terms in (((1.0, beam.mass), (3.0, extra)), ((3.0, extra), (1.0, beam.mass))):
        total = PetscMatrix(combination(*terms, (5.0, ZeroMatrix())))
        z = np.random.default_rng(0).standard_normal((beam.size, 1))
        np.testing.assert_allclose(total @ z, beam.mass @ z + 3.0 * (extra @ z), rtol=0, atol=1e-14)
        total.destroy()
    extra.destroy()


def test_sums_that_are_none_are_refused(beam):
    with pytest.raises(SolverError, match="sum of PETSc matrices was asked for with a ndarray in it"):
        beam.algebra.factor((1.0, beam.stiffness), (1.0, np.eye(beam.size)))
    with pytest.raises(SolverError, match="sum of PETSc matrices was asked for without one"):
        beam.algebra.factor((1.0, ZeroMatrix()))


@SOLVERS
def test_solves_leave_no_residual(beam, one_by_one):
    matrix = combination((200.0, beam.mass), (1e-2, beam.stiffness))
    A = sparse(beam.mass) * 200.0 + sparse(beam.stiffness) * 1e-2
    factor = PetscFactor(matrix, one_by_one)
    block = np.random.default_rng(0).standard_normal((beam.size, 7))
    for k in (0, 1, 7):
        x = factor.solve(block[:, :k])
        assert x.shape == (beam.size, k)
        assert np.abs(A @ x - block[:, :k]).max(initial=0) <= 1e-12
    np.testing.assert_allclose(factor.solve(block[:, :1])[:, 0], factor.solve(block)[:, 0], rtol=1e-9)
    x = factor.solve(block[:, :2] + 1j * block[:, 2:4])
    assert np.abs(A @ x - block[:, :2] - 1j * block[:, 2:4]).max() <= 1e-12
    factor.close()


def tridiagonal(diagonal, off):
    matrix = PETSc.Mat().createAIJ((len(diagonal),) * 2)
    matrix.setUp()
    for k, value in enumerate(diagonal):
        matrix.setValue(k, k, value)
        for j in {max(k - 1, 0), min(k + 1, len(diagonal) - 1)} - {k}:
            matrix.setValue(k, j, off)
    matrix.assemble()
    return matrix


NOT_DEFINITE = {
    "one negative": ([1.0, -1.0, 2.0, 3.0], 0.1),
    "all negative": ([-1.0] * 4, 0.1),
    "positive diagonal": ([1.0] * 4, 5.0),
    "zero row": ([1.0, 0.0, 1.0, 1.0], 0.0),
    "constants in the kernel": ([1.0, 2.0, 2.0, 1.0], -1.0),
    "not a number": ([1.0, np.nan, 1.0, 1.0], 0.1),
}


@SOLVERS
@pytest.mark.parametrize("name", NOT_DEFINITE)
def test_matrix_that_is_not_definite_is_refused(name, one_by_one):
    solver = "cholmod" if one_by_one and HAS_CHOLMOD else "mumps"
    with pytest.raises(SolverError, match=f"{solver} could not factor a matrix of 4 unknowns .*: is it symmetric pos"):
        PetscFactor(tridiagonal(*NOT_DEFINITE[name]), one_by_one)


@SOLVERS
def test_one_negative_eigenvalue_among_a_thousand_is_found(beam, one_by_one):
    """Sylvester: K - s M is definite just below the lowest γ, and is not just above it."""
    lowest = eigsh(sparse(beam.stiffness), 1, sparse(beam.mass), sigma=0.0)[0][0]
    PetscFactor(combination((1.0, beam.stiffness), (-0.99 * lowest, beam.mass)), one_by_one).close()
    with pytest.raises(SolverError):
        PetscFactor(combination((1.0, beam.stiffness), (-1.01 * lowest, beam.mass)), one_by_one)


def resident_bytes():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


@SOLVERS
def test_closed_factors_give_their_memory_back(tmp_path, one_by_one):
    """Each of these factors takes 10 MB and more; thirty of them must not stay."""
    mesh = write_arrays(tmp_path / "box.msh", *box_arrays((1.0, 1.0, 1.0), (9, 9, 9)))
    system = assembled(mesh)
    sizes = []
    for k in range(35):
        factor = PetscFactor(combination((1.0 + k, system.mass), (1.0, system.stiffness)), one_by_one)
        factor.solve(np.ones((system.size, 2)))
        factor.close()
        sizes.append(resident_bytes())
    assert sizes[-1] - sizes[4] <= 60e6


def test_multigrid_gives_its_memory_back(twins):
    """Each takes 2 MB and more."""
    sizes = []
    for _ in range(25):
        with closing(twins.algebra.factor((1.0, twins.stiffness), solver="iterative")) as factor:
            factor.solve(np.ones((twins.size, 2)), 0.1)
        sizes.append(resident_bytes())
    assert sizes[-1] - sizes[4] <= 10e6


def test_lowest_eigenpairs_are_those_of_lapack(twins, lapack):
    count = 40
    γ, V = twins.algebra.eigenpairs(twins.mass, twins.stiffness, count)
    np.testing.assert_allclose(γ, lapack[0][:count], rtol=3e-9)
    MV, KV = twins.mass @ V, twins.stiffness @ V
    assert np.abs(V.T @ MV - np.eye(count)).max() <= 1e-11
    assert (np.linalg.norm(KV - γ * MV, axis=0) <= 1e-9 * np.linalg.norm(KV, axis=0)).all()
    np.testing.assert_allclose(γ[::2], γ[1::2], rtol=1e-9)
    inside = np.linalg.norm(lapack[1][:, :count].T @ MV, axis=0)  # of the space that LAPACK's vectors span
    np.testing.assert_allclose(inside, 1, atol=1e-9)


def test_dense_and_sparse_eigensolvers_agree(twins):
    algebra, few, many = twins.algebra, 30, 400
    assert 3 * few < twins.size < 3 * many  # on either side of the choice
    one, other = (algebra.eigenpairs(twins.mass, twins.stiffness, count) for count in (few, many))
    np.testing.assert_allclose(one[0], other[0][:few], rtol=3e-9)
    assert len(other[0]) == many == other[1].shape[1]


def test_eigenvectors_that_are_not_good_enough_are_refused(twins, lapack, monkeypatch):
    γ, V = lapack[0][:5].copy(), lapack[1][:, :5].copy()
    for damage in (1e-3, np.nan):
        V[7, 2] += damage
        monkeypatch.setattr(petsc_algebra, "lowest_eigenpairs", lambda *_, V=V: (γ, V))
        with pytest.raises(SolverError, match="eigenvectors are not accurate enough"):
            twins.algebra.eigenpairs(twins.mass, twins.stiffness, 5)


def test_kept_factor_is_used_instead_of_another(beam, monkeypatch):
    """And solves are all that SLEPc does with it: 4 for each eigenpair at most."""
    made, solves = [], []
    monkeypatch.setattr(direct, "cholesky_numeric", lambda *a: made.append(1) or cholesky_numeric(*a))
    monkeypatch.setattr(PetscFactor, "apply", lambda self, b, x: solves.append(1) or apply(self, b, x))
    expected = beam.algebra.eigenpairs(beam.mass, beam.stiffness, 60)
    assert len(made) == 1
    with closing(beam.algebra.factor((1.0, beam.stiffness))) as factor:
        solves.clear()
        γ, V = beam.algebra.eigenpairs(beam.mass, beam.stiffness, 60, factor)
        assert len(made) == 2  # that of the line above
        assert 60 <= len(solves) <= 240
        factor.solve(np.ones((beam.size, 1)))  # still there
    np.testing.assert_allclose(γ, expected[0], rtol=1e-9)
    assert np.abs(np.abs(np.sum(V * (beam.mass @ expected[1]), axis=0)) - 1).max() <= 1e-6


cholesky_numeric, apply = direct.cholesky_numeric, PetscFactor.apply


def test_factor_of_another_matrix_does_not_pass(beam):
    with (
        closing(beam.algebra.factor((1.0, beam.stiffness), (1e4, beam.mass))) as factor,
        pytest.raises(SolverError, match="eigenvectors are not accurate enough"),
    ):
        beam.algebra.eigenpairs(beam.mass, beam.stiffness, 10, factor)


@pytest.fixture
def made(monkeypatch):
    """Every eigensolver that is made."""
    solvers = []

    class Kept(SLEPc.EPS):
        def create(self, comm):
            solvers.append(self)
            return super().create(comm)

    monkeypatch.setattr(eigenpairs.SLEPc, "EPS", Kept)
    return solvers


def test_eigenproblem_without_solution_is_an_error(twins, made):
    class Nothing:
        def apply(self, right, solution):
            solution.set(np.nan)

    class Broken:
        def apply(self, right, solution):
            raise SolverError("no solution")

    with pytest.raises(SolverError, match="SLEPc failed with PETSc error"):
        twins.algebra.eigenpairs(twins.mass, twins.stiffness, 5, Nothing())
    with pytest.raises(SolverError, match="no solution"):
        twins.algebra.eigenpairs(twins.mass, twins.stiffness, 5, Broken())
    assert len(made) == 2
    assert not any(made)  # destroyed


def test_eigenpairs_that_do_not_converge_are_an_error(twins, made):
    set_options(["-fenics_rom_eps_max_it", "1", "-fenics_rom_eps_tol", "1e-20"])
    try:
        with pytest.raises(
            SolverError, match=r"SLEPc found \d+ of 40 eigenpairs in 1 iterations \(DIVERGED_ITS\); ask for fewer"
        ):
            twins.algebra.eigenpairs(twins.mass, twins.stiffness, 40)
    finally:
        for name in ("max_it", "tol"):
            PETSc.Options("fenics_rom_eps_").delValue(name)
    assert len(made) == 1
    assert not any(made)


def test_complex_petsc_is_refused():
    require_real(np.float64)
    with pytest.raises(SolverError, match=r"complex-valued build; fenics_rom needs the real one \(on Debian: unset"):
        require_real(np.complex128)


def test_pivots_that_are_put_off_find_more_room(monkeypatch):
    """A matrix with hardly a diagonal: MUMPS needs more than it foresees, and is given it."""
    random = np.random.default_rng(0)
    half = scipy.sparse.random(600, 600, 0.02, random_state=0)
    matrix = (half + half.T + scipy.sparse.diags(1e-8 * random.standard_normal(600))).tocsr()
    b = random.standard_normal((600, 1))

    def factor():
        mat = PETSc.Mat().createAIJ(matrix.shape, csr=(matrix.indptr, matrix.indices, matrix.data))
        return PetscFactor(mat, definite=False)

    scarce = {"mat_mumps_icntl_14": "1"}
    monkeypatch.setattr(direct, "ROOMS", (scarce,))
    with pytest.raises(
        MemoryShortage, match=r"MUMPS ran out of memory with a matrix of 600 unknowns \(INFOG\(1\) = -9"
    ):
        factor()
    monkeypatch.setattr(direct, "ROOMS", (scarce, *ROOMS[1:]))
    with closing(factor()) as found:
        assert np.abs(matrix @ found.solve(b) - b).max() <= 1e-8
        assert found.negative_pivots == (np.linalg.eigvalsh(matrix.toarray()) < 0).sum()
