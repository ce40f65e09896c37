"""How rates are measured here, and how a machine is called."""

import os
import statistics
import time
from collections.abc import Callable, Mapping
from pathlib import Path

ROUNDS = 5


def medians(loops: Mapping[str, Callable[[], int]], rounds: int = ROUNDS) -> dict[str, float]:
    """What each loop does in a second, the median of some rounds in which they take turns.

    Args:
        loops: each returns how many steps it has taken.
        rounds: how many, after one that is not counted.
    """
    found: dict[str, list[float]] = {name: [] for name in loops}
    for round in range(rounds + 1):
        for name, loop in loops.items():
            start = time.perf_counter()
            done = loop()
            if round:
                found[name].append(done / (time.perf_counter() - start))
    return {name: statistics.median(rates) for name, rates in found.items()}


def machine() -> str:
    """Processor, cores and load."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    name = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), "unknown processor")
    return f"{name}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} at the start"
