"""What the command line shows: summaries of files, tables, and bars while it works."""

import io
import math
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np

import fenics_rom as fr
from fenics_rom.io.mpi_ranks import is_root_process
from fenics_rom.io.progress import Report, silent
from fenics_rom.io.stages import Stage, peak_memory
from fenics_rom.mechanics.body_facts import body_lines
from fenics_rom.mechanics.readings import READING_UNITS, READING_WORDS, STRESS_PARTS
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.deformation import ReducedDeformation
from fenics_rom.rom.moving_frame import MovingFrame
from fenics_rom.rom.residual_compliance import ResidualCompliance
from fenics_rom.rom.rom import ForceValidation
from fenics_rom.runtime.steppers.selection import longest_linearly_implicit_step
from fenics_rom.trajectory.error_series import ErrorTolerance
from fenics_rom.trajectory.series import FRAME_SERIES, ReadingSeries
from fenics_rom.visualization.optional_dependencies import load_package

MODE_HEADING = (
    *("contact mode", "order", "inputs", "lowest", "σ_1", "σ left out"),
    *("static error", "transfer error", "sampled at"),
)

MODE_ERRORS = ("neglected", "static_error", "transfer_error")
LINE_INTERVAL = 10.0  # seconds between lines of progress, where there is no terminal


def rich_package() -> Any:
    """The package rich, which draws; MissingPackageError where it is not installed."""
    message = 'the command line needs rich: pip install "fenics-rom[cli]"'
    for part in ("console", "progress", "table", "text"):
        load_package(f"rich.{part}", message)
    return load_package("rich", message)


def print_rom(rom: "fr.Rom", file: Path | str) -> None:
    """What is in a ROM, how good it is, and what it cost."""
    validation = rom.validation
    print_table(
        f"ROM {rom.name}: {file}",
        MODE_HEADING,
        [_mode_row(name, mode, validation[name]) for name, mode in rom.contact_models.items()],
    )
    width = 3 if len(rom.nodes) else 1
    effects = (f"{name} ({words})" if words else name for name, words in rom.environment.effects.items())
    lines = {
        **body_lines(rom.nodes, rom.node_mass, rom.first_frequency, rom.cells),
        "full order": f"{len(rom.free)} displacements, {len(rom.nodes)} nodes",
        "shared basis": f"{len(rom.stiffness)} vectors",
        "method": rom.method,
        "switching": rom.switching,
        "weighting": rom.weighting,
        "effects": ", ".join(effects) or "of the matrices",
        **({} if rom.deformation is None else _deformation(rom, rom.deformation)),
        "outputs": ", ".join(f"{name} ({len(rows) // width})" for name, rows in rom.outputs.items()) or "none",
        "actuators": ", ".join(rom.actuators) or "none",
        **({"loads": ", ".join(rom.loads)} if rom.loads else {}),
    }
    if rom.error_model is not None:
        lines["errors"] = f"told by runs, by a finer model of {len(rom.error_model.eigenvalues)} displacements"
    if rom.readings:
        read = ((name, reading.quantity) for name, reading in rom.readings.items())
        lines["readings"] = ", ".join(f"{name} ({READING_WORDS[of]} in {READING_UNITS[of]})" for name, of in read)
    touched = {name: len(mode.contact_points) for name, mode in rom.contact_models.items() if len(mode.contact_points)}
    if touched:
        lines["contact points"] = ", ".join(f"{name} ({count})" for name, count in touched.items())
    if rom.residual_compliance is not None:
        lines["contact compliance"] = _residual_compliance(rom.residual_compliance)
    if rom.moving_frame is not None:
        lines["moving frame"] = _moving_frame(rom.moving_frame, large=rom.deformation is not None)
    print_lines(lines, rom.warnings)
    if rom.force_validation is not None:
        print()
        _print_forces(rom.force_validation)
    if rom.stages:
        print()
        _print_stages(rom.stages)


