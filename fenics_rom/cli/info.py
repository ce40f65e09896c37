"""`fenics-rom info`: what is in a ROM or a run."""

import argparse

import fenics_rom as fr
from fenics_rom.cli.display import print_rom, print_trajectory
from fenics_rom.io.hdf5 import content_of

SUMMARY = "say what is in a ROM or a run"


def add_options(command: argparse.ArgumentParser) -> None:
    """What it is told."""
    command.add_argument("file", metavar="FILE.h5")


def run(choice: argparse.Namespace) -> None:
    """Prints what `reduce` or `simulate` printed."""
    if content_of(choice.file) == "rom":
        print_rom(fr.read_rom(choice.file), choice.file)
    else:
        print_trajectory(fr.read_trajectory(choice.file), choice.file)
