"""PETSc's and SLEPc's own options on our command line: told apart from ours, passed on, and missed where unread."""

from collections.abc import Sequence

from fenics_rom.cli.display import print_warnings
from fenics_rom.errors import MissingPackageError
from fenics_rom.io.mpi_ranks import is_root_process

COMMANDS = ("reduce", "simulate", "study", "identify")  # those that they are for
PREFIX = "-fenics_rom_"  # what they begin with
HELP = """PETSc's and SLEPc's own options are passed on: -fenics_rom_factor_... for factorisations and the
iterative solver, -fenics_rom_eps_... and -fenics_rom_st_... for eigenvectors, such as
-fenics_rom_factor_mat_mumps_icntl_14 50. The word after such an option is its value; put those without a value last."""


def split_words(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """Splits the words of a command line into ours, and PETSc's options with their values."""
    if not words or words[0] not in COMMANDS:
        return list(words), []
    ours: list[str] = []
    petsc: list[str] = []
    value_may_follow = False
    for word in words:
        option = word.startswith(PREFIX)
        value = value_may_follow and not (word.startswith("-") and not word[1:2].isdigit())
        (petsc if option or value else ours).append(word)
        value_may_follow = option
    return ours, petsc


def set_petsc_options(words: list[str]) -> None:
    """Puts options into PETSc's database.

    Raises:
        MissingPackageError: there is no PETSc.
        SolverError: one of them is not of this package's solvers.
    """
    if not words:
        return
    try:
        from fenics_rom.fem.options import set_options
    except ModuleNotFoundError as error:
        raise MissingPackageError(f"options of PETSc need {error.name}, which this Python lacks") from error
    set_options(words)


def print_unread(words: list[str]) -> None:
    """Names the options that nothing has read: a typing error must not pass in silence."""
    if words and is_root_process():
        from fenics_rom.fem.options import unused_options

        print_warnings([f"option {name} was given, but nothing has read it" for name in unused_options()])