def _residual_compliance(residual: ResidualCompliance) -> str:
    """How much of the contact points' compliance the bases lack, and what is left when it is added."""
    if residual.static is not None:
        points, megabytes = len(residual.static.order), residual.static.values.nbytes / 1e6
        stored = f"of {points} contact points, {megabytes:.3g} MB in blocks, to {residual.floor:.1e} m/N"
    else:
        assert residual.factor is not None
        points, kept = residual.factor.shape
        stored = f"of contact points, {kept} of {points} directions are stored"
        if kept < points:
            stored += f" (each of the others yields less than {residual.floor:.1e} m/N)"
    if not residual.errors:
        return f"{stored}; its error was not measured, as the scene has no run or the ROM was truncated"
    name, (without, beside) = max(residual.errors.items(), key=lambda item: item[1][1])
    return (
        f"{stored}; off full order's by {beside:.1e} in a step of {residual.dt:g} s "
        f"({without:.1e} without them; contact mode {name!r})"
    )


def _moving_frame(frame: MovingFrame, large: bool) -> str:
    """What it is of, and whether it knows how turning stiffens the body; one that deforms largely does anyhow."""
    at = ", ".join(f"{x:.3g}" for x in frame.origin)
    of = f"carried by a base, its origin at ({at}) m" if frame.carried else f"free, about its centre of mass ({at}) m"
    return f"{of}; {'stiffened' if large or frame.stiffening is not None else 'not stiffened'} by turning"


def _deformation(rom: "fr.Rom", body: ReducedDeformation) -> dict[str, str]:
    """What large deformation was trained for, and how good it is."""
    validation = "not measured" if body.validation_error is None else f"{body.validation_error:.1e}"
    longest = longest_linearly_implicit_step(rom)
    chosen = f"linearly-implicit up to {1e3 * longest:.3g} ms, an eighth of the slowest period, and newton beyond; "
    chosen += "or by the error that is asked of a run (--step-error)"
    return {
        "large deformation": f"{body.law.replace('_', ' ')}, {len(body.weights)} of {body.points_of} points kept",
        "error of forces": f"{body.cubature_error:.1e} on the states it was trained on",
        "error of a run": f"{validation}, that it was not trained on",
        **({"steps are taken by": chosen} if rom.environment.has_inertia else {}),
    }


def _print_forces(validation: ForceValidation) -> None:
    """How far contact forces are off, or that it is not known."""
    over = f"the first {validation.duration:g} s of the run"
    if not validation.reduction:
        print(f"  contact forces: not validated, as nothing is touched in {over}; a study measures them in all of it")
        return
    rows = [
        (name, against, *(f"{error:.1e}" for error in errors[name]))
        for name in validation.reduction
        for against, errors in (
            ("full order, same step", validation.reduction),
            ("full order at half the step, itself", validation.time_step),
        )
        if name in errors
    ]
    title = f"contact forces, {over}, steps of {validation.dt:g} s: how far they are off"
    print_table(title, ("obstacle", "against", "force", "peak", "impulse"), rows)


def _mode_row(name: str, mode: ContactModel, validation: dict[str, float | None]) -> tuple[str, ...]:
    σ, count = mode.hankel_singular_values, len(mode.frequencies)
    return (
        name,
        str(mode.order - mode.rigid) + (f" + {mode.rigid} rigid" if mode.rigid else ""),
        str(mode.inputs.shape[1]),
        f"{mode.eigenvalues[mode.rigid] ** 0.5 / math.tau:.4g} Hz",
        f"{σ[0]:.2e}" if len(σ) else "-",
        *("-" if (error := validation[key]) is None else f"{error:.1e}" for key in MODE_ERRORS),
        f"{count} frequenc{'y' if count == 1 else 'ies'}" if count else "-",
    )


def _print_stages(stages: tuple[Stage, ...]) -> None:
    heading, memory = ("stage", "seconds", "share", "peak memory per rank"), [stage.peak_memory for stage in stages]
    costs, cells = [(s.name, s.seconds) for s in stages], [(f"{of / 1e6:,.0f} MB",) for of in (*memory, max(memory))]
    _print_costs("offline work", heading, costs, cells)


def _print_costs(
    title: str, heading: tuple[str, ...], costs: Sequence[tuple[str, float]], others: Iterable[tuple[str, ...]]
) -> None:
    """What each part costs, as such and as a share of the total, which is the last row; and other cells of each row."""
    total = sum(cost for _, cost in costs)
    rows = [
        (part, f"{cost:,.2f}", f"{100 * cost / total if total else 0:.1f} %", *cells)
        for (part, cost), cells in zip((*costs, ("total", total)), others, strict=False)
    ]
    print_table(title, heading, rows)


