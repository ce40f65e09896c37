"""The table of a study of amplitudes: every model at every load, on a terminal and in Markdown."""

from fenics_rom.io.markdown import markdown
from fenics_rom.studies.amplitude_results import AmplitudeResults

TABLE_HEADING = ("load", "largest displacement", "model", "step", "error", "steps per second", "times real time")


def markdown_report(results: AmplitudeResults, command: str) -> str:
    """The study as Markdown."""
    offline = ", ".join(f"{name} {seconds:.0f} s" for name, seconds in results.offline.items())
    validation = "was not measured" if results.validation is None else f"is {results.validation:.1e}"
    return "\n\n".join(
        [
            f"# What large deformation costs: {results.name}",
            f"Made by `{command}`.",
            f"{results.unknowns:,} unknowns; reductions: {offline}. The error of the nonlinear ROM on a run that it "
            f"was not trained on {validation}. Errors are of the whole shape over the run, in the mass norm, against "
            "the nonlinear full order, whose own error is estimated from twice its step.",
            markdown(TABLE_HEADING, table_rows(results)),
            *(f"- {note}" for note in results.notes),
        ]
    )


def table_rows(results: AmplitudeResults) -> list[tuple[str, ...]]:
    """The rows of the table, for people."""
    return [
        (
            f"{row.share:.3g}",
            f"{1e3 * row.displacement:.3g} mm",
            f"{row.model}, order {row.order:,}" if "reduced" in row.model else row.model,
            f"{1e3 * row.dt:.3g} ms",
            f"{row.error:.1e}",
            f"{row.rate:,.0f}" if row.rate >= 10 else f"{row.rate:.1f}",
            f"{row.real_time:.3g}",
        )
        for row in results.rows
    ]
