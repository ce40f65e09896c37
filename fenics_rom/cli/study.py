"""`fenics-rom study`: what accuracy costs in time, for a scene."""

import argparse
import shlex
from pathlib import Path

import fenics_rom as fr
from fenics_rom.cli.display import print_lines, print_table, print_warnings, progress
from fenics_rom.cli.output import add_output
from fenics_rom.io.atomic_write import check_folder
from fenics_rom.io.mpi_ranks import is_rank_0, is_root_process
from fenics_rom.io.overwriting import check_outputs_in
from fenics_rom.studies.method_configs import METHOD_CONFIGS
from fenics_rom.studies.pareto import describe_choice, describe_full_steps, select_per_decade
from fenics_rom.studies.report import FILES, FORCE_HEADING, cost_heading, cost_rows, force_rows, remarks, write_report
from fenics_rom.studies.study_results import PICTURES, StudyResults
from fenics_rom.visualization.figure import figure_class

SUMMARY = "what accuracy costs in time, for a scene; runs under mpirun"
CHOICES = ("methods", "orders", "steps", "meshes", "quick", "without_reference", "resume", "force")
ROM = "rom.h5"  # in the folder of a study for a tolerance


def add_options(command: argparse.ArgumentParser) -> None:
    """What it is told."""
    command.add_argument("scene", metavar="SCENE", help="scene file (TOML)")
    add_output(command, "DIR", "folder for tables, pictures and the reference run")
    command.add_argument(
        "--tolerance", type=float, metavar="T", help="find the cheapest model for it, and write its ROM"
    )
    command.add_argument(
        "--quick", action="store_true", help="a first look, of a long run at its beginning: fewer methods and steps"
    )
    command.add_argument(
        "--without-reference",
        action="store_true",
        help="do not run full order: errors are estimates, and bounds, that reduced runs state of themselves",
    )
    command.add_argument("--methods", nargs="+", choices=METHOD_CONFIGS, help="where the bases come from")
    command.add_argument("--orders", nargs="+", type=int, metavar="M", help="displacements per contact mode")
    command.add_argument("--steps", nargs="+", type=float, metavar="S", help="time steps, s")
    command.add_argument(
        "--mesh", dest="meshes", nargs="+", default=[], metavar="FILE", help="finer meshes, to see the mesh's own error"
    )
    command.add_argument("--resume", action="store_true", help="go on from what a killed study left in DIR")


def run(choice: argparse.Namespace) -> None:
    """Studies; with large deformation over the size of the load."""
    if choice.tolerance is not None:
        given = [name for name in ("quick", "methods", "orders", "steps", "meshes") if getattr(choice, name)]
        if given:
            choice.wrong_usage(f"--tolerance finds method, order and step itself; it goes without --{given[0]}")
    if choice.without_reference and choice.meshes:
        choice.wrong_usage("--mesh compares meshes at full order, which --without-reference does not run")
    figure_class()
    check_folder(choice.output)
    scene = fr.read_scene(choice.scene)
    command = shlex.join(["fenics-rom", *choice.words])
    if scene.effects.large_deformation is not None:
        if choice.without_reference:
            choice.wrong_usage("--without-reference: a run with large_deformation does not know its error")
        given = [name for name in ("tolerance", "methods", "orders", "steps", "meshes") if getattr(choice, name)]
        if given:
            choice.wrong_usage(f"with large_deformation a study goes over the size of the load, without --{given[0]}")
        _study_amplitudes(scene, choice, command)
        return
    inputs = [*scene.files, *choice.meshes]
    check_outputs_in(choice.output, (*FILES, ROM), {ROM: "rom"}, inputs=inputs, force=choice.force)
    with progress() as report:
        if choice.tolerance is None:
            chosen = {name: getattr(choice, name) for name in CHOICES}
            results = fr.study(scene, choice.output, **chosen, report=report)
        else:
            from fenics_rom.studies.study import study_for_tolerance

            chosen = {name: getattr(choice, name) for name in ("without_reference", "resume", "force")}
            results, row, rom = study_for_tolerance(scene, choice.output, choice.tolerance, **chosen, report=report)
            fr.write_rom(choice.output / ROM, rom, force=True)  # or it was refused at the beginning
    write_report(choice.output, results, command)
    if not is_root_process():
        return
    if choice.tolerance is None:
        _print_results(results, choice.output)
    else:
        print(describe_choice(results, choice.tolerance, row))
        print(f"Its model, for --dt {row.dt:g}: {choice.output / ROM}; what was tried: {choice.output / 'study.md'}")
        print_warnings(remarks(results))


def _study_amplitudes(scene: "fr.Scene", choice: argparse.Namespace, command: str) -> None:
    from fenics_rom.studies.amplitude_report import FILES, TABLE_HEADING, table_rows, write_amplitude_report
    from fenics_rom.studies.amplitudes import study_amplitudes

    check_outputs_in(choice.output, FILES, inputs=scene.files, force=choice.force)
    chosen = {name: getattr(choice, name) for name in ("quick", "resume", "force")}
    with progress() as report:
        amplitudes = study_amplitudes(scene, choice.output, **chosen, report=report)
    if not is_rank_0():
        return
    write_amplitude_report(choice.output, amplitudes, command)
    if is_root_process():
        print_table(f"study {amplitudes.name}: what large deformation costs", TABLE_HEADING, table_rows(amplitudes))
        print(f"  table {choice.output / 'amplitudes.md'}, picture {choice.output / 'amplitudes.png'}")
        print_warnings(amplitudes.notes)


def _print_results(results: StudyResults, folder: Path) -> None:
    """What each decimal costs, and which model to choose for it."""
    title = f"study {results.name}: what each decimal costs"
    print_table(title, cost_heading(results), cost_rows(results))
    if results.reference_forces:
        print_table("contact forces: errors as shares of the reference's", FORCE_HEADING, force_rows(results))
    rate, reference = "not run", "none: errors are estimates; "
    if results.full_rate is not None:
        rate, reference = f"{results.full_rate:,.0f} steps/s {describe_full_steps(results)}", ""
    lines = {
        "full order": f"{results.size:,} unknowns, {rate}",
        "reference": f"{reference}steps of {results.reference_step:.3g} s, own error {results.reference_error:.1e}",
        "tables": f"{folder / 'study.md'}, {folder / 'study.csv'}",
        "pictures": ", ".join(str(folder / f"{name}.png") for name in PICTURES),
    }
    print_lines(lines, tuple(remarks(results)))
    for tolerance, row in select_per_decade(results.rows):
        print(f"  {describe_choice(results, tolerance, row)}")
