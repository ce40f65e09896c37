"""What a study leaves for people to read: every number as CSV, what to read first as Markdown, and pictures."""

import csv
import io
from pathlib import Path

from fenics_rom.io.atomic_write import write_whole
from fenics_rom.io.markdown import markdown
from fenics_rom.io.mpi_ranks import is_rank_0
from fenics_rom.studies.method_configs import METHOD_CONFIGS
from fenics_rom.studies.pareto import describe_choice, format_step, largest_model, pareto_front, select_per_decade
from fenics_rom.studies.study_results import StudyResults

COST_HEADING = ("for", "method", "order", "step", "error", "steps per second", "times real time", "times full order")
REFERENCE_ERROR_SHARE = 0.1  # share of the smallest error reported that the reference's own may be


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
    """Every row with every number; the columns name their units, errors are shares of the reference's size."""
    outputs = list(results.rows[0].outputs) if results.rows else []
    front = pareto_front(results.rows)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(
        [
            *("method", "order", "step (s)", "error of shape", "largest error of shape"),
            *(f"{what} of {name}" for name in outputs for what in ("error", "largest error")),
            *("error of energy", "error of reduction alone", "error of step alone", "steps per second"),
            *("times real time", "offline (s)", "file (bytes)", "static error", "transfer error"),
            *("share of σ left out", "on the Pareto front"),
        ]
    )
    for row in results.rows:
        errors = [row.error, row.largest, *(e for name in outputs for e in row.outputs[name])]
        errors += [row.energy, row.reduction, row.time_step]
        validation = (row.static_error, row.transfer_error, row.neglected)
        writer.writerow(
            [
                *(row.method, row.order, f"{row.dt:.9g}"),
                *(f"{error:.4e}" for error in errors),
                *(f"{row.rate:.0f}", f"{row.real_time:.4g}", f"{row.offline:.3f}", row.file_size),
                *("" if value is None else f"{value:.3e}" for value in validation),
                "yes" if row in front else "no",
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
        markdown(COST_HEADING, cost_rows(results)),
        "\n".join(
            f"- {describe_choice(results, tolerance, row)}" for tolerance, row in select_per_decade(results.rows)
        ),
        "## Error of the reduction alone",
        "The whole shape at the reference's own step.",
        reduction_table(results),
        "## Error of the time step alone",
        "The largest balanced model (or the largest there is) against itself at the reference's step.",
        step_table(results),
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
    return (
        f"{results.size:,} unknowns at full order, {results.duration:g} s. Errors are of the whole shape over the "
        f"whole run, in the mass norm, as a share of its size; the reference is the full order at steps of "
        f"{format_step(results.reference_step)}, whose own error is {results.reference_error:.1e} (from a run at twice "
        f"the step). Rates are of single steps with the energy account kept, one thread, {runs}; the "
        f"full order, without account, makes {results.full_rate:,.0f} steps a second."
    )


def cost_rows(results: StudyResults) -> list[tuple[str, ...]]:
    """What each decimal costs, and what to choose for it; columns are COST_HEADING."""
    return [
        (
            f"{tolerance:.0e}".replace("e-0", "e-"),
            METHOD_CONFIGS[row.method].label,
            str(row.order),
            format_step(row.dt),
            f"{row.error:.1e}",
            f"{row.rate:,.0f}",
            f"{row.real_time:,.3g}" if row.real_time < 100 else f"{row.real_time:,.0f}",
            f"{row.rate / results.full_rate:,.0f}",
        )
        for tolerance, row in select_per_decade(results.rows)
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
    if smallest is not None and results.reference_error > REFERENCE_ERROR_SHARE * smallest:
        messages.append(
            f"the reference's own error, {results.reference_error:.1e}, is more than a tenth of the smallest error "
            f"reported, {smallest:.1e}: the smallest errors are known to their order of magnitude only"
        )
    if results.mesh_error is None:
        messages.append("no finer mesh was given (--mesh): how far the mesh itself is from the body is not known")
    elif smallest is not None and results.mesh_error > smallest:
        messages.append(
            f"the mesh is {results.mesh_error:.1e} from the finest one at the outputs: models closer to the full "
            "order than that are no closer to the body"
        )
    return messages
