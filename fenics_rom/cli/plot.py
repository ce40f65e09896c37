"""`fenics-rom plot`: plots of runs, or of a ROM."""

import argparse
from collections.abc import Sequence
from pathlib import Path

import fenics_rom as fr
from fenics_rom.cli.display import print_run_warnings, progress
from fenics_rom.cli.output import add_output
from fenics_rom.errors import FileError
from fenics_rom.io.hdf5 import content_of
from fenics_rom.io.overwriting import check_outputs
from fenics_rom.zoo_bodies import rom_file

SUMMARY = "draw energy and outputs of runs, or σ and responses of a ROM"


def add_options(command: argparse.ArgumentParser) -> None:
    """What it is told."""
    command.add_argument(
        "files", metavar="FILE.h5", nargs="+", help="a ROM (or zoo:NAME), or runs to be drawn over one another"
    )
    add_output(command, "OUT", "file (.pdf, .svg, .png) for all plots, or folder for a .pdf and a .png of each")
    command.add_argument(
        "--what",
        nargs="+",
        metavar="NAME",
        help="some of: energy, error, output_NAME, input_NAME, reading_NAME, taxels_NAME, slip_NAME, forces, pressure, "
        "pressure_map of runs; sigma, response of a ROM",
    )
    command.add_argument("--full", metavar="SCENE", help="solve for the full model's frequency responses, too")
    command.add_argument("--dark", action="store_true", help="light on dark")


def run(choice: argparse.Namespace) -> None:
    """Draws, and prints the names of the files."""
    from fenics_rom.visualization.plots.plot import is_folder

    choice.files = [rom_file(file) for file in choice.files]
    if not is_folder(choice.output):
        check_outputs(choice.output, inputs=[*choice.files, *filter(None, [choice.full])], force=choice.force)
    contents = [content_of(file) for file in choice.files]
    if "rom" in contents and len(contents) > 1:
        raise FileError("plots are of one ROM, or of any number of runs")
    if "rom" not in contents and choice.full is not None:
        raise FileError("--full is for a ROM: a run at full order is drawn like any other")
    with progress() as report:
        runs = {} if "rom" in contents else {n: fr.read_trajectory(file) for n, file in _labels(choice.files).items()}
        full = None if choice.full is None else fr.assemble(fr.read_scene(choice.full))
        chosen = {name: getattr(choice, name) for name in ("what", "dark", "force")}
        files = fr.plot(runs or choice.files[0], choice.output, **chosen, full=full, report=report)
    print(*files, sep="\n")
    print_run_warnings(runs)


def _labels(files: Sequence[str]) -> dict[str, str]:
    """Files by what they are called in a legend: their names without ending, where these differ."""
    names = [Path(file).stem for file in files]
    return dict(zip(names if len(set(names)) == len(names) else files, files, strict=True))
