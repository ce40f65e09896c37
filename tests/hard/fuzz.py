"""Reads what nobody should write: mutated files, scenes and meshes, and counts what comes of them.

python tests/hard/fuzz.py files --count 10000 --seed 0

Each case is made from the seed and its number alone, so that `--first N --count 1` does it again. They are read in
another process with an address space and a time for each case that are limited: one that dies is noted, and a new one
goes on behind the case.
"""

import argparse
import importlib
import os
import resource
import signal
import subprocess
import sys
import tempfile
import traceback
from collections import Counter
from pathlib import Path

import numpy as np

KINDS = {"files": "mutated_files", "scenes": "mutated_scenes", "meshes": "mutated_meshes"}
MEMORY = 3 * 2**30  # bytes of address space, of which Python, its packages and one stack take about one half
PATIENCE = 20.0  # s for a case
BAD = "BAD"


def run(kind: str, count: int, seed: int, first: int = 0) -> tuple[Counter[str], list[str]]:
    """How often each outcome came, and the cases with a bad one."""
    outcomes: Counter[str] = Counter()
    bad: list[str] = []
    at = first
    while at < first + count:
        worker = [sys.executable, str(Path(__file__).resolve()), kind, "--worker", f"--seed={seed}"]
        with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryFile("w+") as errors:
            done = subprocess.run(
                [*worker, f"--first={at}", f"--count={first + count - at}", f"--folder={folder}"],
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                env={**os.environ, "OMP_NUM_THREADS": "1"},
            )
            errors.seek(0)
            said = errors.read()
        for line in done.stdout.splitlines():
            number, _, outcome = line.partition("\t")
            if number == "memory":
                outcomes[f"largest memory: {outcome}"] += 0
                continue
            at = int(number) + 1
            outcomes[outcome.partition(": ")[0]] += 1
            if outcome.startswith(BAD):
                bad.append(f"{number}: {outcome}")
        if done.returncode:
            if at >= first + count:
                raise RuntimeError(f"the worker ended with {done.returncode}: {said}")
            outcomes[f"{BAD} process ended by {ended(done.returncode)}"] += 1
            bad.append(f"{at}: process ended by {ended(done.returncode)}\n{stack(said)}")
            at += 1
    return outcomes, bad


def ended(status: int) -> str:
    """How a process ended."""
    return (
        "SIGALRM: it hangs"
        if status == -signal.SIGALRM
        else signal.Signals(-status).name
        if status < 0
        else f"{status}"
    )


def stack(said: str) -> str:
    """The innermost lines of Python that faulthandler names."""
    return "; ".join(line.strip() for line in said.splitlines() if line.lstrip().startswith("File "))[:600]


def work(kind: str, count: int, seed: int, first: int, folder: Path) -> None:
    """One case after the other, in this process."""
    import faulthandler

    faulthandler.enable()
    module = importlib.import_module(KINDS[kind])
    module.prepare(folder)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for number in range(first, first + count):
        signal.setitimer(signal.ITIMER_REAL, PATIENCE)  # without a handler: Python's would wait for HDF5 to return
        description, case = module.mutated(np.random.default_rng([seed, number]))
        try:
            outcome = module.outcome(case, folder)
        except Exception as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            place = f"{Path(where.filename).name}:{where.lineno}"
            outcome = f"{BAD} {type(error).__name__}: {' '.join(str(error).split())[:200]} at {place} ({description})"
        signal.setitimer(signal.ITIMER_REAL, 0)
        print(f"{number}\t{outcome}", flush=True)
    print(f"memory\t{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:,.0f} MiB", flush=True)


def main() -> None:
    """See above."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    choice = parser.parse_args()
    if choice.worker:
        work(choice.kind, choice.count, choice.seed, choice.first, choice.folder)
        return
    outcomes, bad = run(choice.kind, choice.count, choice.seed, choice.first)
    for outcome, count in outcomes.most_common():
        print(f"{count:7,d}  {outcome}")
    for case in bad:
        print(case)
    sys.exit(1 if bad else 0)


if __name__ == "__main__":
    main()
