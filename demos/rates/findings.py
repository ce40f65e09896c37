"""How rates are measured, and where what was found goes."""

import gc
import os
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from fenics_rom.io.markdown import markdown


def rates(loops: Mapping[str, Callable[[], int]], rounds: int) -> dict[str, float]:
    """What each loop does in a second, the best of some rounds in which they take turns.

    Args:
        loops: each returns how many steps it has taken.
        rounds: how many, after one that is not counted.
    """
    best = dict.fromkeys(loops, 0.0)
    for round in range(rounds + 1):
        for name, loop in loops.items():
            start = time.perf_counter()
            done = loop()
            seconds = time.perf_counter() - start
            if round:
                best[name] = max(best[name], done / seconds)
    return best


def resident() -> int:
    """Memory of this process that is in use, bytes."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


class Findings:
    """Tables, numbers and claims, printed as they come.

    Args:
        judge_rates: whether claims on rates count; those on errors and memory always do.
    """

    def __init__(self, judge_rates: bool):
        self._judge_rates = judge_rates
        self.tables: list[str] = []
        self.numbers: dict[str, dict[str, float]] = {}
        self.claims: list[tuple[str, str, str, bool | None]] = []

    def table(self, title: str, heading: tuple[str, ...], rows: list[tuple[object, ...]]) -> None:
        """Adds a table."""
        self.tables.append(f"{title}\n\n{markdown(heading, rows)}")
        print(self.tables[-1])

    def at_most(self, what: str, value: float, bound: float, rate: bool = False) -> None:
        """Claims value <= bound; `rate`: it is one of rates."""
        self._claim(what, value, "at most", bound, value <= bound, rate)

    def at_least(self, what: str, value: float, bound: float, rate: bool = False) -> None:
        """Claims value >= bound; `rate`: it is one of rates."""
        self._claim(what, value, "at least", bound, value >= bound, rate)

    def _claim(self, what: str, value: float, side: str, bound: float, holds: bool, rate: bool) -> None:
        verdict = holds if self._judge_rates or not rate else None
        self.claims.append((what, readable(value), f"{side} {readable(bound)}", verdict))
        self.numbers.setdefault("claims", {})[what] = value

    def verdict(self) -> bool:
        """Prints and adds the table of claims; whether none fails."""
        shown = {True: "holds", False: "FAILS", None: "not judged"}
        rows: list[tuple[object, ...]] = [(*row, shown[holds]) for *row, holds in self.claims]
        self.table("## What must hold", ("claim", "measured", "bound", ""), rows)
        return all(holds is not False for *_, holds in self.claims)


def readable(value: float) -> str:
    """A number in three digits."""
    if value == 0 or 1e-2 <= abs(value) < 1e3:
        return f"{value:.3g}"
    return f"{value:,.0f}" if 1e3 <= abs(value) < 1e12 else f"{value:.1e}"
