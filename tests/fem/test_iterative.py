"""Conjugate gradients with multigrid where a factor was: as accurate, and never silent when they are not."""

import re
from contextlib import closing

import numpy as np
import pytest
from bodies import assembled, box_arrays, write_arrays
from petsc4py import PETSc

from fenics_rom.compilation import numpy_alone
from fenics_rom.errors import SolverError
from fenics_rom.fem import petsc_algebra
from fenics_rom.fem.iterative import IterativeFactor
from fenics_rom.fem.options import set_options
from fenics_rom.fem.petsc_matrix import combination
from fenics_rom.system.protocols import EXACT

SHAPES = {"beam": ((1.0, 0.1, 0.1), (14, 4, 4)), "slab": ((1.0, 1.0, 0.03), (6, 6, 1))}


@pytest.fixture(scope="module", params=["beam", pytest.param("slab", marks=pytest.mark.slow)])
def body(request, tmp_path_factory):
    """A beam, n = 1,050, and a thin slab of degree 2, n = 1,404, which is the harder one."""
    mesh = write_arrays(tmp_path_factory.mktemp(request.param) / "mesh.msh", *box_arrays(*SHAPES[request.param]))
    return assembled(mesh, degree=2 if request.param == "slab" else 1)


@pytest.fixture
def option():
    """Sets options for one test."""
    given = []

    def put(name, value):
        given.append(name)
        set_options([f"-{name}", value])

    yield put
    for name in given:
        PETSc.Options().delValue(name)


def energy(system, x):
    return np.sqrt(np.diag(x.T @ (system.stiffness @ x)))


def test_moments_are_those_of_a_factor(body):
    """(K⁻¹M)ʲ K⁻¹B, what Krylov spaces are made of: round-off in the stiff directions is all that is left."""
    with (
        closing(body.algebra.factor((1.0, body.stiffness), solver="direct")) as factor,
        closing(body.algebra.factor((1.0, body.stiffness), solver="iterative")) as iterative,
    ):
        assert factor.notice == ""
        assert iterative.notice == "conjugate gradients with algebraic multigrid, as asked for"
        x = y = body.contacts["right"][:, 2:]
        for _ in range(4):
            x, y = factor.solve(x), iterative.solve(y)
            assert (energy(body, x - y) <= 1e-8 * energy(body, x)).all()
            x, y = body.mass @ x, body.mass @ y


def test_true_residual_is_that_of_a_factor(body):
    """Round-off alone leaves about eps |K| |x|; both methods stay near it."""
    B = np.random.default_rng(0).standard_normal((body.size, 3))
    floor = np.finfo(float).eps * body.stiffness.mat.norm(PETSc.NormType.NORM_INFINITY)
    for solver in ("direct", "iterative"):
        with closing(body.algebra.factor((1.0, body.stiffness), solver=solver)) as factor:
            x = factor.solve(B)
        lack = np.linalg.norm(body.stiffness @ x - B, axis=0)
        assert (lack <= 20 * floor * np.linalg.norm(x, axis=0) + 10 * EXACT * np.linalg.norm(B, axis=0)).all()


@pytest.mark.parametrize("accuracy", [1e-2, 1e-6, 1e-10])
def test_solutions_of_many_columns_are_as_accurate_as_asked_for(body, accuracy):
    """In energy, up to the root of the condition of K with multigrid, which is below 10 for these."""
    B = np.random.default_rng(0).standard_normal((body.size, 21))
    with (
        closing(body.algebra.factor((1.0, body.stiffness), solver="direct")) as factor,
        closing(body.algebra.factor((1.0, body.stiffness), solver="iterative")) as iterative,
    ):
        x, y = factor.solve(B), iterative.solve(B, accuracy)
        off = energy(body, x - y) / energy(body, x)
        assert 1e-4 * accuracy < off.max() <= 10 * accuracy  # no more work than asked for, either
        with numpy_alone():
            z = iterative.solve(B, accuracy)
        assert (energy(body, z - y) <= 10 * accuracy * energy(body, x)).all()


