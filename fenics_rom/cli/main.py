"""The command line: `fenics-rom COMMAND ...`. Exit status 0 done, 1 could not be done, 2 wrong usage."""

import argparse
import io
import os
import shlex
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn

import fenics_rom as fr
from fenics_rom.cli.display import (
    print_findings,
    print_identification,
    print_record,
    print_rom,
    print_table,
    print_warnings,
    progress,
    rich_package,
)
from fenics_rom.errors import FenicsRomError, FenicsRomWarning, FileError, MissingPackageError, SceneError
from fenics_rom.io.hdf5 import check_folder, check_place, content_of, is_rank_0, write_whole
from fenics_rom.io.launcher import is_root_process, launched_rank
from fenics_rom.io.names import NAME, NAME_IN_WORDS
from fenics_rom.io.stages import Report
from fenics_rom.mechanics.environment import SWITCHINGS
from fenics_rom.scene.scene import LYAPUNOV, METHODS, SOLVERS, STEPPERS, WEIGHTINGS, Scene
from fenics_rom.studies.method_configs import METHOD_CONFIGS
from fenics_rom.system.system import is_petsc
from fenics_rom.visualization.exports.mode_shapes import SHAPE_KINDS
from fenics_rom.visualization.figure import figure_class

ROM = "rom.h5"  # in the folder of a study for a tolerance
PATIENCE = 5.0  # s that other ranks give rank 0 to say why the run ends
PETSC_COMMANDS = ("reduce", "solve", "study", "identify")
PETSC_WORD = "-fenics_rom_"  # what options for PETSc and SLEPc begin with
PETSC_HELP = """PETSc's and SLEPc's own options are passed on: -fenics_rom_factor_... for factorisations and the
iterative solver, -fenics_rom_eps_... and -fenics_rom_st_... for eigenvectors, such as
-fenics_rom_factor_mat_mumps_icntl_14 50. The word after such an option is its value; put those without a value last."""


