"""`fenics-rom mesh`: a surface filled with tetrahedra."""

import argparse
from pathlib import Path

import numpy as np

from fenics_rom.cli.display import print_lines
from fenics_rom.cli.output import add_output
from fenics_rom.io.overwriting import check_outputs
from fenics_rom.lazy_import import load

SUMMARY = "fill a closed surface, or a STEP body, with tetrahedra"


def add_options(command: argparse.ArgumentParser) -> None:
    """What it is told."""
    command.add_argument("file", metavar="FILE", help=".stl, .step or .stp")
    add_output(command, "MESH.msh")
    command.add_argument("--size", type=float, metavar="M", required=True, help="length of the cells' edges, m")
    command.add_argument("--scale", type=float, metavar="X", default=1.0, help="metres that a unit of .stl is worth")


def run(choice: argparse.Namespace) -> None:
    """Meshes, and prints how large the body is and how good its cells are."""
    for option in ("size", "scale"):
        if not 0 < getattr(choice, option) < np.inf:
            choice.wrong_usage(f"--{option} {getattr(choice, option):g}: allowed is a finite number > 0")
    if choice.output.suffix != ".msh":
        choice.wrong_usage(f"-o {choice.output}: allowed is the ending .msh")
    check_outputs(choice.output, inputs=[choice.file], force=choice.force)
    fill_surface = load("fem.filling", "fill_surface")
    mesh, quality = fill_surface(Path(choice.file), choice.output, choice.size, choice.scale)
    size = " x ".join(f"{length:.4g}" for length in np.ptp(mesh.points, axis=0))
    print(f"mesh {choice.output}")
    print_lines({"body": f"{size} m", "cells": str(quality)}, ())
