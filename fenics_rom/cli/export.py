"""`fenics-rom export`: files for ParaView, pictures and films, models for control."""

import argparse

import fenics_rom as fr
from fenics_rom.cli.display import progress
from fenics_rom.cli.output import add_output
from fenics_rom.visualization.exports.export import COLOURS
from fenics_rom.visualization.exports.mode_shapes import SHAPE_KINDS
from fenics_rom.zoo_bodies import rom_file

SUMMARY = "write files for ParaView, pictures, films, and models for control"


def add_options(command: argparse.ArgumentParser) -> None:
    """What it is told."""
    command.add_argument("file", metavar="FILE.h5", help="a ROM (or zoo:NAME) or a run")
    add_output(
        command, "OUT", "of a run .pvd, .vtu, .png, .gif, .mp4; of a ROM .vtu, .png, .pdf, .svg, .npz, .mat, .c, .fmu"
    )
    command.add_argument("--what", choices=SHAPE_KINDS, help="shapes of a ROM; modes, unless others are asked for")
    command.add_argument("--count", type=int, metavar="N", help="shapes of each contact mode")
    command.add_argument("--time", type=float, metavar="S", help="instant of a run for .vtu and .png, s; else the last")
    command.add_argument("--scale", type=float, metavar="X", default=1.0, help="of displacements in pictures of a run")
    command.add_argument("--colour", choices=COLOURS, help="of pictures of a run: displacement, unless told")
    command.add_argument("--seconds", type=float, metavar="S", help="length of .gif and .mp4; else at most 10 s")
    command.add_argument("--dark", action="store_true", help="light on dark")
    command.add_argument("--dt", type=float, metavar="H", help="step of .npz, .mat, .c and .fmu, s")
    command.add_argument(
        "--at",
        metavar="RUN.h5",
        help="run about whose end .npz, .mat, .c and .fmu are linearised; else rest at the start",
    )
    command.add_argument("--outputs", nargs="+", metavar="NAME", help="what .npz, .mat, .c and .fmu read; else all")


def run(choice: argparse.Namespace) -> None:
    """Exports, and prints the name of the file."""
    with progress() as report:
        names = ("what", "count", "time", "scale", "colour", "seconds", "dark", "dt", "outputs", "at", "force")
        chosen = {name: getattr(choice, name) for name in names}
        file = fr.export(rom_file(choice.file), choice.output, **chosen, report=report)
    print(file)
