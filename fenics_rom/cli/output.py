"""The options of the commands that write: -o, and --force for files of another kind."""

import argparse
from pathlib import Path


def add_output(
    command: argparse.ArgumentParser, metavar: str, help: str = "file to write", *, required: bool = True
) -> None:
    """Gives a command its -o, and --force."""
    command.add_argument("-o", "--output", type=Path, required=required, metavar=metavar, help=help)
    command.add_argument("--force", action="store_true", help="write also over an existing file of another kind")


def check_other_name(choice: argparse.Namespace, option: str) -> None:
    """Wrong usage where another option names the file of -o, too."""
    file = getattr(choice, option)
    if file is not None and file.resolve() == choice.output.resolve():
        choice.wrong_usage(f"--{option} {file}: is the file of -o, too; give another name")
