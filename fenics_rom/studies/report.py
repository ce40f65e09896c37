"""What a study leaves for people to read: every number as CSV, what to read first as Markdown, and pictures."""

import csv
import io
from pathlib import Path

from fenics_rom.io.atomic_write import write_whole
from fenics_rom.io.markdown import markdown
from fenics_rom.io.mpi_ranks import is_rank_0
from fenics_rom.studies.method_configs import METHOD_CONFIGS
from fenics_rom.studies.pareto import (
    describe_choice,
    describe_full_steps,
    format_step,
    largest_model,
    pareto_front,
    select_per_decade,
)
from fenics_rom.studies.study_results import PICTURES, StudyResults
from fenics_rom.trajectory.comparison import FORCE_MEASURES

FILES = ("study.csv", "study.md", *(f"{name}.{ending}" for name in PICTURES for ending in ("png", "pdf")))
FORCE_HEADING = ("obstacle", "model", "order", "step", *FORCE_MEASURES)
COST_HEADING = ("for", "method", "order", "step", "error", "steps per second", "times real time", "times full order")
WITHOUT = (
    "Errors are estimates: r of the reduction by a finer model, in the run itself at steps of {}, and t of the step "
    "against that run; both together are taken to be √(r² + t²)."
)
BESIDE = "Errors are estimates: distances from the run of a model of order {} at steps of {}."
BOUND = "bound of reduction, energy norm"
REFERENCE_ERROR_SHARE = 0.1  # share of the smallest error reported that the reference's own may be
FORCE_ERROR = 0.05  # of a contact force, that is worth a word where its own sensitivity is less


def write_report(folder: Path, results: StudyResults, command: str) -> None:
    """Writes study.csv, study.md with the command that made them, and the pictures; under MPI, rank 0 does.

    Raises:
        FileError: a file cannot be written.
    """
    if not is_rank_0():
        return
    from fenics_rom.studies.plots import draw  # needs Matplotlib

    write_whole(folder / "study.csv", csv_table(results).encode())
    write_whole(folder / "study.md", markdown_report(results, command).encode())
    draw(results, folder)


def csv_table(results: StudyResults) -> str:
    """Every row with every number; the columns name their units, errors are shares of the reference's size.

    Without a reference they are estimates, beside a bound; what is not known is empty.
    """
    error, bounds = results.error_name, [BOUND] if results.without_reference else []
    outputs, obstacles = (
        (list(of) for of in (results.rows[0].outputs, results.rows[0].forces)) if results.rows else ([], [])
    )
    front = pareto_front(results.rows)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(
        [
            *("method", "order", "step (s)", f"{error} of shape", f"largest {error} of shape"),
            *(f"{what} of {name}" for name in outputs for what in (error, f"largest {error}")),
            *("error of energy", f"{error} of reduction alone", "error of step alone", "steps per second"),
            *("times real time", "offline (s)", "file (bytes)", "static error", "transfer error"),
            *("share of σ left out", "on the Pareto front"),
            *(f"error of {what} of {name}" for name in obstacles for what in FORCE_MEASURES),
            *bounds,
        ]
    )
    for row in results.rows:
        errors = [row.error, row.largest, *(e for name in outputs for e in row.outputs[name])]
        errors += [row.energy, row.reduction, row.time_step]
        validation = (row.static_error, row.transfer_error, row.neglected)
        writer.writerow(
            [
                *(row.method, row.order, f"{row.dt:.9g}"),
                *("" if value is None else f"{value:.4e}" for value in errors),
                *(f"{row.rate:.0f}", f"{row.real_time:.4g}", f"{row.offline:.3f}", row.file_size),
                *("" if value is None else f"{value:.3e}" for value in validation),
                "yes" if row in front else "no",
                *(f"{value:.4e}" for name in obstacles for value in row.forces[name]),
                *("" if row.bound is None else f"{row.bound:.4e}" for _ in bounds),
            ]
        )
    return text.getvalue()


def markdown_report(results: StudyResults, command: str) -> str:
    """The whole study as Markdown; the command is the one that made it."""
    parts = [
        f"# What accuracy costs: {results.name}",
        f"Made by `{command}`.",
        _settings(results),
        "## What each decimal costs",
        markdown(cost_heading(results), cost_rows(results)),
        "\n".join(
            f"- {describe_choice(results, tolerance, row)}" for tolerance, row in select_per_decade(results.rows)
        ),
        f"## {results.error_name.capitalize()} of the reduction alone",
        f"The whole shape at steps of {format_step(results.reference_step)}.",
        reduction_table(results),
        "## Error of the time step alone",
        "The largest balanced model (or the largest there is) against itself at "
        f"steps of {format_step(results.reference_step)}.",
        step_table(results),
    ]
    if results.reference_forces:
        parts += [
            "## Contact forces",
            "Of each obstacle, as shares of the reference's: the force over the whole run (2-norm of its means between "
            "the instants compared), its peak, and the impulse. First is what the reference's own step does to them.",
            markdown(FORCE_HEADING, force_rows(results)),
        ]
    if results.meshes:
        parts += [
            "## Error of the mesh",
            "Outputs at full order against those of the finest mesh.",
            mesh_table(results),
        ]
    parts += ["## Notes", "\n".join(f"- {note}" for note in remarks(results))]
    return "\n\n".join(part.strip("\n") for part in parts) + "\n"


