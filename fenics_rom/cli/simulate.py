"""`fenics-rom simulate`: a scene at full order, or a ROM, through a load history."""

import argparse
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import fenics_rom as fr
from fenics_rom.cli.display import print_trajectory, progress
from fenics_rom.cli.output import add_output, check_other_name
from fenics_rom.errors import ToleranceWarning
from fenics_rom.io.mpi_ranks import is_root_process
from fenics_rom.io.overwriting import check_outputs
from fenics_rom.lazy_import import load
from fenics_rom.mechanics.step import FINITE_STRAIN_STEPPERS
from fenics_rom.run import is_rom_file, is_world_file
from fenics_rom.zoo_bodies import model_file

SUMMARY = "run a scene at full order (also under mpirun), a ROM or a world through its load history"
OF_RUNS = ("dt", "every", "profile", "rate", "stepper", "step_error", "errors", "error_tolerance")  # options of a ROM
FOR_ROMS = ("scene", "order", "enrich", "enriched", "finer", *OF_RUNS[2:])


def add_options(command: argparse.ArgumentParser) -> None:
    """What it is told."""
    command.add_argument(
        "model",
        metavar="SCENE|WORLD|ROM.h5",
        help="a scene or world file (TOML), a file that `reduce` wrote, or zoo:NAME",
    )
    add_output(command, "RUN.h5")
    command.add_argument("--dt", type=float, metavar="S", help="time step instead of the scene's, s")
    command.add_argument("--every", type=int, metavar="N", help="keep every N-th step alone, instead of the scene's")
    command.add_argument(
        "--arc-length",
        action="store_true",
        help="of a scene without inertia: follow loads along the path of equilibria, beyond limit points",
    )
    group = command.add_argument_group("of a ROM")
    group.add_argument("--scene", metavar="SCENE", help="take load history and effects of this scene")
    group.add_argument("--order", type=int, metavar="M", help="run at a lower order than the ROM's")
    group.add_argument("--profile", action="store_true", help="run again to measure what each effect costs in a step")
    group.add_argument("--rate", action="store_true", help="run again to measure steps per second")
    group.add_argument(
        "--stepper",
        choices=FINITE_STRAIN_STEPPERS,
        help="of large deformation: newton for large steps, linearly-implicit for small",
    )
    group.add_argument(
        "--step-error",
        type=float,
        metavar="E",
        help="of large deformation: take the stepper that costs least of those whose steps have at most this error, as "
        "a share of the largest displacement, which is measured; where none has, tell which dt would do",
    )
    group.add_argument(
        "--errors",
        action="store_true",
        default=None,
        help="refuse a ROM whose runs do not tell their error; those of reduce --errors do anyway: a bound and an "
        "estimate, among obstacles the estimate alone",
    )
    group.add_argument(
        "--error-tolerance",
        type=float,
        metavar="M",
        help="say so at once where the estimate of an output's error is larger, m; instead of the scene's",
    )
    group.add_argument(
        "--enrich", action="store_true", help="add directions to the basis there, by solves with the system of --scene"
    )
    group.add_argument(
        "--finer",
        metavar="ROM.h5",
        help="a ROM of higher order, which takes the same steps beside: estimates for bodies without their own",
    )
    group.add_argument("--enriched", type=Path, metavar="ROM.h5", help="write the ROM with these directions")


def option(name: str) -> str:
    """As it is given."""
    return f"--{name.replace('_', '-')}"


@contextmanager
def _told_at_once() -> Iterator[None]:
    """In which a tolerance that is exceeded is told on standard error as it is, not at the end alone."""

    def show(message: Warning | str, *_: Any, **__: Any) -> None:
        print(f"fenics-rom: {message}", file=sys.stderr, flush=True)

    with warnings.catch_warnings():
        warnings.simplefilter("always", ToleranceWarning)
        warnings.showwarning = show
        yield


def _enrichment(choice: argparse.Namespace, rom: "fr.Rom", scene: "fr.Scene | None") -> "fr.Enrichment | None":
    """What adds directions, if that is asked for on the line or in the scene."""
    asked = choice.enrich or (scene is not None and scene.run is not None and scene.run.enrich)
    if choice.enriched is not None:
        if not asked:
            choice.wrong_usage("--enriched: writes what --enrich adds, which is not asked for")
        inputs = [*filter(None, (choice.model, choice.scene, choice.finer))]
        check_outputs(choice.enriched, content="rom", inputs=inputs, force=choice.force)
    if not asked:
        return None
    if scene is None:
        choice.wrong_usage("--enrich: solves with the full system, which --scene SCENE is of")
        return None
    return fr.Enrichment(rom, fr.assemble(scene))


def run(choice: argparse.Namespace) -> None:
    """Simulates, and writes the run."""
    choice.model = model_file(choice.model)
    check_other_name(choice, "enriched")
    named = [choice.model, *filter(None, [choice.scene, choice.finer])]  # which may name other files
    check_outputs(choice.output, inputs=named, force=True)

    def check(*inputs: Path) -> None:
        check_outputs(choice.output, content="run", inputs=inputs, force=choice.force)

    with progress() as report:
        is_scene = not (is_rom_file(choice.model) or is_world_file(choice.model))
        if choice.arc_length and not is_scene:
            choice.wrong_usage(f"--arc-length: for a scene, run at full order; {choice.model} is none")
        if is_rom_file(choice.model):
            if choice.petsc_words:
                choice.wrong_usage(f"{choice.petsc_words[0]} is for a scene; {choice.model} is a ROM")
            rom = fr.read_rom(choice.model)
            if choice.order is not None:
                rom = fr.truncate(rom, choice.order)
            scene = fr.read_scene(choice.scene) if choice.scene else None
            check(*(scene.files if scene else ()))
            chosen = {name: getattr(choice, name) for name in OF_RUNS}
            enrichment, finer = _enrichment(choice, rom, scene), choice.finer and fr.read_rom(choice.finer)
            with _told_at_once():
                trajectory = fr.simulate(rom, scene=scene, **chosen, enrich=enrichment, finer=finer, report=report)
            if choice.enriched is not None and enrichment is not None:
                fr.write_rom(choice.enriched, enrichment.rom, force=choice.force)
        elif is_world_file(choice.model):
            given = [option(name) for name in FOR_ROMS if name != "rate" and getattr(choice, name)]
            if given or choice.petsc_words:
                choice.wrong_usage(f"{', '.join([*given, *choice.petsc_words])}: not for a world, as {choice.model} is")
            world = fr.read_world(choice.model)
            check(*load("scene.world_file", "files_of_world")(world))
            trajectory = fr.simulate(world, dt=choice.dt, every=choice.every, rate=choice.rate, report=report)
        else:
            options = {option(name): getattr(choice, name) for name in FOR_ROMS}
            given = [name for name, value in options.items() if value is not None and value is not False]
            if given:
                choice.wrong_usage(f"{', '.join(given)}: for a ROM; {choice.model} is a scene, run at full order")
            from fenics_rom.reduction.rigid_mode_deflation import first_frequency

            scene = fr.read_scene(choice.model)
            check(*scene.files)
            system = fr.assemble(scene)
            chosen = {name: getattr(choice, name) for name in ("dt", "every", "arc_length")}
            trajectory = fr.simulate(system, **chosen, report=report)
            settings = {**trajectory.settings, "first_frequency": first_frequency(system)}
            trajectory = replace(trajectory, settings=settings)
    fr.write_trajectory(choice.output, trajectory, force=choice.force)
    if is_root_process():
        print_trajectory(trajectory, choice.output)
