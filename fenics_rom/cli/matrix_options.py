"""Options of `reduce` that name Matrix Market files in place of a scene."""

import argparse

import fenics_rom as fr
from fenics_rom.io.names import NAME, NAME_IN_WORDS


def add_matrix_options(command: argparse.ArgumentParser) -> None:
    """Files of M v̇ + D v + K x = B u, y = Cᵀ x in place of a scene."""
    files = command.add_argument_group("instead of SCENE", "matrices of your own, each in a Matrix Market file")
    files.add_argument("--mass", metavar="M.mtx", help="symmetric positive definite")
    files.add_argument("--stiffness", metavar="K.mtx", help="symmetric positive definite")
    damping = files.add_mutually_exclusive_group()
    damping.add_argument("--damping", metavar="D.mtx", help="symmetric positive semi-definite")
    damping.add_argument("--rayleigh", nargs=2, type=float, metavar=("ALPHA", "BETA"), help="D = ALPHA M + BETA K")
    for option, metavar, what in (
        ("--contact", "NAME=B.mtx", "input columns of a contact mode; once for each"),
        ("--actuator", "NAME=F.mtx", "input columns that all contact modes have; once for each"),
        ("--observe", "NAME=C.mtx", "columns of an output; once for each"),
    ):
        files.add_argument(option, metavar=metavar, type=_named_file, action="append", default=[], help=what)


def _named_file(text: str) -> tuple[str, str]:
    name, _, file = text.partition("=")
    if not (NAME.fullmatch(name) and file):
        raise argparse.ArgumentTypeError(f"{text!r}: allowed is NAME=FILE, the name of {NAME_IN_WORDS}")
    return name, file


def matrix_files(choice: argparse.Namespace) -> list[str]:
    """The Matrix Market files to read, none where a scene is given; ends with status 2 where it is neither or both."""
    single = {"--mass": choice.mass, "--stiffness": choice.stiffness, "--damping": choice.damping}
    named = {"--contact": choice.contact, "--actuator": choice.actuator, "--observe": choice.observe}
    given = [option for option, value in (single | named).items() if value]
    given += ["--rayleigh"] if choice.rayleigh else []
    if choice.scene is not None:
        if given:
            choice.wrong_usage(f"SCENE and {', '.join(given)} cannot be used together")
        return []
    if not given:
        choice.wrong_usage("SCENE is needed, or --mass, --stiffness, --damping (or --rayleigh) and --contact")
    missing = [option for option in ("--mass", "--stiffness", "--contact") if option not in given]
    missing += ["--damping or --rayleigh"] if not {"--damping", "--rayleigh"} & set(given) else []
    if missing:
        choice.wrong_usage(f"matrices instead of SCENE: {', '.join(missing)} missing")
    for option, pairs in named.items():
        if len(dict(pairs)) < len(pairs):
            choice.wrong_usage(f"{option}: each name may be used once")
    return [*filter(None, single.values()), *(file for pairs in named.values() for _, file in pairs)]


def read_matrices(choice: argparse.Namespace) -> "fr.System":
    """The system of the files that were given."""
    return fr.read_system(
        mass=choice.mass,
        damping=choice.damping,
        rayleigh=tuple(choice.rayleigh) if choice.rayleigh else None,
        stiffness=choice.stiffness,
        contacts=dict(choice.contact),
        actuators=dict(choice.actuator),
        outputs=dict(choice.observe),
    )
