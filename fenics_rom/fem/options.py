"""Settings of PETSc's and SLEPc's solvers by their own options, as on their command lines."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

from petsc4py import PETSc

from fenics_rom.errors import SolverError
from fenics_rom.fem.petsc_ctypes import option_was_read

FACTOR_PREFIX = "fenics_rom_factor_"  # of factorisations, direct or iterative
EIGEN_PREFIX = "fenics_rom_"  # SLEPc goes on with eps_, and st_ for what it solves with
PREFIXES = (FACTOR_PREFIX, "fenics_rom_eps_", "fenics_rom_st_")
ALLOWED = " or ".join(f"-{prefix}" for prefix in PREFIXES)


def set_options(words: Sequence[str]) -> None:
    """Puts options into PETSc's database, such as ["-fenics_rom_factor_ksp_rtol", "1e-12", "-fenics_rom_eps_monitor"].

    Raises:
        SolverError: a word is neither an option of this package's solvers nor the value of one; then none is set.
    """
    given: dict[str, str | None] = {}
    name = None
    for word in words:
        if word.startswith("-") and word[1:2].isalpha():
            name = word[1:]
            if not name.startswith(PREFIXES):
                raise SolverError(f"option {word!r}: use those that begin with {ALLOWED}")
            given[name] = None
        elif name is None or given[name] is not None:
            raise SolverError(f"{word!r} is not an option and not the value of one; options begin with {ALLOWED}")
        else:
            given[name] = word
    options = PETSc.Options()
    for name, value in given.items():
        options.setValue(name, value)


def unused_options() -> list[str]:
    """Options of this package's solvers that were given and that nothing has read, with their dash."""
    given = PETSc.Options().getAll()
    return [f"-{name}" for name in given if name.startswith(PREFIXES) and not option_was_read(name)]


@contextmanager
def default_options(prefix: str, values: Mapping[str, str]) -> Iterator[None]:
    """Options that hold meanwhile, unless the user has set them."""
    options = PETSc.Options(prefix)
    unset = [name for name in values if not options.hasName(name)]
    for name in unset:
        options[name] = values[name]
    try:
        yield
    finally:
        for name in unset:
            options.delValue(name)
