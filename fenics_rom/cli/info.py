"""`fenics-rom info`: what is in a ROM or a run, and what the places of a scene pick."""

import argparse
from pathlib import Path
from typing import Any

import fenics_rom as fr
from fenics_rom.cli.display import print_rom, print_table, print_trajectory
from fenics_rom.cli.output import add_output
from fenics_rom.errors import FileError, SceneError
from fenics_rom.io.hdf5 import content_of
from fenics_rom.io.overwriting import check_outputs
from fenics_rom.lazy_import import load
from fenics_rom.zoo_bodies import rom_file

SUMMARY = "say what is in a ROM or a run, or what the places of a scene pick"
ROUND_OFF = 1e-12  # of the largest coordinate of a place: smaller ones are 0
HEADS = ("place", "picks", "count", "nodes", "size", "from (m)", "to (m)")


def add_options(command: argparse.ArgumentParser) -> None:
    """What it is told."""
    command.add_argument("file", metavar="FILE", help="a ROM (or zoo:NAME), a run, or with --surfaces a scene")
    command.add_argument(
        "--surfaces", action="store_true", help="list what each place of a scene, and each group of its mesh, picks"
    )
    add_output(command, "PICTURE.png", "with --surfaces: draw it, too", required=False)


def run(choice: argparse.Namespace) -> None:
    """Prints what `reduce` or `simulate` printed, or the places of a scene."""
    if choice.surfaces:
        _list_places(choice.file, choice.output, choice.force)
        return
    if choice.output is not None or choice.force:
        choice.wrong_usage("-o and --force go with --surfaces")
    if Path(choice.file).suffix == ".toml":
        raise FileError(
            f"{choice.file}: is not a fenics-rom file, a ROM or a run; of a scene --surfaces lists the places"
        )
    file = rom_file(choice.file)
    if content_of(file) == "rom":
        print_rom(fr.read_rom(file), file)
    else:
        print_trajectory(fr.read_trajectory(file), file)


def _list_places(file: str, picture: Path | None, force: bool) -> None:
    """What is picked, in a table and perhaps in a picture; SceneError where a place picks nothing."""
    scene = fr.read_scene(file)
    if picture is not None:
        from fenics_rom.visualization.exports.place_pictures import check_picture, draw_places

        check_picture(picture)
        check_outputs(picture, inputs=scene.files, force=force)
    survey = load("fem.named_places", "survey_places")(scene)
    print_table(f"places of {file}", HEADS, [_row(place) for place in survey.places])
    if picture is not None:
        draw_places(picture, survey.coordinates, survey.surface, survey.places)
        print(picture)
    if survey.mistakes:
        raise SceneError("; ".join(survey.mistakes))


def _row(place: Any) -> tuple[str, ...]:
    unit = {"triangles": " m²", "cells": " m³"}.get(place.kind)
    none = ROUND_OFF * max(abs(x) for corner in place.corners for x in corner)
    corners = (", ".join(f"{x if abs(x) > none else 0:.4g}" for x in corner) for corner in place.corners)
    size = "-" if unit is None else f"{place.size:.4g}{unit}"
    return (place.name, place.kind, str(place.count), str(len(place.nodes)), size, *corners)
