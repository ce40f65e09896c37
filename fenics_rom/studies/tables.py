"""The tables of a study: every number as CSV, and what to read first as Markdown."""

import csv
import io
from collections.abc import Sequence

from fenics_rom.io.markdown import markdown
from fenics_rom.studies.method_configs import WAYS
from fenics_rom.studies.pareto import decades, length, pareto_front, sentence
from fenics_rom.studies.study_results import Findings, Row

COSTS = ("for", "method", "order", "step", "error", "steps per second", "times real time", "times full order")
ENOUGH = 0.1  # share of the smallest error reported that the reference's own may be


def csv_table(findings: Findings) -> str:
    """Every row with every number; the columns name their units, errors are shares of the reference's size."""
    outputs = list(findings.rows[0].outputs) if findings.rows else []
    front = set(map(_key, pareto_front(findings.rows)))
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
    for row in findings.rows:
        errors = [row.error, row.largest, *(e for name in outputs for e in row.outputs[name])]
        errors += [row.energy, row.reduction, row.time_step]
        validation = (row.static_error, row.transfer_error, row.neglected)
        writer.writerow(
            [
                *(row.method, row.order, f"{row.dt:.9g}"),
                *(f"{error:.4e}" for error in errors),
                *(f"{row.rate:.0f}", f"{row.real_time:.4g}", f"{row.offline:.3f}", row.file_size),
                *("" if value is None else f"{value:.3e}" for value in validation),
                "yes" if _key(row) in front else "no",
            ]
        )
    return text.getvalue()


def report(findings: Findings, command: str) -> str:
    """The whole study as Markdown.

    Args:
        findings: of the study.
        command: that made it.
    """
    parts = [
        f"# What accuracy costs: {findings.name}",
        f"Made by `{command}`.",
        _settings(findings),
        "## What each decimal costs",
        markdown(COSTS, cost_rows(findings)),
        "\n".join(f"- {sentence(findings, tolerance, row)}" for tolerance, row in decades(findings.rows)),
        "## Error of the reduction alone",
        "The whole shape at the reference's own step.",
        reduction_table(findings),
        "## Error of the time step alone",
        "The largest balanced model (or the largest there is) against itself at the reference's step.",
        step_table(findings),
    ]
    if findings.meshes:
        parts += [
            "## Error of the mesh",
            "Outputs at full order against those of the finest mesh.",
            mesh_table(findings),
        ]
    parts += ["## Notes", "\n".join(f"- {note}" for note in remarks(findings))]
    return "\n\n".join(part.strip("\n") for part in parts) + "\n"


def _settings(findings: Findings) -> str:
    return (
        f"{findings.size:,} unknowns at full order, {findings.duration:g} s. Errors are of the whole shape over the "
        f"whole run, in the mass norm, as a share of its size; the reference is the full order at steps of "
        f"{length(findings.reference_step)}, whose own error is {findings.reference_error:.1e} (from a run at twice "
        f"the step). Rates are of single steps with the energy account kept, one thread, the fastest of five runs; the "
        f"full order, without account, makes {findings.full_rate:,.0f} steps a second."
    )


def cost_rows(findings: Findings) -> list[tuple[str, ...]]:
    """What each decimal costs, and what to choose for it; columns are COSTS."""
    return [
        (
            _power(tolerance),
            WAYS[row.method].label,
            str(row.order),
            length(row.dt),
            f"{row.error:.1e}",
            f"{row.rate:,.0f}",
            f"{row.real_time:,.3g}" if row.real_time < 100 else f"{row.real_time:,.0f}",
            f"{row.rate / findings.full_rate:,.0f}",
        )
        for tolerance, row in decades(findings.rows)
    ]


def reduction_table(findings: Findings) -> str:
    """Error of the reduction alone by order and method, with what the balanced model costs offline."""
    methods = list(dict.fromkeys(row.method for row in findings.rows))
    orders = sorted({row.order for row in findings.rows})
    rows = []
    for order in orders:
        cells = {method: findings.of(method, order) for method in methods}
        first = next(found[0] for found in cells.values() if found)
        errors = [f"{found[0].reduction:.1e}" if found else "" for found in cells.values()]
        rows.append((order, *errors, f"{first.offline:.2f} s", f"{first.file_size / 1e6:.2f} MB"))
    heading = ("order", *(WAYS[method].label for method in methods), "offline", "ROM file")
    return markdown(heading, rows)


def step_table(findings: Findings) -> str:
    """Error of the time step alone."""
    rows = largest_model(findings.rows)
    return markdown(
        ("step", "error", "times real time"),
        [(length(row.dt), f"{row.time_step:.1e}", f"{row.real_time:,.3g}") for row in rows],
    )


def mesh_table(findings: Findings) -> str:
    """Distance of each mesh from the finest at every output."""
    names = list(findings.meshes[0].outputs)
    rows = [(mesh.file, f"{mesh.size:,}", *(f"{mesh.outputs[name]:.1e}" for name in names)) for mesh in findings.meshes]
    return markdown(("mesh", "unknowns", *names), rows)


def largest_model(rows: Sequence[Row]) -> list[Row]:
    """All steps of the method that was tried first, at its largest order."""
    first = [row for row in rows if row.method == rows[0].method]
    order = max((row.order for row in first), default=0)
    return [row for row in first if row.order == order]


def remarks(findings: Findings) -> list[str]:
    """What the user should know of these numbers."""
    smallest = findings.smallest_error
    said = list(findings.notes)
    if smallest is not None and findings.reference_error > ENOUGH * smallest:
        said.append(
            f"the reference's own error, {findings.reference_error:.1e}, is more than a tenth of the smallest error "
            f"reported, {smallest:.1e}: the smallest errors are known to their order of magnitude only"
        )
    if findings.mesh_error is None:
        said.append("no finer mesh was given (--mesh): how far the mesh itself is from the body is not known")
    elif smallest is not None and findings.mesh_error > smallest:
        said.append(
            f"the mesh is {findings.mesh_error:.1e} from the finest one at the outputs: models closer to the full "
            "order than that are no closer to the body"
        )
    return said


def _key(row: Row) -> tuple[str, int, float]:
    return row.method, row.order, row.dt


def _power(tolerance: float) -> str:
    return f"{tolerance:.0e}".replace("e-0", "e-")
