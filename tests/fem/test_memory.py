"""Factors that do not fit: said with numbers, and never found out by the kernel."""

import math
import re
from contextlib import closing

import numpy as np
import pytest
from bodies import assembled, box_arrays, write_arrays
from petsc4py import PETSc

from fenics_rom.errors import SolverError
from fenics_rom.fem import iterative, memory
from fenics_rom.fem.memory import free_bytes, group_free_bytes
from fenics_rom.fem.options import set_options


@pytest.fixture(scope="module")
def box(tmp_path_factory):
    """n = 1,728; its factor needs 3 MB."""
    return assembled(write_arrays(tmp_path_factory.mktemp("box") / "box.msh", *box_arrays((1.0, 1.0, 1.0), (8, 8, 7))))


@pytest.fixture
def little(monkeypatch):
    monkeypatch.setattr(memory, "free_bytes", lambda: 1e6)


@pytest.fixture
def iterations_take_none(monkeypatch):
    """Of bodies as small as these they take more than a factor."""
    monkeypatch.setattr(iterative, "BYTES_PER_ENTRY", 0)
    monkeypatch.setattr(iterative, "BYTES_PER_UNKNOWN", 0)


def test_neither_fits(box, little):
    said = r"1,728 unknowns these need about 0\.00\d+ GB on this machine and 0\.001 GB are free: choose a coarser mesh"
    with pytest.raises(SolverError, match=r"the factor of a matrix of 1,728 unknowns would need .*" + said):
        box.algebra.factor((1.0, box.stiffness))
    with pytest.raises(SolverError, match=r"as asked for; but for " + said):
        box.algebra.factor((1.0, box.stiffness), solver="iterative")


def test_factor_that_does_not_fit_is_replaced_with_notice(box, little, iterations_take_none):
    with closing(box.algebra.factor((1.0, box.stiffness))) as factor:
        assert re.fullmatch(
            r"the factor of a matrix of 1,728 unknowns would need 0\.00\d GB on this machine and 0\.001 GB are free: "
            "conjugate gradients with algebraic multigrid were used",
            factor.notice,
        )
        x = factor.solve(box.contacts["right"])
    assert np.abs(box.stiffness @ x - box.contacts["right"]).max() <= 1e-9


def test_factor_that_does_not_fit_is_an_error_where_nothing_else_is_allowed(box, little):
    said = r"would need 0\.0\d+ GB on this machine and 0\.001 GB are free: tried was the direct solver, MUMPS; choose "
    with pytest.raises(SolverError, match=said + 'solver = "iterative"'):
        box.algebra.factor((1.0, box.stiffness), solver="direct")
    with pytest.raises(SolverError, match=said + 'solver = "iterative"'):
        box.algebra.eigenpairs(box.mass, box.stiffness, 5)
    with pytest.raises(SolverError, match=said + "a coarser mesh or more machines"):
        box.algebra.factor((1.0 + 1j, box.stiffness))


def test_analysis_knows_what_the_factor_takes(box, monkeypatch, iterations_take_none):
    """MUMPS' estimate is what it then takes, within a tenth; a factor is refused from nine tenths of the free on."""
    with closing(box.algebra.factor((1.0, box.stiffness))) as factor:
        estimate, taken = (factor._factor.getMumpsInfog(k) for k in (17, 19))
    assert taken <= 1.1 * estimate <= 1.21 * taken
    for share, notice in ((1.2, False), (1.05, True)):
        monkeypatch.setattr(memory, "free_bytes", lambda share=share: share * estimate * 1e6)
        with closing(box.algebra.factor((1.0, box.stiffness))) as factor:
            assert bool(factor.notice) is notice


def test_memory_that_ends_midway_is_no_matter_of_definiteness(box):
    """MUMPS itself refuses when it may not take what it needs."""
    set_options(["-fenics_rom_factor_mat_mumps_icntl_23", "1"])
    try:
        with pytest.raises(SolverError, match=r"MUMPS ran out of memory .* \(INFOG\(1\) = -\d+, INFOG\(2\) = "):
            box.algebra.factor((1.0, box.stiffness), solver="direct")
        with closing(box.algebra.factor((1.0, box.stiffness))) as factor:
            assert factor.notice.startswith("MUMPS ran out of memory with a matrix of 1,728 unknowns")
    finally:
        PETSc.Options().delValue("fenics_rom_factor_mat_mumps_icntl_23")


def test_free_memory_is_a_part_of_what_there_is():
    assert 1e7 < free_bytes() < 1e15


def write_group(folder, names, limit, usage, cache):
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in zip(names, (limit, usage, cache), strict=True):
        (folder / name).write_text(f"{text}\n")


V2 = ("memory.max", "memory.current", "memory.stat")
V1 = ("memory.limit_in_bytes", "memory.usage_in_bytes", "memory.stat")


def test_containers_count_with_those_around_them(tmp_path):
    write_group(tmp_path / "a", V2, 1000, 700, "anon 1\ninactive_file 50")
    write_group(tmp_path / "a" / "b", V2, "max", 100, "inactive_file 0")
    write_group(tmp_path / "c", V2, 5000, 100, "inactive_file 0")
    assert group_free_bytes(tmp_path, "0::/a/b") == 350
    assert group_free_bytes(tmp_path, "0::/c") == 4900
    assert group_free_bytes(tmp_path, "0::/elsewhere") == math.inf


def test_free_memory_ends_at_the_container(tmp_path, monkeypatch):
    for folder, names in ((tmp_path, V2), (tmp_path / "memory", V1)):
        write_group(folder, names, 1000, 650, "inactive_file 0")
    monkeypatch.setattr(memory, "CGROUPS", tmp_path)
    assert free_bytes() == 350


def test_containers_of_the_older_kind_count_too(tmp_path):
    write_group(tmp_path / "memory", V1, 2000, 500, "total_inactive_file 100")
    assert group_free_bytes(tmp_path, "4:memory:/seen/from/outside") == 1600
    assert group_free_bytes(tmp_path, "2:cpu,cpuacct:/") == math.inf