def main(arguments: list[str] | None = None) -> NoReturn:
    """Runs one command and exits."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without σ gets a ?
    words, petsc = _petsc_options(sys.argv[1:] if arguments is None else arguments)
    choice = _parser().parse_args(words)
    choice.words = words
    warnings.simplefilter("ignore", FenicsRomWarning)  # the summary at the end lists them
    try:
        rich_package()  # before long work, not after it
        _set_petsc_options(petsc)
        choice.run(choice)
        _print_unused(petsc)
        sys.stdout.flush()
    except FenicsRomError as error:
        _give_up(str(error))
    except MemoryError as error:
        _give_up(f"not enough memory: {error}")
    except KeyboardInterrupt:
        _give_up("interrupted")
    except BrokenPipeError:  # whoever read the output has seen enough
        _drop_output()
    except OSError as error:
        _drop_output()
        _give_up(str(error))
    except Exception as error:
        if is_petsc(error):  # most likely of an option with a value that there is not
            _give_up(f"PETSc: {error}")
        traceback.print_exc()
        _end(1)
    sys.exit(0)


def _give_up(reason: str) -> NoReturn:
    """Says why, once, and ends every rank: an error of one rank must not leave the others waiting."""
    if not is_root_process():
        time.sleep(PATIENCE)  # in nearly every case rank 0 says the same and ends this rank too
    print(f"fenics-rom: error: {' '.join(reason.split())}", file=sys.stderr, flush=True)
    _end(1)


def _drop_output() -> None:
    """What standard output could not take is not to be tried again at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _end(status: int) -> NoReturn:
    """Ends every rank."""
    sys.stderr.flush()
    ranks = getattr(sys.modules.get("mpi4py.MPI"), "COMM_WORLD", None)
    if ranks is not None and ranks.size > 1:
        ranks.Abort(status)
    if launched_rank() is not None:  # an import that was interrupted may have begun MPI, whose end waits for all ranks
        os._exit(status)
    sys.exit(status)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="fenics-rom", description="Soft bodies with changing contacts, reduced and run in real time."
    )
    parser.add_argument("--version", action="version", version=f"fenics-rom {fr.__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)

    command = _command(commands, "reduce", _reduce, "reduce a scene, or matrices, to a ROM; runs under mpirun")
    command.add_argument("scene", metavar="SCENE", nargs="?", help="scene file (TOML)")
    _matrix_options(command)
    _output(command, "ROM.h5")
    group = command.add_mutually_exclusive_group()
    group.add_argument("--order", type=int, metavar="M", help="displacements per contact mode")
    group.add_argument("--tolerance", type=float, metavar="T", help="share of the sum of σ that may be left out")
    command.add_argument("--method", choices=METHODS, help="where the bases come from")
    command.add_argument("--switching", choices=SWITCHINGS, help="how states are carried between contact modes")
    command.add_argument("--weighting", choices=WEIGHTINGS, help="what of the shape counts")
    command.add_argument("--lyapunov", choices=LYAPUNOV, help="route to the Gramians")
    command.add_argument("--share", type=float, help="of the covariance's trace, for --switching modal")
    command.add_argument("--solver", choices=SOLVERS, default="auto", help="for the stiffness matrix")
    command.add_argument("--resume", action="store_true", help="go on from what a killed run left in ROM.h5.partial")

    command = _command(commands, "solve", _solve, "run the full-order model: the reference; runs under mpirun")
    command.add_argument("scene", metavar="SCENE", help="scene file (TOML)")
    _output(command, "RUN.h5")
    command.add_argument("--dt", type=float, metavar="S", help="time step instead of the scene's, s")

    command = _command(commands, "simulate", _simulate, "run a ROM through the load history of its scene")
    command.add_argument("rom", metavar="ROM.h5", help="a file that `reduce` wrote")
    _output(command, "RUN.h5")
    command.add_argument("--scene", metavar="SCENE", help="take load history and effects of this scene")
    command.add_argument("--dt", type=float, metavar="S", help="time step instead of the scene's, s")
    command.add_argument("--order", type=int, metavar="M", help="run at a lower order than the ROM's")
    command.add_argument("--profile", action="store_true", help="measure what each effect costs in a step")
    command.add_argument(
        "--stepper", choices=STEPPERS, help="of large deformation: newton for large steps, linearly-implicit for small"
    )

    command = _command(commands, "study", _study, "what accuracy costs in time, for a scene; runs under mpirun")
    command.add_argument("scene", metavar="SCENE", help="scene file (TOML)")
    _output(command, "DIR", "folder for tables, pictures and the reference run")
    command.add_argument(
        "--tolerance", type=float, metavar="T", help="find the cheapest model for it, and write its ROM"
    )
    command.add_argument("--quick", action="store_true", help="fewer methods, orders and steps: a first look")
    command.add_argument("--methods", nargs="+", choices=METHOD_CONFIGS, help="where the bases come from")
    command.add_argument("--orders", nargs="+", type=int, metavar="M", help="displacements per contact mode")
    command.add_argument("--steps", nargs="+", type=float, metavar="S", help="time steps, s")
    command.add_argument(
        "--mesh", dest="meshes", nargs="+", default=[], metavar="FILE", help="finer meshes, to see the mesh's own error"
    )
    command.add_argument("--resume", action="store_true", help="go on from what a killed study left in DIR")

    command = _command(commands, "identify", _identify, "find material and damping from marker data; runs under mpirun")
    command.add_argument("scene", metavar="SCENE", help="scene file (TOML); its values are the start")
    command.add_argument(
        "--data", action="append", required=True, metavar="FILE.csv", help="measured displacements; once for each file"
    )
    _output(command, "DIR", "folder for the scene found, the report, the residuals and the picture of the fit")
    command.add_argument(
        "--parameters",
        type=lambda text: text.split(","),
        metavar="NAME,...",
        help="which to find: young, poisson, density, alpha, beta; MATERIAL.young of several materials",
    )

    command = _command(commands, "info", _info, "say what is in a ROM or a run")
    command.add_argument("file", metavar="FILE.h5")

    command = _command(commands, "view", _view, "show a ROM live, or runs, in the browser")
    command.add_argument("files", metavar="FILE.h5", nargs="+", help="a ROM to push, a run, or two runs to compare")
    command.add_argument("--port", type=_port, default=8080, metavar="N", help="tried first; else one that follows")
    command.add_argument("--no-browser", action="store_true", help="only print the address")
    command.add_argument("--dt", type=float, metavar="S", help="time step of a ROM instead of the scene's, s")

    command = _command(commands, "compare", _compare, "relative errors of one run against another")
    command.add_argument("run_file", metavar="A.h5", help="a run")
    command.add_argument("reference", metavar="B.h5", help="the run it is measured against")

    command = _command(commands, "plot", _plot, "draw energy and outputs of runs, or σ and responses of a ROM")
    command.add_argument("files", metavar="FILE.h5", nargs="+", help="a ROM, or runs to be drawn over one another")
    _output(command, "OUT", "file (.pdf, .svg, .png) for all plots, or folder for a .pdf and a .png of each")
    command.add_argument(
        "--what",
        nargs="+",
        metavar="NAME",
        help="some of: energy, output_NAME, forces of runs; sigma, response of a ROM",
    )
    command.add_argument("--full", metavar="SCENE", help="solve for the full model's frequency responses, too")
    command.add_argument("--dark", action="store_true", help="light on dark")

    command = _command(commands, "export", _export, "write files for ParaView, pictures and films")
    command.add_argument("file", metavar="FILE.h5", help="a ROM or a run")
    _output(command, "OUT", "of a run .pvd, .vtu, .png, .gif or .mp4; of a ROM .vtu, or .png, .pdf, .svg")
    command.add_argument("--what", choices=SHAPE_KINDS, help="shapes of a ROM; modes, unless others are asked for")
    command.add_argument("--count", type=int, metavar="N", help="shapes of each contact mode")
    command.add_argument("--time", type=float, metavar="S", help="instant of a run for .vtu and .png, s; else the last")
    command.add_argument("--scale", type=float, metavar="X", default=1.0, help="of displacements in pictures of a run")
    command.add_argument("--seconds", type=float, metavar="S", help="length of .gif and .mp4; else at most 10 s")
    command.add_argument("--dark", action="store_true", help="light on dark")
    return parser


def _command(commands: Any, name: str, run: Callable[[Any], None], summary: str) -> argparse.ArgumentParser:
    epilog = PETSC_HELP if name in PETSC_COMMANDS else None
    command: argparse.ArgumentParser = commands.add_parser(name, help=summary, description=summary, epilog=epilog)
    command.set_defaults(run=run, wrong_usage=command.error)
    return command


def _matrix_options(command: argparse.ArgumentParser) -> None:
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


def _port(text: str) -> int:
    if not (text.isdecimal() and int(text) < 2**16):
        raise argparse.ArgumentTypeError(f"{text!r}: allowed is a whole number from 0 (any that is free) to 65535")
    return int(text)


def _output(command: argparse.ArgumentParser, metavar: str, what: str = "file to write") -> None:
    command.add_argument("-o", "--output", type=Path, required=True, metavar=metavar, help=what)


def _petsc_options(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Splits the words of a command line into ours and PETSc's options with their values."""
    if not arguments or arguments[0] not in PETSC_COMMANDS:
        return list(arguments), []
    ours: list[str] = []
    petsc: list[str] = []
    value_may_follow = False
    for word in arguments:
        option = word.startswith(PETSC_WORD)
        value = value_may_follow and not (word.startswith("-") and not word[1:2].isdigit())
        (petsc if option or value else ours).append(word)
        value_may_follow = option
    return ours, petsc


def _set_petsc_options(words: list[str]) -> None:
    if not words:
        return
    try:
        from fenics_rom.fem.options import set_options
    except ModuleNotFoundError as error:
        raise MissingPackageError(f"options of PETSc need {error.name}, which this Python lacks") from error
    set_options(words)


def _print_unused(words: list[str]) -> None:
    """A typing error in an option must not pass in silence."""
    if words and is_root_process():
        from fenics_rom.fem.options import unused_options

        print_warnings([f"option {name} was given, but nothing has read it" for name in unused_options()])


def _reduce(choice: Any) -> None:
    from fenics_rom.reduction.checkpoint import remove_checkpoint

    files = _matrix_files(choice)
    _check_output(choice.output, choice.scene, *files)
    partial = Path(f"{choice.output}.partial")
    if partial.exists() and not partial.is_dir():
        raise FileError(f"{partial}: is needed for what is finished, but it is not a folder")
    if choice.tolerance is not None and not 0 < choice.tolerance < 1:
        raise SceneError(f"--tolerance {choice.tolerance:g}: allowed is more than 0 and less than 1")
    if choice.share is not None and not 0 < choice.share <= 1:
        raise SceneError(f"--share {choice.share:g}: allowed is more than 0 and at most 1")
    if choice.order is not None and choice.order < 1:
        raise SceneError(f"--order {choice.order}: allowed are whole numbers from 1")
    begun: dict[str, tuple[int, int]] = {}  # what was done already when a stage began, and of how much
    with progress() as show:

        def report(stage: str, done: int, of: int) -> None:
            begun.setdefault(stage, (done, of))
            show(stage, done, of)

        report("assembly", 0, 1)
        system = _system(choice) if files else fr.assemble(fr.read_scene(choice.scene))
        report("assembly", 1, 1)
        rom = _reduced(system, choice, partial, report)
    fr.write_rom(choice.output, rom)
    remove_checkpoint(partial)
    if is_root_process():
        print_rom(rom, choice.output)
        if choice.resume:
            print("  resumed: {} of {} contact modes were taken over".format(*begun["contact modes"]))


def _reduced(system: fr.System, choice: Any, partial: Path, report: Report) -> fr.Rom:
    """The ROM; what is finished is kept in a folder meanwhile, and stays there when something ends the run."""
    try:
        return fr.reduce(
            system,
            order=choice.order,
            tolerance=choice.tolerance,
            method=choice.method,
            switching=choice.switching,
            weighting=choice.weighting,
            lyapunov=choice.lyapunov,
            share=choice.share,
            solver=choice.solver,
            checkpoint=partial,
            resume=choice.resume,
            report=report,
        )
    except BaseException:
        with suppress(OSError):  # it is not there, or holds something
            partial.rmdir()
        raise


def _matrix_files(choice: Any) -> list[str]:
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


def _system(choice: Any) -> fr.System:
    return fr.read_system(
        mass=choice.mass,
        damping=choice.damping,
        rayleigh=tuple(choice.rayleigh) if choice.rayleigh else None,
        stiffness=choice.stiffness,
        contacts=dict(choice.contact),
        actuators=dict(choice.actuator),
        outputs=dict(choice.observe),
    )


def _solve(choice: Any) -> None:
    _check_output(choice.output, choice.scene)
    scene = fr.read_scene(choice.scene)
    with progress() as report:
        record = fr.solve(scene, dt=choice.dt, report=report)
    fr.write_trajectory(choice.output, record)
    if is_root_process():
        print_record(record, choice.output)


def _simulate(choice: Any) -> None:
    _check_output(choice.output, choice.rom, choice.scene)
    rom = fr.read_rom(choice.rom)
    if choice.order is not None:
        rom = fr.truncated(rom, choice.order)
    scene = fr.read_scene(choice.scene) if choice.scene else None
    with progress() as report:
        record = fr.simulate(
            rom, scene=scene, dt=choice.dt, profile=choice.profile, stepper=choice.stepper, report=report
        )
    fr.write_trajectory(choice.output, record)
    if is_root_process():
        print_record(record, choice.output)


def _study(choice: Any) -> None:
    from fenics_rom.studies.pareto import describe_choice
    from fenics_rom.studies.report import write_report
    from fenics_rom.studies.tables import remarks

    if choice.tolerance is not None:
        given = [name for name in ("quick", "methods", "orders", "steps", "meshes") if getattr(choice, name)]
        if given:
            choice.wrong_usage(f"--tolerance finds method, order and step itself; it goes without --{given[0]}")
    figure_class()
    check_folder(choice.output)
    scene = fr.read_scene(choice.scene)
    command = shlex.join(["fenics-rom", *choice.words])
    if "large_deformation" in scene.effects:
        given = [name for name in ("tolerance", "methods", "orders", "steps", "meshes") if getattr(choice, name)]
        if given:
            choice.wrong_usage(f"with large_deformation a study goes over the size of the load, without --{given[0]}")
        _study_amplitudes(scene, choice, command)
        return
    with progress() as report:
        if choice.tolerance is None:
            findings = fr.study(
                scene,
                choice.output,
                methods=choice.methods,
                orders=choice.orders,
                steps=choice.steps,
                meshes=choice.meshes,
                quick=choice.quick,
                resume=choice.resume,
                report=report,
            )
        else:
            from fenics_rom.studies.study import study_for_tolerance

            findings, row, rom = study_for_tolerance(
                scene, choice.output, choice.tolerance, resume=choice.resume, report=report
            )
            fr.write_rom(choice.output / ROM, rom)
    write_report(choice.output, findings, command)
    if not is_root_process():
        return
    if choice.tolerance is None:
        print_findings(findings, choice.output)
    else:
        print(describe_choice(findings, choice.tolerance, row))
        print(f"Its model, for --dt {row.dt:g}: {choice.output / ROM}; what was tried: {choice.output / 'study.md'}")
        print_warnings(remarks(findings))


def _study_amplitudes(scene: Scene, choice: Any, command: str) -> None:
    from fenics_rom.studies.amplitude_plot import draw
    from fenics_rom.studies.amplitude_table import TABLE_HEADING, markdown_report, table_rows
    from fenics_rom.studies.amplitudes import study_amplitudes

    with progress() as report:
        found = study_amplitudes(scene, choice.output, quick=choice.quick, resume=choice.resume, report=report)
    if not is_rank_0():
        return
    write_whole(choice.output / "amplitudes.md", markdown_report(found, command).encode())
    draw(found, choice.output)
    if is_root_process():
        print_table(f"study {found.name}: what large deformation costs", TABLE_HEADING, table_rows(found))
        print(f"  table {choice.output / 'amplitudes.md'}, picture {choice.output / 'amplitudes.png'}")
        print_warnings(found.notes)


def _identify(choice: Any) -> None:
    figure_class()
    check_folder(choice.output)
    scene = fr.read_scene(choice.scene)
    with progress() as report:
        result = fr.identify(scene, choice.data, parameters=choice.parameters, report=report)
    fr.write_identification(choice.output, result)
    if is_root_process():
        print_identification(result, choice.output)


def _info(choice: Any) -> None:
    if content_of(choice.file) == "rom":
        print_rom(fr.read_rom(choice.file), choice.file)
    else:
        print_record(fr.read_trajectory(choice.file), choice.file)


def _compare(choice: Any) -> None:
    differences = fr.compare(fr.read_trajectory(choice.run_file), fr.read_trajectory(choice.reference))
    rows = [
        (
            name,
            f"{d.relative:.2e}",
            f"{d.largest:.2e} {'J' if name == 'energy' else 'm'}",
            f"{d.largest_reference:.2e} {'J' if name == 'energy' else 'm'}",
            str(d.instants),
        )
        for name, d in differences.items()
    ]
    title = f"{choice.run_file} against {choice.reference}"
    print_table(title, ("quantity", "relative error", "largest error", "of", "instants"), rows)


def _plot(choice: Any) -> None:
    from fenics_rom.visualization.plots.plot import check_output

    check_output(choice.output)
    contents = [content_of(file) for file in choice.files]
    if "rom" in contents and len(contents) > 1:
        raise FileError("plots are of one ROM, or of any number of runs")
    if "rom" not in contents and choice.full is not None:
        raise FileError("--full is for a ROM: a run at full order is drawn like any other")
    with progress() as report:
        if "rom" in contents:
            model: Any = fr.read_rom(choice.files[0])
            full = fr.assemble(fr.read_scene(choice.full)) if choice.full is not None else None
        else:
            model, full = {name: fr.read_trajectory(file) for name, file in _labels(choice.files).items()}, None
        files = fr.plot(model, choice.output, what=choice.what, dark=choice.dark, full=full, report=report)
    print(*files, sep="\n")


def _labels(files: Sequence[str]) -> dict[str, str]:
    """Files by what they are called in a legend: their names without ending, where these differ."""
    names = [Path(file).stem for file in files]
    return dict(zip(names if len(set(names)) == len(names) else files, files, strict=True))


def _export(choice: Any) -> None:
    model: Any = fr.read_rom(choice.file) if content_of(choice.file) == "rom" else fr.read_trajectory(choice.file)
    with progress() as report:
        file = fr.export(
            model,
            choice.output,
            what=choice.what,
            count=choice.count,
            time=choice.time,
            scale=choice.scale,
            seconds=choice.seconds,
            dark=choice.dark,
            report=report,
        )
    print(file)


def _view(choice: Any) -> None:
    if len(choice.files) > 2:
        choice.wrong_usage("allowed are a ROM, a run, or two runs")
    from fenics_rom.visualization.viewer.view import view

    view([Path(file) for file in choice.files], port=choice.port, browser=not choice.no_browser, dt=choice.dt)


def _check_output(output: Path, *inputs: str | None) -> None:
    """Before long work, not after it."""
    check_place(output)
    for name in inputs:
        if name is not None and output.exists() and Path(name).exists() and output.samefile(name):
            raise FileError(f"{output}: is read by this command, so it cannot be its output")
