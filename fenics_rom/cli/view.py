"""`fenics-rom view`: a ROM or a world live, or runs, in the browser."""

import argparse

from fenics_rom.zoo_bodies import model_file

SUMMARY = "show a ROM or a world live, or runs, in the browser"


def add_options(command: argparse.ArgumentParser) -> None:
    """What it is told."""
    command.add_argument(
        "files", metavar="FILE", nargs="+", help="a ROM or world to push (or zoo:NAME), a run, or two runs to compare"
    )
    command.add_argument("--port", type=_port, default=8080, metavar="N", help="tried first; else one that follows")
    command.add_argument("--no-browser", action="store_true", help="only print the address")
    command.add_argument("--dt", type=float, metavar="S", help="time step of what is live instead of its file's, s")


def run(choice: argparse.Namespace) -> None:
    """Serves the page until Ctrl-C."""
    if len(choice.files) > 2:
        choice.wrong_usage("use a ROM, a world, a run, or two runs")
    from fenics_rom.visualization.viewer.view import view

    view(*map(model_file, choice.files), port=choice.port, browser=not choice.no_browser, dt=choice.dt, wait=True)


def _port(text: str) -> int:
    if not (text.isdecimal() and int(text) < 2**16):
        raise argparse.ArgumentTypeError(f"{text!r}: use a whole number from 0 (any that is free) to 65535")
    return int(text)
