"""`fenics-rom identify`: material and damping from measured displacements of markers."""

import argparse
from pathlib import Path

import fenics_rom as fr
from fenics_rom.cli.display import print_lines, print_table, progress
from fenics_rom.cli.output import add_output
from fenics_rom.errors import SceneError
from fenics_rom.io.atomic_write import check_folder
from fenics_rom.io.mpi_ranks import is_root_process
from fenics_rom.io.overwriting import check_outputs_in
from fenics_rom.visualization.figure import figure_class

SUMMARY = "find material and damping from marker data, or a law of rubber from tests; runs under mpirun"


def add_options(command: argparse.ArgumentParser) -> None:
    """What it is told."""
    command.add_argument("scene", metavar="SCENE", help="scene file (TOML); its values are the start")
    command.add_argument(
        "--data",
        action="append",
        required=True,
        metavar="FILE.csv",
        help="measured displacements, or tests of rubber; once for each",
    )
    command.add_argument(
        "--also",
        action="append",
        nargs=2,
        default=[],
        metavar=("SCENE", "FILE.csv"),
        help="displacements measured on another scene of the same material: with other loads, or another start",
    )
    add_output(command, "DIR", "folder for the scene found, the report, the residuals and the picture of the fit")
    command.add_argument(
        "--parameters",
        type=lambda text: text.split(","),
        metavar="NAME,...",
        help="which to find: young, poisson, density, alpha, beta; MATERIAL.young of several materials; clock: how "
        "late that of each file is; tilt: how gravity is turned",
    )


def run(choice: argparse.Namespace) -> None:
    """Identifies, and writes what was found."""
    from fenics_rom.identification.rubber import is_rubber_data  # needs SciPy, which a run of a ROM does not
    from fenics_rom.identification.write import FILES

    figure_class()
    check_folder(choice.output)
    scene = fr.read_scene(choice.scene)
    if all(map(is_rubber_data, choice.data)):
        _fit_rubber(scene, choice)
        return
    with progress() as report:
        also = [fr.read_markers(file, fr.read_scene(other)) for other, file in choice.also]
        data = [*choice.data, *also]
        read = [*choice.data, *(file for part in also for file in (*part.scene.files, part.file))]
        check_outputs_in(choice.output, FILES, inputs=[*scene.files, *read], force=choice.force)
        result = fr.identify(scene, data, parameters=choice.parameters, report=report)
    fr.write_identification(choice.output, result, force=choice.force)
    if is_root_process():
        _print_identification(result, choice.output)


def _fit_rubber(scene: "fr.Scene", choice: argparse.Namespace) -> None:
    """Fits tests of rubber, and writes what was found."""
    from fenics_rom.identification.rubber_report import HEADING, law_lines, rows_of_tests

    for option in ("also", "parameters"):
        if getattr(choice, option):
            raise SceneError(f"--{option}: is of marker data; tests of rubber are fitted without")
    fit = fr.fit_rubber(scene, choice.data)
    fr.write_rubber_fit(choice.output, fit, force=choice.force)
    if is_root_process():
        print_table(f"rubber of {scene.name}: {choice.output}", HEADING, rows_of_tests(fit))
        print_lines(law_lines(fit), fit.warnings)


def _print_identification(result: "fr.Identification", folder: Path) -> None:
    """The parameters found, and how good the fit is."""
    # Needs SciPy, which a run of a ROM does not.
    from fenics_rom.identification.write import PARAMETER_HEADING, parameter_rows, summary_lines

    print_table(f"identification of {result.scene.name}: {folder}", PARAMETER_HEADING, parameter_rows(result))
    print_lines(summary_lines(result), result.warnings)
