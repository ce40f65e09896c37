"""`fenics-rom compare`: how far one run is from another."""

import argparse

import fenics_rom as fr
from fenics_rom.cli.display import print_run_warnings, print_table
from fenics_rom.errors import CompareError

SUMMARY = "relative errors of one run against another"


def add_options(command: argparse.ArgumentParser) -> None:
    """What it is told."""
    command.add_argument("run_file", metavar="A.h5", help="a run")
    command.add_argument("reference", metavar="B.h5", help="the run it is measured against")
    command.add_argument("--finer", metavar="C.h5", help="B at a smaller step: how far B is from it stands beside")


def run(choice: argparse.Namespace) -> None:
    """Prints a row for each output and reading, the shape, the energy, what obstacles did, and what runs warn of."""
    run, reference = fr.read_trajectory(choice.run_file), fr.read_trajectory(choice.reference)
    steps = {} if choice.finer is None else fr.compare(reference, _finer(choice, reference))
    beside = ("by the step of B",) if steps else ()
    rows = [
        (
            name,
            f"{d.relative:.2e}",
            *(f"{steps[name].relative:.2e}" if name in steps else "-" for _ in beside),
            f"{d.largest:.2e} {d.unit}",
            f"{d.largest_reference:.2e} {d.unit}",
            str(d.instants),
        )
        for name, d in fr.compare(run, reference).items()
    ]
    title = f"{choice.run_file} against {choice.reference}"
    print_table(title, ("quantity", "relative error", *beside, "largest error", "of", "instants"), rows)
    if not steps and run.settings["dt"] == reference.settings["dt"]:
        print(
            f"  both took steps of {run.settings['dt']:g} s, so that step's own error is in both and not seen here; "
            "--finer FILE, a run of shorter steps, shows it"
        )
    files = {choice.run_file: run, choice.reference: reference}
    print_run_warnings(files)


def _finer(choice: argparse.Namespace, reference: "fr.Trajectory") -> "fr.Trajectory":
    """The run that the reference's step is judged by; CompareError where its steps are no shorter."""
    finer = fr.read_trajectory(choice.finer)
    given, allowed = finer.settings["dt"], reference.settings["dt"]
    if not given < allowed:
        raise CompareError(
            f"--finer {choice.finer}: took steps of {given:g} s; use shorter ones than the {allowed:g} s of "
            f"{choice.reference}"
        )
    return finer
