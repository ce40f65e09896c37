"""The command line: `fenics-rom COMMAND ...`.

Exit status: 0 done, 1 could not be done, 2 wrong usage, 3 a limit is exceeded.
"""

import argparse
import io
import os
import re
import sys
import time
import traceback
import warnings
from collections.abc import Collection
from typing import Any, NoReturn

import fenics_rom as fr
from fenics_rom.cli import (
    certify,
    check,
    compare,
    compile,
    export,
    identify,
    info,
    mesh,
    petsc_options,
    plot,
    reduce,
    simulate,
    study,
    view,
    zoo,
)
from fenics_rom.cli.display import rich_package
from fenics_rom.errors import FenicsRomError, FenicsRomWarning, unknown
from fenics_rom.io.mpi_ranks import is_root_process, launched_rank
from fenics_rom.system.backends import belongs_to

COMMANDS = {
    module.__name__.rpartition(".")[2]: module
    for module in (
        mesh,
        reduce,
        simulate,
        study,
        certify,
        check,
        identify,
        info,
        view,
        compare,
        plot,
        export,
        compile,
        zoo,
    )  # as in the help
}
PATIENCE_OF_RANKS = 5.0  # s that other ranks give rank 0 to say why the run ends


def main(arguments: list[str] | None = None) -> NoReturn:
    """Runs one command and exits."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without σ gets a ?
    words, petsc = petsc_options.split_words(sys.argv[1:] if arguments is None else arguments)
    choice = _parser().parse_args(words)
    sys.argv[1:] = [word.encode(errors="replace").decode() for word in sys.argv[1:]]  # which dolfinx reads as UTF-8
    choice.words, choice.petsc_words = words, petsc
    warnings.simplefilter("ignore", FenicsRomWarning)  # the summary at the end lists them
    try:
        rich_package()  # before long work, not after it
        petsc_options.set_petsc_options(petsc)
        status = choice.run(choice) or 0  # those that only do or fail give none
        petsc_options.print_unread(petsc)
        sys.stdout.flush()
    except FenicsRomError as error:
        _give_up(str(error))
    except MemoryError as error:
        _give_up(f"not enough memory: {error}")
    except KeyboardInterrupt:
        _give_up("interrupted")
    except BrokenPipeError:  # whoever read the output has seen enough
        _drop_output()
        status = 0
    except OSError as error:
        _drop_output()
        _give_up(str(error))
    except Exception as error:
        if belongs_to(error, "petsc4py"):  # most likely of an option with a value that there is not
            _give_up(f"PETSc: {error}")
        traceback.print_exc()
        _end(1)
    sys.exit(status)


def _give_up(reason: str) -> NoReturn:
    """Says why, once, and ends every rank: an error of one rank must not leave the others waiting."""
    if not is_root_process():
        time.sleep(PATIENCE_OF_RANKS)  # in nearly every case rank 0 says the same and ends this rank too
    print(f"fenics-rom: error: {' '.join(reason.split())}", file=sys.stderr, flush=True)
    _end(1)


def _drop_output() -> None:
    """What standard output could not take is not to be tried again at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _end(status: int) -> NoReturn:
    """Ends every rank."""
    sys.stderr.flush()
    ranks = getattr(sys.modules.get("mpi4py.MPI"), "COMM_WORLD", None)
    if ranks is not None and ranks.size > 1:
        ranks.Abort(status)
    if launched_rank() is not None:  # an import that was interrupted may have begun MPI, whose end waits for all ranks
        os._exit(status)
    sys.exit(status)


class _Parser(argparse.ArgumentParser):
    """A parser that says in one line what is wrong, and an option or a command that there is not before all else."""

    commands: Collection[str] = ()

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """See ArgumentParser."""
        options = [name for action in self._actions for name in action.option_strings]
        for word in args:
            if self.commands and not word.startswith("-"):  # what follows is for its parser
                if word not in self.commands:
                    self.error(unknown("command", word, self.commands))
                break
            if word == "--":
                break
            name = word.partition("=")[0]
            if re.match("--?[a-zA-Z]", name) and not any(o.startswith(name) or name[:2] == o for o in options):
                self.error(unknown("option", name, [option for option in options if option.startswith("--")]))
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """See ArgumentParser."""
        hint = f"; see {self.prog} --help" if "arguments are required" in message else ""
        self.exit(2, f"{self.prog}: error: {' '.join(message.split())}{hint}\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="fenics-rom", description="Soft bodies with changing contacts, reduced and run in real time.")
    parser.commands = COMMANDS
    parser.add_argument("--version", action="version", version=f"fenics-rom {fr.__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for name, module in COMMANDS.items():
        epilog = petsc_options.HELP if name in petsc_options.COMMANDS else None
        command = commands.add_parser(name, help=module.SUMMARY, description=module.SUMMARY, epilog=epilog)
        module.add_options(command)
        command.set_defaults(run=module.run, wrong_usage=command.error)
    return parser
