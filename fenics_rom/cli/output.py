"""The option -o of the commands that write, and the check of its place."""

import argparse
from pathlib import Path

from fenics_rom.errors import FileError
from fenics_rom.io.atomic_write import check_place


def add_output(command: argparse.ArgumentParser, metavar: str, help: str = "file to write") -> None:
    """Gives a command its -o."""
    command.add_argument("-o", "--output", type=Path, required=True, metavar=metavar, help=help)


def check_output(output: Path, *inputs: str | None) -> None:
    """Checks, before long work, that a file can be put there and is none that the command reads; else FileError."""
    check_place(output)
    for name in inputs:
        if name is not None and output.exists() and Path(name).exists() and output.samefile(name):
            raise FileError(f"{output}: is read by this command, so it cannot be its output")