def test_solver_is_chosen_by_operations(body, monkeypatch):
    with closing(body.algebra.factor((1.0, body.stiffness), columns=1000)) as factor:
        assert factor.notice == ""
    monkeypatch.setattr(petsc_algebra, "OPERATIONS", 1)
    with closing(body.algebra.factor((1.0, body.stiffness), columns=1)) as factor:
        assert re.fullmatch(
            rf"the factor of a matrix of {body.size:,} unknowns would take \S+ operations and \S+ GB on this machine, "
            r"iterations about \S+: conjugate gradients with algebraic multigrid were used",
            factor.notice,
        )


def test_right_hand_sides_of_any_kind(body):
    B = np.random.default_rng(0).standard_normal((body.size, 2))
    with closing(body.algebra.factor((1.0, body.stiffness), (50.0, body.mass), solver="iterative")) as factor:
        x = factor.solve(B)
        assert factor.solve(B[:, :0]).shape == (body.size, 0)
        np.testing.assert_array_equal(factor.solve(0 * B), 0 * B)
        np.testing.assert_array_equal(factor.solve(B[:, :1] + 1j * B[:, 1:]), x[:, :1] + 1j * x[:, 1:])
        np.testing.assert_array_equal(factor.solve(B), x)  # from zero each time
        np.testing.assert_allclose(factor.solve(1e-60 * B), 1e-60 * x, rtol=1e-6, atol=1e-69)


def iterations(mat):
    """Needed for a random right-hand side."""
    with closing(IterativeFactor(mat, "")) as factor:
        b = np.random.default_rng(0).standard_normal((mat.getSize()[0], 1))
        x = factor.solve(b)
        return factor.iterations, x


def test_rigid_modes_save_iterations_and_are_not_needed(body):
    """As for anyone's matrices, of which nobody knows where their rows are."""
    start, columns, values = body.stiffness.mat.getValuesCSR()
    bare = PETSc.Mat().createAIJ((body.size,) * 2, csr=(start, columns, values))
    (few, x), (many, y) = iterations(combination((1.0, body.stiffness))), iterations(bare)
    assert 2 * few <= many
    assert energy(body, x - y) <= 1e-8 * energy(body, x)


def test_iterations_that_do_not_converge_are_an_error(body, option):
    option("fenics_rom_factor_ksp_max_it", "3")
    with (
        closing(body.algebra.factor((1.0, body.stiffness), solver="iterative")) as factor,
        pytest.raises(
            SolverError,
            match=rf"did not solve for {body.size:,} unknowns: DIVERGED_\w*IT\w* after 3 iterations with a "
            r"preconditioned residual of \d\.\de",
        ),
    ):
        factor.solve(body.contacts["right"])


def test_numbers_that_are_none_are_an_error(body):
    with (
        closing(body.algebra.factor((1.0, body.stiffness), solver="iterative")) as factor,
        pytest.raises(SolverError, match="DIVERGED_NAN"),
    ):
        factor.solve(np.full((body.size, 1), np.nan))


def test_indefinite_matrix_is_noticed(body):
    """By multigrid, or by conjugate gradients."""
    with pytest.raises(SolverError, match=r"multigrid .* for [\d,]+ unknowns.*: .*is the matrix symmetric positive"):
        body.algebra.factor((1.0, body.stiffness), (-1e6, body.mass), solver="iterative").solve(np.ones((body.size, 1)))


@pytest.mark.parametrize("body", ["beam"], indirect=True)
def test_eigenpairs_do_not_need_a_factorisation(body):
    with closing(body.algebra.factor((1.0, body.stiffness), solver="iterative")) as factor:
        γ, _ = body.algebra.eigenpairs(body.mass, body.stiffness, 2, factor)
    np.testing.assert_allclose(γ, body.algebra.eigenpairs(body.mass, body.stiffness, 2)[0], rtol=1e-9)


def test_unknown_solver_is_refused(body):
    with pytest.raises(SolverError, match=r"solver: 'magic' was given; use one of 'auto', 'direct', 'iterative'"):
        body.algebra.factor((1.0, body.stiffness), solver="magic")
