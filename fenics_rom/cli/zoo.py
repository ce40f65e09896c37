"""`fenics-rom zoo`: which bodies are ready to move."""

import argparse

import fenics_rom as fr
from fenics_rom.cli.display import print_table

SUMMARY = "list the bodies of the zoo, with their errors and licences"
ERRORS = ("static", "shape", "outputs", "force")
HEADS = ("name", "what it is", "unknowns", "order", *ERRORS, "licence")


def add_options(command: argparse.ArgumentParser) -> None:
    """None."""


def run(choice: argparse.Namespace) -> None:
    """Prints the catalogue."""
    bodies = fr.zoo()
    rows = [
        (
            name,
            body.title,
            f"{body.unknowns:,}",
            str(body.order),
            *map(_shown, map(body.errors.get, ERRORS)),
            body.licence,
        )
        for name, body in bodies.items()
    ]
    print_table("the zoo; errors against full order, over the run of the scene but for static", HEADS, rows)
    for name, body in bodies.items():
        print(f"{name}: {body.use}; {body.source}")
    print("\nfenics-rom view zoo:NAME shows one, info and simulate take such names, too; in Python fr.load(NAME)")


def _shown(error: float | None) -> str:
    return "-" if error is None else f"{error:.1e}"