def _settings(results: StudyResults) -> str:
    runs = "of one run" if results.rate_runs == 1 else f"the fastest of {results.rate_runs} runs"
    step, own = format_step(results.reference_step), f"{results.reference_error:.1e} (from a run at twice the step)"
    if results.full_rate is None:
        larger = results.compared_with
        estimates = WITHOUT.format(step) if larger is None else BESIDE.format(larger, step)
        reference = f"full order was not run. {estimates} These steps themselves make {own}"
        full = "that of full order is not known"
    else:
        reference = f"the reference is the full order at steps of {step}, whose own error is {own}"
        full = f"the full order, {describe_full_steps(results)}, makes {results.full_rate:,.0f} steps a second"
    return (
        f"{results.size:,} unknowns at full order, {results.duration:g} s. Errors are of the whole shape over the "
        f"whole run, in the mass norm, as a share of its size; {reference}. Rates are of single steps with the energy "
        f"account kept, one thread, {runs}; {full}."
    )


def cost_heading(results: StudyResults) -> tuple[str, ...]:
    """Columns of cost_rows: COST_HEADING, or without a reference what is known."""
    if not results.without_reference:
        return COST_HEADING
    return (*COST_HEADING[:4], results.error_name, *COST_HEADING[5:7], BOUND)


def cost_rows(results: StudyResults) -> list[tuple[str, ...]]:
    """What each decimal costs, and what to choose for it; columns are those of cost_heading."""
    return [
        (
            f"{tolerance:.0e}".replace("e-0", "e-"),
            METHOD_CONFIGS[row.method].label,
            str(row.order),
            format_step(row.dt),
            f"{row.error:.1e}",
            f"{row.rate:,.0f}",
            f"{row.real_time:,.3g}" if row.real_time < 100 else f"{row.real_time:,.0f}",
            (
                f"{row.rate / results.full_rate:,.0f}"
                if results.full_rate is not None
                else ("not known" if row.bound is None else f"{row.bound:.1e}")
            ),
        )
        for tolerance, row in select_per_decade(results.rows)
    ]


def force_rows(results: StudyResults) -> list[tuple[str, ...]]:
    """Errors of contact forces: of the reference by its own step, and of each model to choose."""
    models = [("full order, by its step", "", results.reference_step, results.reference_forces)]
    for _, row in select_per_decade(results.rows):
        models.append((METHOD_CONFIGS[row.method].label, f"{row.order}", row.dt, row.forces))
    return [
        (name, label, order, format_step(dt), *(f"{error:.1e}" for error in forces[name]))
        for name in results.reference_forces
        for label, order, dt, forces in models
        if name in forces
    ]


def reduction_table(results: StudyResults) -> str:
    """Error of the reduction alone by order and method, with what the balanced model costs offline."""
    methods = list(dict.fromkeys(row.method for row in results.rows))
    orders = sorted({row.order for row in results.rows})
    rows = []
    for order in orders:
        cells = {method: results.of(method, order) for method in methods}
        first = next(model[0] for model in cells.values() if model)
        errors = [f"{model[0].reduction:.1e}" if model else "" for model in cells.values()]
        rows.append((order, *errors, f"{first.offline:.2f} s", f"{first.file_size / 1e6:.2f} MB"))
    heading = ("order", *(METHOD_CONFIGS[method].label for method in methods), "offline", "ROM file")
    return markdown(heading, rows)


def step_table(results: StudyResults) -> str:
    """Error of the time step alone."""
    rows = largest_model(results.rows)
    return markdown(
        ("step", "error", "times real time"),
        [(format_step(row.dt), f"{row.time_step:.1e}", f"{row.real_time:,.3g}") for row in rows],
    )


def mesh_table(results: StudyResults) -> str:
    """Distance of each mesh from the finest at every output."""
    names = list(results.meshes[0].outputs)
    rows = [(mesh.file, f"{mesh.size:,}", *(f"{mesh.outputs[name]:.1e}" for name in names)) for mesh in results.meshes]
    return markdown(("mesh", "unknowns", *names), rows)


def remarks(results: StudyResults) -> list[str]:
    """What the user should know of these numbers."""
    smallest = results.smallest_error
    messages = list(results.notes)
    if results.without_reference:
        stated = "that the reduced runs state of themselves; how fast full order is, and errors of energy are not known"
        larger = f"by a reduced model of order {results.compared_with}; how fast full order is, is not known"
        which = stated if results.compared_with is None else larger
        messages.append(f"full order was not run: errors are estimates {which}")
    if smallest is not None and results.reference_error > REFERENCE_ERROR_SHARE * smallest:
        own = f"the error of steps of {format_step(results.reference_step)}, where the reduction alone is told"
        if not results.without_reference:
            own = "the reference's own error"
        messages.append(
            f"{own}, {results.reference_error:.1e}, is more than a tenth of the smallest error "
            f"reported, {smallest:.1e}: the smallest errors are known to their order of magnitude only"
        )
    messages += _doubted_forces(results)
    if results.mesh_error is None:
        messages.append("no finer mesh was given (--mesh): how far the mesh itself is from the body is not known")
    elif smallest is not None and results.mesh_error > smallest:
        messages.append(
            f"the mesh is {results.mesh_error:.1e} from the finest one at the outputs: models closer to the full "
            "order than that are no closer to the body"
        )
    return messages


def _doubted_forces(results: StudyResults) -> list[str]:
    """Contact forces that the model closest in shape has wrong, by more than the reference's own step does."""
    best = min(results.rows, key=lambda row: row.error, default=None)
    return [
        f"the {what} of {name} is off by {error:.0%} in the model that is closest in shape (order {best.order}, "
        f"{format_step(best.dt)}), where the reference's own step makes {own:.1%}"
        for name, errors in (best.forces if best else {}).items()
        for what, error, own in zip(FORCE_MEASURES, errors, results.reference_forces.get(name, errors), strict=True)
        if best is not None and error > max(FORCE_ERROR, own)
    ]