def print_trajectory(run: "fr.Trajectory", file: Path | str) -> None:
    """What a run came to, where the energy went, and what the body is."""
    dt = run.settings["dt"]
    account = {
        "supplied": run.supplied[-1],
        "dissipated": run.dissipated[-1],
        "lost in switching": run.lost_in_switching[-1],
        **({"numerical": run.numerical[-1]} if run.numerical.any() else {}),
        "stored": run.energy[-1],
    }
    title = f"{run.model} run {run.name}: {file}"
    print_table(title, tuple(account), [tuple(f"{value:.6e} J" for value in account.values())])
    if run.lost_in_switching[-1]:
        print("  lost in switching: what the bases of the next contact modes cannot hold of the stored energy")
    lines = {
        **body_lines(run.nodes, run.node_mass, run.settings.get("first_frequency"), run.cells),
        "steps": f"{run.steps} of {dt:g} s",
        "order": f"{run.settings['order']:.0f}",
        **({"rate": _rate(run, run.settings["seconds"])} if "seconds" in run.settings else {}),
        "energy account closes to": f"{run.balance_error:.1e} of the largest energy or work",
    }
    if run.stepping:
        lines["steps are taken by"] = run.stepping
    if "mismatch" in run.settings:
        lines["mismatch of strains"] = f"{run.settings['mismatch']:.1e} of the largest"
    if run.effects:
        lines["effects"] = ", ".join(run.effects)
    if run.contact_account:
        done = {name: f"{sums[-1]:.6e} J" for name, sums in run.contact_account.items()}
        lines["supplied by obstacles"] = done["obstacles"]
        lines["dissipated in contact"] = done["contact"]
        if "friction" in done:
            lines["dissipated by friction"] = done["friction"]
    for name, forces in run.forces.items():
        lines[f"largest force of {name}"] = f"{np.linalg.norm(forces, axis=1).max():.4g} N"
    for name, series in run.reaction_series.items():
        lines[f"reaction {name}"] = f"{series.values.min():.4g} to {series.values.max():.4g} {series.unit}"
    for name, series in run.frame_series.items():
        if name not in FRAME_SERIES["pose"]:
            lines[f"largest {name}"] = f"{np.linalg.norm(series.values, axis=1).max():.4g} {series.unit}"
    for name, reading in run.readings.items():
        low, high = reading.sizes.min(), reading.sizes.max()
        lines[f"reading {name}"] = f"{reading.words}, {low:.4g} to {high:.4g} {reading.unit}"
        if reading.quantity == "stress":
            lines |= _stresses(name, reading)
    scale = np.sqrt(2 * run.energy.max())
    for kind, stated in run.errors.items():
        lines[f"error, {kind}"] = stated.why
        if stated.norm is not None:
            share = f" ({100 * stated.norm.max() / scale:.2g} % of the run's largest)" if scale else ""
            lines[f"error, {kind}"] = f"{stated.norm.max():.3g} J^1/2 at most in the energy norm{share}; {stated.why}"
        for name, off in stated.outputs.items():
            lines[f"error of {name}, {kind}"] = f"{np.abs(off).max():.3g} m at most in any direction"
        for name, misread in stated.readings.items():
            lines[f"error of {name}, {kind}"] = f"{_misread_words(misread)} at most"
    if run.tolerance is not None:
        lines["error tolerance"] = _tolerance_words(run.tolerance)
    print_lines(lines, run.warnings)
    if run.profile:
        print()
        title = "what a step costs (with the clock read between its parts)"
        microseconds = [(part, 1e6 * seconds) for part, seconds in run.profile.items()]
        _print_costs(title, ("part", "microseconds", "share"), microseconds, repeat(()))


def _misread_words(misread: ReadingSeries) -> str:
    """The largest error of a reading; of touch in the force, the area and on a taxel."""
    if misread.taxels is None:
        return f"{misread.words}, {np.abs(misread.sizes).max():.3g} {misread.unit}"
    touch = misread.touch
    parts = {"N": np.linalg.norm(touch.force, axis=1), "m2": touch.area, "Pa on a taxel": touch.pressures}
    return ", ".join(f"{np.abs(of).max():.3g} {unit}" for unit, of in parts.items() if of.size)


