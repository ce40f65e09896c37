"""The command line: `fenics-rom COMMAND ...`. Exit status 0 done, 1 could not be done, 2 wrong usage."""

import argparse
import io
import os
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

import fenics_rom as fr
from fenics_rom.checked_file import check_place, content_of
from fenics_rom.errors import FenicsRomError, FenicsRomWarning, MissingPackageError, RomFileError, SceneError
from fenics_rom.scene import LYAPUNOV, SWITCHINGS, WEIGHTINGS

PATIENCE = 5.0  # s that other ranks give rank 0 to say why the run ends


def main(arguments: list[str] | None = None) -> NoReturn:
    """Runs one command and exits."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without σ gets a ?
    choice = _parser().parse_args(arguments)
    warnings.simplefilter("ignore", FenicsRomWarning)  # the summary at the end lists them
    try:
        _rich()  # before long work, not after it
        choice.run(choice)
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
    except Exception:
        traceback.print_exc()
        _end(1)
    sys.exit(0)


def _speaks() -> bool:
    """Whether this process is the first that mpirun started, or the only one; known before MPI is."""
    ranks = (os.environ.get(name) for name in ("OMPI_COMM_WORLD_RANK", "PMIX_RANK", "PMI_RANK"))
    return next((rank for rank in ranks if rank is not None), "0") == "0"


def _give_up(reason: str) -> NoReturn:
    """Says why, once, and ends every rank: an error of one rank must not leave the others waiting."""
    if not _speaks():
        time.sleep(PATIENCE)  # in nearly every case rank 0 says the same and ends this rank too
    print(f"fenics-rom: error: {' '.join(reason.split())}", file=sys.stderr, flush=True)
    _end(1)


def _drop_output() -> None:
    """What standard output could not take is not to be tried again at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _end(status: int) -> NoReturn:
    """Ends every rank."""
    ranks = sys.modules.get("mpi4py.MPI")
    if ranks is not None and ranks.COMM_WORLD.size > 1:
        sys.stderr.flush()
        ranks.COMM_WORLD.Abort(status)
    sys.exit(status)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="fenics-rom", description="Soft bodies with changing contacts, reduced and run in real time."
    )
    parser.add_argument("--version", action="version", version=f"fenics-rom {fr.__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)

    command = _command(commands, "reduce", _reduce, "assemble a scene and write its ROM; runs under mpirun")
    command.add_argument("scene", metavar="SCENE", help="scene file (TOML)")
    _output(command, "ROM.h5")
    group = command.add_mutually_exclusive_group()
    group.add_argument("--order", type=int, metavar="M", help="balanced displacements per contact mode")
    group.add_argument("--tolerance", type=float, metavar="T", help="share of the sum of σ that may be left out")
    command.add_argument("--switching", choices=SWITCHINGS, help="how states are carried between contact modes")
    command.add_argument("--weighting", choices=WEIGHTINGS, help="what of the shape counts")
    command.add_argument("--lyapunov", choices=LYAPUNOV, help="route to the Gramians")
    command.add_argument("--share", type=float, help="of the covariance's trace, for --switching modal")

    command = _command(commands, "solve", _solve, "run the full-order model: the reference; runs under mpirun")
    command.add_argument("scene", metavar="SCENE", help="scene file (TOML)")
    _output(command, "RUN.h5")
    command.add_argument("--dt", type=float, metavar="S", help="time step instead of the scene's, s")

    command = _command(commands, "simulate", _simulate, "run a ROM through the load history of its scene")
    command.add_argument("rom", metavar="ROM.h5", help="a file that `reduce` wrote")
    _output(command, "RUN.h5")
    command.add_argument("--scene", metavar="SCENE", help="take the load history of this scene")
    command.add_argument("--dt", type=float, metavar="S", help="time step instead of the scene's, s")
    command.add_argument("--order", type=int, metavar="M", help="run at a lower order than the ROM's")

    command = _command(commands, "info", _info, "say what is in a ROM or a run")
    command.add_argument("file", metavar="FILE.h5")

    command = _command(commands, "compare", _compare, "relative errors of one run against another")
    command.add_argument("run_file", metavar="A.h5", help="a run")
    command.add_argument("reference", metavar="B.h5", help="the run it is measured against")
    return parser


def _command(commands: Any, name: str, run: Callable[[Any], None], summary: str) -> argparse.ArgumentParser:
    command: argparse.ArgumentParser = commands.add_parser(name, help=summary, description=summary)
    command.set_defaults(run=run)
    return command


def _output(command: argparse.ArgumentParser, metavar: str) -> None:
    command.add_argument("-o", "--output", type=Path, required=True, metavar=metavar, help="file to write")


def _reduce(choice: Any) -> None:
    _check_output(choice.output, choice.scene)
    if choice.tolerance is not None and not 0 < choice.tolerance < 1:
        raise SceneError(f"--tolerance {choice.tolerance:g}: allowed is more than 0 and less than 1")
    if choice.share is not None and not 0 < choice.share <= 1:
        raise SceneError(f"--share {choice.share:g}: allowed is more than 0 and at most 1")
    if choice.order is not None and choice.order < 1:
        raise SceneError(f"--order {choice.order}: allowed are whole numbers from 1")
    scene = fr.read_scene(choice.scene)
    with _progress() as report:
        report("assembling", 0, 1)
        system = fr.assemble(scene)
        report("assembling", 1, 1)
        rom = fr.reduce(
            system,
            order=choice.order,
            tolerance=choice.tolerance,
            switching=choice.switching,
            weighting=choice.weighting,
            lyapunov=choice.lyapunov,
            share=choice.share,
            report=report,
        )
    fr.write_rom(choice.output, rom)
    if _speaks():
        _print_rom(rom, choice.output)


def _solve(choice: Any) -> None:
    _check_output(choice.output, choice.scene)
    scene = fr.read_scene(choice.scene)
    with _progress() as report:
        record = fr.solve(scene, dt=choice.dt, report=report)
    fr.write_record(choice.output, record)
    if _speaks():
        _print_record(record, choice.output)


def _simulate(choice: Any) -> None:
    _check_output(choice.output, choice.rom, choice.scene)
    rom = fr.read_rom(choice.rom)
    if choice.order is not None:
        rom = fr.truncated(rom, choice.order)
    scene = fr.read_scene(choice.scene) if choice.scene else None
    with _progress() as report:
        record = fr.simulate(rom, scene=scene, dt=choice.dt, report=report)
    fr.write_record(choice.output, record)
    if _speaks():
        _print_record(record, choice.output)


def _info(choice: Any) -> None:
    if content_of(choice.file) == "rom":
        _print_rom(fr.read_rom(choice.file), choice.file)
    else:
        _print_record(fr.read_record(choice.file), choice.file)


def _compare(choice: Any) -> None:
    differences = fr.compare(fr.read_record(choice.run_file), fr.read_record(choice.reference))
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
    _print_table(title, ("quantity", "relative error", "largest error", "of", "instants"), rows)


def _check_output(output: Path, *inputs: str | None) -> None:
    """Before long work, not after it."""
    check_place(output)
    for name in inputs:
        if name is not None and output.exists() and Path(name).exists() and output.samefile(name):
            raise RomFileError(f"{output}: is read by this command, so it cannot be its output")


def _print_rom(rom: fr.Rom, file: Path | str) -> None:
    rows = [
        (
            name,
            str(mode.order),
            str(mode.inputs.shape[1]),
            f"{mode.eigenvalues[0] ** 0.5 / 6.283185307179586:.4g} Hz",
            f"{mode.hankel_singular_values[0]:.2e}",
            f"{rom.certificate[name]['neglected']:.1e}",
            "-" if mode.static_error is None else f"{mode.static_error:.1e}",
        )
        for name, mode in rom.modes.items()
    ]
    _print_table(
        f"ROM {rom.name}: {file}",
        ("contact mode", "order", "inputs", "lowest", "σ_1", "σ left out", "static error"),
        rows,
    )
    width = 3 if len(rom.nodes) else 1
    lines = {
        "full order": f"{len(rom.free)} displacements, {len(rom.nodes)} nodes",
        "shared basis": f"{len(rom.stiffness)} vectors",
        "switching": rom.switching,
        "weighting": rom.weighting,
        "effects": "; ".join(
            " ".join([name, *(f"{key}={value:g}" for key, value in parameters.items())])
            for name, parameters in rom.effects.items()
        )
        or "of the matrices",
        "outputs": ", ".join(f"{name} ({len(rows) // width})" for name, rows in rom.outputs.items()) or "none",
        "actuators": ", ".join(rom.actuators) or "none",
    }
    _print_lines(lines, rom.warnings)


def _print_record(record: fr.Record, file: Path | str) -> None:
    seconds, dt = record.settings["seconds"], record.settings["dt"]
    account = {
        "supplied": record.supplied[-1],
        "dissipated": record.dissipated[-1],
        "lost in switching": record.lost_in_switching[-1],
        "stored": record.energy[-1],
    }
    title = f"{record.model} run {record.name}: {file}"
    _print_table(title, tuple(account), [tuple(f"{value:.6e} J" for value in account.values())])
    lines = {
        "steps": f"{record.steps} of {dt:g} s",
        "order": f"{record.settings['order']:.0f}",
        "rate": f"{record.steps / seconds:,.0f} steps/s, {record.times[-1] / seconds:.3g} times real time"
        if seconds > 0
        else "not measured",
        "energy account closes to": f"{record.balance_error:.1e} of the largest energy or work",
    }
    _print_lines(lines, record.warnings)


def _print_lines(lines: dict[str, str], messages: tuple[str, ...]) -> None:
    width = max(len(key) for key in lines)
    for key, value in lines.items():
        print(f"  {key:<{width}}  {value}")
    for message in messages:
        print(f"  warning: {message}")


def _rich() -> Any:
    try:
        import rich.console
        import rich.progress
        import rich.table
    except ModuleNotFoundError as error:
        raise MissingPackageError("the command line needs rich: pip install fenics-rom[cli]") from error
    return rich


def _print_table(title: str, columns: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> None:
    rich = _rich()
    table = rich.table.Table(header_style="", box=rich.box.SIMPLE_HEAD)
    for k, column in enumerate(columns):
        table.add_column(column, justify="left" if k == 0 else "right", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    text = io.StringIO()
    rich.console.Console(file=text, width=1000).print(table)  # so wide that no cell is cut
    print(title, *(line.rstrip() for line in text.getvalue().rstrip().split("\n")), "", sep="\n")


@contextmanager
def _progress() -> Iterator[Callable[[str, int, int], None]]:
    """A report that draws a bar on a terminal, on rank 0, and nothing elsewhere."""
    if not (_speaks() and sys.stderr.isatty()):
        yield lambda stage, done, of: None
        return
    rich = _rich()
    with rich.progress.Progress(console=rich.console.Console(stderr=True), transient=True) as progress:
        tasks: dict[str, Any] = {}

        def report(stage: str, done: int, of: int) -> None:
            if stage not in tasks:
                tasks[stage] = progress.add_task(stage, total=of)
            progress.update(tasks[stage], completed=done, total=of)

        yield report
