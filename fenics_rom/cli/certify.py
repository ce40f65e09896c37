"""`fenics-rom certify`: the worst impacts of a world over ranges of speeds, masses and poses."""

import argparse
from pathlib import Path

import fenics_rom as fr
from fenics_rom.cli.display import print_lines, print_table, progress
from fenics_rom.cli.output import add_output, check_other_name
from fenics_rom.errors import FileError
from fenics_rom.io.overwriting import check_outputs
from fenics_rom.lazy_import import load

SUMMARY = (
    "search the worst impacts of a world over the ranges of its [certificate]; exit status 3 where a limit is exceeded"
)
EXCEEDED = 3  # exit status


def add_options(command: argparse.ArgumentParser) -> None:
    """What it is told."""
    command.add_argument("world", metavar="WORLD", help="world file (TOML) with a [certificate]")
    add_output(command, "OUT.pdf", "page with what was found (.pdf, .png, .svg)")
    command.add_argument(
        "--json", type=Path, metavar="FILE", help="its numbers, which `fenics-rom check` verifies, and models beside it"
    )
    command.add_argument("--resume", action="store_true", help="go on from the runs that an interrupted search left")


def run(choice: argparse.Namespace) -> int:
    """Searches, and writes page and numbers; the exit status."""
    from fenics_rom.certification.certify import certify
    from fenics_rom.certification.file import model_files, write_certificate
    from fenics_rom.certification.report import HEADING, check_report, coverage_lines, finding_rows, write_report

    check_report(choice.output)
    check_other_name(choice, "json")
    world = fr.read_world(choice.world)
    inputs = load("scene.world_file", "files_of_world")(world)
    check_outputs(choice.output, inputs=inputs, force=choice.force)
    if choice.json is not None:
        soft = [name for name, body in world.file.bodies.items() if body.shape is None]
        check_outputs(choice.json, inputs=inputs, force=choice.force)
        models = model_files(choice.json, soft).values()
        check_outputs(*models, content="rom", inputs=inputs, force=choice.force)
    runs = choice.output.with_name(f"{choice.output.name}.runs")
    if not choice.resume:
        runs.unlink(missing_ok=True)
    elif not runs.exists():
        raise FileError(f"{runs}: there is nothing to go on from; leave out --resume")
    with progress() as report:
        certificate = certify(world, runs_file=runs, report=report)
    files = []
    if choice.json is not None:
        files = write_certificate(choice.json, certificate, force=choice.force)
    write_report(choice.output, certificate)
    runs.unlink()
    print_table(f"impacts of {world.file.name}", HEADING, finding_rows(certificate))
    print(*(f"  {line}" for line in coverage_lines(certificate)), sep="\n")
    print_lines({"written": ", ".join(map(str, [choice.output, *files]))}, tuple(certificate.warnings))
    return EXCEEDED if certificate.is_kept is False else 0
