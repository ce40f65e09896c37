"""`fenics-rom compile`: the first run of a model need not wait for numba."""

import argparse
from time import perf_counter

import fenics_rom as fr
from fenics_rom.compilation import cache_folder
from fenics_rom.zoo_bodies import model_file

SUMMARY = "compile what the steps of ROMs and worlds need (with numba), before the first run does"


def add_options(command: argparse.ArgumentParser) -> None:
    """What it is told."""
    command.add_argument("models", metavar="ROM.h5|WORLD", nargs="+", help="a ROM, a world file (TOML), or zoo:NAME")


def run(choice: argparse.Namespace) -> None:
    """Takes a few steps of each, and tells how long that took."""
    for model in choice.models:
        begun = perf_counter()
        fr.compile_steps(model_file(model))
        print(f"{model}: {perf_counter() - begun:.1f} s")
    print(f"what was compiled is in {cache_folder()}")
