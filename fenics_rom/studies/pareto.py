"""Which model to choose: the Pareto front of error and speed, and the select_cheapest model within a tolerance."""

import math
from collections.abc import Iterable, Sequence

from fenics_rom.studies.method_configs import METHOD_CONFIGS
from fenics_rom.studies.study_results import BenchmarkRow, StudyResults


def pareto_front(rows: Iterable[BenchmarkRow]) -> list[BenchmarkRow]:
    """The rows that no other is both faster and closer than, the fastest first."""
    front: list[BenchmarkRow] = []
    for row in sorted(rows, key=lambda row: (-row.real_time, row.error)):
        if not front or row.error < front[-1].error:
            front.append(row)
    return front


def select_cheapest(rows: Iterable[BenchmarkRow], tolerance: float) -> BenchmarkRow | None:
    """The row to choose for an error of the whole shape; None where none is within it.

    At each step the lowest order, and of these the least error; of the steps the one that simulates fastest. Between
    orders nothing is left to rates, which on many a machine say less than that.
    """
    within = [row for row in rows if row.error <= tolerance]
    at_each = [
        min((row for row in within if row.dt == dt), key=lambda row: (row.order, row.error))
        for dt in {row.dt for row in within}
    ]
    return max(at_each, key=lambda row: row.real_time, default=None)


def select_per_decade(rows: Sequence[BenchmarkRow]) -> list[tuple[float, BenchmarkRow]]:
    """Tolerances 1e-1, 1e-2, ... as far as a row reaches, and the row to choose for each.

    Of several tolerances that lead to the same row, the smallest. Where no row is within 1e-1, the least error of all
    in whole tenths.
    """
    by_model: dict[tuple[str, int, float], tuple[float, BenchmarkRow]] = {}
    k = 1
    least = min((row.error for row in rows), default=0.0)
    if least > 0.1:
        tolerance = math.ceil(10 * least) / 10
        row = select_cheapest(rows, tolerance)
        return [] if row is None else [(tolerance, row)]
    while (row := select_cheapest(rows, 10.0**-k)) is not None:
        key = row.method, row.order, row.dt
        by_model.pop(key, None)
        by_model[key] = 10.0**-k, row
        k += 1
    return list(by_model.values())


def largest_model(rows: Sequence[BenchmarkRow]) -> list[BenchmarkRow]:
    """All steps of the method that was tried first, at its largest order."""
    first = [row for row in rows if row.method == rows[0].method]
    order = max((row.order for row in first), default=0)
    return [row for row in first if row.order == order]


def describe_choice(results: StudyResults, tolerance: float, row: BenchmarkRow) -> str:
    """The choice in words."""
    step = "the same step" if results.full_step is None else f"steps of {format_step(results.full_step)}"
    estimated, than_full = ", as estimated", ""
    if results.full_rate is not None:
        estimated = ""
        than_full = f" and {format_factor(row.rate / results.full_rate)} as fast as full order at {step}"
    return (
        f"For {tolerance:.0e} of the whole shape{estimated}: {METHOD_CONFIGS[row.method].label}, order {row.order}, "
        f"step {format_step(row.dt)}; "
        f"{format_factor(row.real_time)} {'faster than' if row.real_time >= 1 else 'of'} real time{than_full}."
    ).replace("e-0", "e-")


def describe_full_steps(results: StudyResults) -> str:
    """Of which steps the rate at full order is, in words."""
    step = results.full_step
    return "without account" if step is None else f"at steps of {format_step(step)} in the whole run"


def format_factor(factor: float) -> str:
    """A factor in words."""
    return f"{factor:,.0f} times" if factor >= 10 else f"{factor:.2g} times"


def format_step(seconds: float) -> str:
    """A time step in a readable unit."""
    return f"{1e3 * seconds:.4g} ms" if seconds >= 1e-4 else f"{1e6 * seconds:.4g} µs"
