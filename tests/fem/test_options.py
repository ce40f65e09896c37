"""PETSc's and SLEPc's own options: those given win, and none passes in silence."""

from contextlib import closing

import pytest
from petsc4py import PETSc

from fenics_rom.errors import SolverError
from fenics_rom.fem.direct import HAS_CHOLMOD, PetscFactor
from fenics_rom.fem.options import set_options, unused_options
from fenics_rom.fem.petsc_matrix import combination


@pytest.fixture(autouse=True)
def clean():
    before = set(PETSc.Options().getAll())
    yield
    for name in set(PETSc.Options().getAll()) - before:
        PETSc.Options().delValue(name)


def test_options_reach_mumps(plate_system):
    words = ["-fenics_rom_factor_mat_mumps_icntl_14", "55", "-fenics_rom_factor_mat_mumps_icntl_27", "16"]
    set_options(words)
    assert unused_options() == words[::2]
    for coefficient in (1.0, 1.0 + 0.5j):
        with closing(plate_system.algebra.factor((coefficient, plate_system.stiffness))) as factor:
            mumps = getattr(factor, "_doubled", factor)._factor
            assert [mumps.getMumpsIcntl(k) for k in (14, 27)] == [55, 16]
    assert unused_options() == []


def test_options_reach_the_iterations(plate_system):
    counts = []
    for tolerance in ("1e-13", "1e-2"):
        set_options(["-fenics_rom_factor_ksp_rtol", tolerance, "-fenics_rom_factor_pc_gamg_threshold", "0.01"])
        with closing(plate_system.algebra.factor((1.0, plate_system.stiffness), solver="iterative")) as factor:
            factor.solve(plate_system.input_matrix("middle"))
            counts.append(factor.iterations)
    assert counts[0] > 2 * counts[1]
    assert unused_options() == []


def test_options_reach_slepc(plate_system, capfd):
    set_options(["-fenics_rom_eps_ncv", "33", "-fenics_rom_eps_view", "-fenics_rom_st_type", "sinvert"])
    plate_system.algebra.eigenpairs(plate_system.mass, plate_system.stiffness, 5)
    assert "(ncv): 33" in capfd.readouterr().out
    assert unused_options() == []


@pytest.mark.skipif(not HAS_CHOLMOD, reason="this PETSc has no CHOLMOD")
def test_given_value_wins_over_ours(plate_system):
    """CHOLMOD's simplicial L D Lᵀ takes matrices that are not definite, which is why the default is another."""
    not_definite = (1.0, plate_system.stiffness), (-1e6, plate_system.mass)
    with pytest.raises(SolverError):
        PetscFactor(combination(*not_definite), one_by_one=True)
    set_options(["-fenics_rom_factor_mat_cholmod_factor", "SIMPLICIAL"])
    PetscFactor(combination(*not_definite), one_by_one=True).close()
    assert PETSc.Options().getAll()["fenics_rom_factor_mat_cholmod_factor"] == "SIMPLICIAL"


def test_defaults_do_not_stay(plate_system):
    before = PETSc.Options().getAll()
    PetscFactor(combination((1.0, plate_system.stiffness)), one_by_one=True).close()
    for solver in ("direct", "iterative"):
        plate_system.algebra.factor((1.0, plate_system.stiffness), solver=solver).close()
    assert PETSc.Options().getAll() == before


def test_typing_errors_are_found(plate_system):
    set_options(["-fenics_rom_eps_ncw", "33", "-fenics_rom_factor_mat_mumps_icntl_14", "-1"])
    plate_system.algebra.eigenpairs(plate_system.mass, plate_system.stiffness, 5)
    assert unused_options() == ["-fenics_rom_eps_ncw"]


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["-ksp_type", "cg"], "option '-ksp_type': use those that begin with -fenics_rom_factor_ or"),
        (["-fenics_rom_eps_ncv", "3", "4"], "'4' is not an option and not the value of one"),
        (["-fenics_rom_eps_ncv", "3", "-options_file", "x"], "option '-options_file'"),
        (["3"], "'3' is not an option and not the value of one; options begin with -fenics_rom_factor_"),
    ],
)
def test_other_words_are_refused_and_none_is_set(words, complaint):
    before = PETSc.Options().getAll()
    with pytest.raises(SolverError, match=complaint):
        set_options(words)
    assert PETSc.Options().getAll() == before