def _tolerance_words(tolerance: ErrorTolerance) -> str:
    """A tolerance, and where it did not hold."""
    orders = [f", order {before} to {after}" * (after > before) for before, after in tolerance.orders.tolist()]
    at = [f"{time:.4g} s{order}" for time, order in zip(tolerance.times, orders, strict=True)]
    return f"{tolerance.value:g} m of outputs, by the estimate; " + ("exceeded at " + "; ".join(at) if at else "kept")


def _stresses(name: str, reading: ReadingSeries) -> dict[str, str]:
    """Of stress at points, all that is known of it at the end of a run."""
    return {
        f"{name} {k}": ", ".join(f"{part} {number:.4g}" for part, number in zip(STRESS_PARTS, at, strict=True)) + " Pa"
        for k, at in enumerate(reading.values[-1])
    }


def _rate(run: "fr.Trajectory", seconds: float) -> str:
    if not seconds > 0:  # of a clock too coarse
        return "not measured"
    return f"{run.steps / seconds:,.0f} steps/s, {run.times[-1] / seconds:.3g} times real time"


def print_lines(lines: dict[str, str], messages: tuple[str, ...]) -> None:
    """Keys and values in two columns, and what the user should know under them."""
    width = max(len(key) for key in lines)
    for key, value in lines.items():
        print(f"  {key:<{width}}  {value}")
    print_warnings(messages)


def print_warnings(messages: Sequence[str]) -> None:
    """What the user should know."""
    for message in messages:
        print(f"  warning: {message}")


def print_run_warnings(runs: Mapping[str, "fr.Trajectory"]) -> None:
    """What the user should know of runs by name, each message once, with the runs that it is of."""
    messages = dict.fromkeys(message for run in runs.values() for message in run.warnings)
    of = {message: [name for name, run in runs.items() if message in run.warnings] for message in messages}
    print_warnings([f"{', '.join(names)}: {message}" for message, names in of.items()])


def print_table(title: str, columns: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> None:
    """A table under its title."""
    rich = rich_package()
    table = rich.table.Table(header_style="", box=rich.box.SIMPLE_HEAD)
    for k, column in enumerate(columns):
        table.add_column(column, justify="left" if k == 0 else "right", no_wrap=True)
    for row in rows:
        table.add_row(*(rich.text.Text(cell) for cell in row))
    text = io.StringIO()
    rich.console.Console(file=text, width=1000).print(table)  # so wide that no cell is cut
    print(title, *(line.rstrip() for line in text.getvalue().rstrip().split("\n")), "", sep="\n")


@contextmanager
def progress() -> Iterator[Report]:
    """On rank 0 a report: a bar for each stage on a terminal, elsewhere a line every ten seconds."""
    if not (is_root_process() and sys.stderr.isatty()):
        yield _told_in_lines() if is_root_process() else silent
        return
    rich = rich_package()

    class Memory(rich.progress.ProgressColumn):  # type: ignore[name-defined]
        """The most that this rank has held, up to now or to the end of the stage."""

        def render(self, task: Any) -> Any:
            if not task.finished:
                task.fields["memory"] = peak_memory()
            return rich.text.Text(f"{task.fields.get('memory', peak_memory()) / 1e6:,.0f} MB")

    columns = (*rich.progress.Progress.get_default_columns(), rich.progress.TimeElapsedColumn(), Memory())
    with rich.progress.Progress(*columns, console=rich.console.Console(stderr=True), transient=True) as bars:
        tasks: dict[str, Any] = {}

        def report(stage: str, done: int, of: int) -> None:
            name = stage.partition(":")[0]  # what follows it changes
            if name not in tasks:
                tasks[name] = bars.add_task(stage, total=of)
            bars.update(tasks[name], description=stage, completed=done, total=of)

        yield report


def _told_in_lines() -> Report:
    """A report that writes to standard error what is done, when the last time was long ago."""
    start = last = time.monotonic()

    def report(stage: str, done: int, of: int) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= LINE_INTERVAL:
            last = now
            print(f"{now - start:.0f} s: {stage}, {done:,} of {of:,}", file=sys.stderr, flush=True)

    return report
