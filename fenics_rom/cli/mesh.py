"""`fenics-rom mesh`: a surface filled with tetrahedra, or parts of a body that touch made one."""

import argparse
from contextlib import suppress
from pathlib import Path

import numpy as np

from fenics_rom.cli.display import print_lines, progress
from fenics_rom.cli.output import add_output
from fenics_rom.io.overwriting import check_outputs
from fenics_rom.lazy_import import load
from fenics_rom.mechanics.body_facts import quality_of

SUMMARY = "fill a closed surface, or a STEP body, with tetrahedra; glue parts of a mesh that touch"
SURFACES = (".stl", ".step", ".stp")
BY_ITSELF = -1.0  # --glue without a number


def add_options(command: argparse.ArgumentParser) -> None:
    """What it is told."""
    command.add_argument("file", metavar="FILE", help=".stl, .step or .stp, to be filled; with --glue a mesh, too")
    add_output(command, "MESH.msh")
    command.add_argument(
        "--size",
        type=float,
        metavar="M",
        help="length of the cells' edges, m, of what is filled (that of some 20,000 cells)",
    )
    command.add_argument(
        "--glue",
        type=_tolerance,
        nargs="?",
        const=BY_ITSELF,
        metavar="M",
        help="merge nodes within so many m of one another (1e-6 of the body's diagonal where no number is given); of a "
        "STEP body let solids share nodes where they meet",
    )
    command.add_argument(
        "--scale", type=float, metavar="X", default=1.0, help="metres that a unit of .stl, or of a mesh, is worth"
    )


def _tolerance(word: str) -> float:
    with suppress(ValueError):
        if 0 <= float(word) < np.inf:
            return float(word)
    raise argparse.ArgumentTypeError(f"{word!r}: use a finite number >= 0, or none where --glue stands last")


def run(choice: argparse.Namespace) -> None:
    """Meshes or glues, and prints how large the body is and how good its cells are."""
    file, glue = Path(choice.file), choice.glue
    is_filled = file.suffix.lower() in SURFACES
    if not is_filled and glue is None:
        choice.wrong_usage(f"{file}: what is filled ends in {', '.join(SURFACES)}; a mesh is taken with --glue")
    if not is_filled and choice.size is not None:
        choice.wrong_usage("--size is of what is filled; the cells of a mesh stay as they are: leave it out")
    if is_filled and glue not in (None, BY_ITSELF):
        choice.wrong_usage(f"--glue {glue:g}: solids are divided where they meet; use --glue without a number")
    for option in ("size", "scale"):
        if (given := getattr(choice, option)) is not None and not 0 < given < np.inf:
            choice.wrong_usage(f"--{option} {given:g}: use a finite number > 0")
    if choice.output.suffix != ".msh":
        choice.wrong_usage(f"-o {choice.output}: use the ending .msh")
    check_outputs(choice.output, inputs=[choice.file], force=choice.force)
    lines = {}
    if is_filled:
        with progress() as report:
            mesh = load("fem.filling", "fill_surface")(
                file, choice.output, choice.size, choice.scale, glue is not None, report
            )
    else:
        tolerance = None if glue == BY_ITSELF else glue
        glued = load("fem.gluing", "glue_mesh")(file, choice.output, tolerance, choice.scale)
        mesh, lines["nodes"] = glued.mesh, str(glued)
    places = mesh.points[mesh.cells].reshape(-1, 3)
    size = " x ".join(f"{length:.4g}" for length in np.ptp(places, axis=0))
    low, high = (", ".join(f"{x:.4g}" for x in ends(axis=0)) for ends in (places.min, places.max))
    sides = mesh.points[mesh.cells[:, [0, 1, 2, 3, 0, 1]]] - mesh.points[mesh.cells[:, [1, 2, 3, 0, 2, 3]]]
    lines["edges"] = f"{np.linalg.norm(sides, axis=2).mean():.3g} m on average"
    quality = load("fem.mesh_quality", "radius_ratios")(mesh.points, mesh.cells)
    print(f"mesh {choice.output}")
    print_lines({"body": f"{size} m, from ({low}) to ({high})", **lines, "cells": str(quality_of(quality))}, mesh.notes)
