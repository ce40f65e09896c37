"""Dynamic stiffnesses s² M + s D + K at complex s, with a PETSc of real numbers."""

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from bodies import assembled, box_arrays, sparse, write_arrays
from petsc4py import PETSc
from scipy.sparse.linalg import splu

from fenics_rom.errors import SolverError
from fenics_rom.fem.petsc_matrix import PetscMatrix, ZeroMatrix

SHIFTS = (100j, -3.0 + 200j, 5.0 - 1e4j, complex(20.0), complex(-300.0))


@pytest.fixture(scope="module")
def box(tmp_path_factory):
    """n = 1,728."""
    return assembled(write_arrays(tmp_path_factory.mktemp("box") / "box.msh", *box_arrays((1.0, 1.0, 1.0), (8, 8, 7))))


def terms(system, s):
    return (s**2, system.mass), (s, system.damping), (1.0, system.stiffness)


@pytest.mark.parametrize("s", SHIFTS)
def test_solutions_are_those_of_superlu(box, s):
    M, D, K = (sparse(A) for A in (box.mass, box.damping, box.stiffness))
    A = (s**2 * M + s * D + K).tocsc()
    real = np.random.default_rng(0).standard_normal((box.size, 6))
    oracle = splu(A)
    with closing(box.algebra.factor(*terms(box, s))) as factor:
        assert factor.notice == ""
        for block in (real, real[:, :1], real[:, :3] + 1j * real[:, 3:], real[:, :0]):
            x = factor.solve(block)
            assert x.shape == block.shape
            assert np.iscomplexobj(x)
            expected = oracle.solve(block.astype(complex)) if block.shape[1] else x
            assert np.linalg.norm(x - expected) <= 1e-9 * np.linalg.norm(expected)
            assert np.linalg.norm(A @ x - block) <= 1e-10 * np.linalg.norm(block)


def test_no_damping_is_no_matrix(box):
    """Between eigenvalues the dynamic stiffness is indefinite: for complex numbers that is in order."""
    with closing(box.algebra.factor((400j**2, box.mass), (400j, ZeroMatrix()), (1.0, box.stiffness))) as factor:
        x = factor.solve(np.ones((box.size, 1)))
    np.testing.assert_allclose(-(400.0**2) * (box.mass @ x) + box.stiffness @ x, 1.0, atol=1e-9)
    with pytest.raises(SolverError, match="positive definite"):
        box.algebra.factor((-(400.0**2), box.mass), (1.0, box.stiffness))


def test_singular_matrix_is_refused(box):
    diagonal = PETSc.Mat().createAIJ((4, 4), nnz=1)
    for row, value in enumerate([1.0, 2.0, 0.0, 3.0]):
        diagonal.setValue(row, row, value)
    diagonal.assemble()
    with pytest.raises(SolverError, match=r"INFOG\(1\) = -10, .*: is it symmetric and regular"):
        box.algebra.factor((1j, PetscMatrix(diagonal)))


def test_there_is_no_iterative_route(box):
    with pytest.raises(SolverError, match="'iterative' is for real coefficients; complex ones were given"):
        box.algebra.factor(*terms(box, 1j), solver="iterative")


def resident_bytes():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


def test_memory_stays_flat_over_many_shifts(box):
    """Each factor takes 25 MB and more; twenty must not stay."""
    sizes = []
    for k in range(24):
        with closing(box.algebra.factor(*terms(box, complex(-1.0, 50.0 + k)))) as factor:
            factor.solve(np.ones((box.size, 2)))
        sizes.append(resident_bytes())
    assert sizes[-1] - sizes[3] <= 60e6
