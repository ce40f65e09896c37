"""`fenics-rom check`: whether a certificate of impact holds, from its numbers and models alone."""

import argparse
from pathlib import Path

from fenics_rom.cli.certify import EXCEEDED
from fenics_rom.cli.display import print_table, progress

SUMMARY = (
    "verify a certificate of impact from its numbers and models, and run the worst impacts again; exit status 3 where "
    "a limit is exceeded"
)


def add_options(command: argparse.ArgumentParser) -> None:
    """What it is told."""
    command.add_argument("certificate", type=Path, metavar="FILE.json", help="numbers that `certify` wrote")
    command.add_argument(
        "--runs", type=int, default=3, metavar="N", help="runs that are drawn at random and run again, beside the worst"
    )


def run(choice: argparse.Namespace) -> int:
    """Checks; what does not fit ends it with an error. The exit status."""
    from fenics_rom.certification.file import check_certificate
    from fenics_rom.certification.report import HEADING, coverage_lines, finding_rows

    if choice.runs < 0:
        choice.wrong_usage(f"--runs {choice.runs}: use a whole number >= 0")
    with progress() as report:
        certificate = check_certificate(choice.certificate, samples=choice.runs, report=report)
    print_table(f"impacts of {certificate.scene.file.name}", HEADING, finding_rows(certificate))
    print(*(f"  {line}" for line in coverage_lines(certificate)), sep="\n")
    print(f"  {choice.certificate}: holds; its seal, models and conclusions fit, and the worst runs were run again")
    return EXCEEDED if certificate.is_kept is False else 0
