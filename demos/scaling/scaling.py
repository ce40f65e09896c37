"""What the offline stage costs: against the size of the model, the number of contact modes, and the ranks of MPI.

    python demos/scaling/scaling.py                        # some minutes, up to 260,000 unknowns
    python demos/scaling/scaling.py --largest 1000000      # needs about 20 GB
    python demos/scaling/scaling.py --quick                # small meshes, to see that it works

The paper's silicone cylinder, clamped at both ends, is meshed finer and finer and touched in more and more places. Each
case runs by itself under mpirun (measure.py) and reports its time stage by stage, the memory of its largest rank, and
how good the reduced models are. The script

1. tables what each case cost, beside its accuracy;
2. tables what was aimed at and what was measured;
3. draws the costs and what they consist of.

Everything is written to demos/scaling/out/, with --quick to out/quick/. The checks at the end are on accuracy only: a
slow or busy machine keeps them. Times are of one thread a rank; where a case is repeated, of the median run.
"""

import argparse
import csv
import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from cylinder import PAPER, mesh

from fenics_rom.io.markdown import markdown

HERE = Path(__file__).parent
MPIRUN = ("mpirun", "-x", "OMPI_MCA_mpi_yield_when_idle=1", "-n")  # ranks that wait give way: there may be few cores
OUT = HERE / "out"

SIZES = {12_000: PAPER, 30_000: 0.55, 100_000: 0.345, 260_000: 0.24, 600_000: 0.176, 1_000_000: 0.146}  # size factors
CONTACTS = (1, 3, 10, 30, 100)
QUICK_SIZES = {1_700: 2.0, 4_500: 1.25}
QUICK_CONTACTS = (1, 10)
CORES = len(os.sched_getaffinity(0))
FEW = 20  # order of the reduced models of two contact modes
MANY = 40  # of one to a hundred
RUNS = 3  # of each number of contact modes

FACTORISATION = "factorisation of K"
LARGE = 500_000  # unknowns from which on a goal is set for time and memory


@dataclass(frozen=True)
class Case:
    """What to measure: a mesh, a number of contact modes and of ranks, and how often."""

    factor: float
    contacts: int
    ranks: int
    order: int
    runs: int = 1


@dataclass(frozen=True)
class Cost:
    """What a case cost, and how good its reduced models are; `stages` are those of the median run."""

    case: Case
    unknowns: int
    assembly: float
    stages: dict[str, float]
    memory: float
    transfer_error: float
    static_error: float
    singular_values: list[list[float]]

    @property
    def reduction(self) -> float:
        """Seconds of the whole reduction, after assembly."""
        return sum(self.stages.values())


def main() -> None:
    """Runs the demo."""
    parser = argparse.ArgumentParser(description="Measures what the offline stage costs.")
    parser.add_argument("--largest", type=int, default=260_000, metavar="N", help="most unknowns (default: 260000)")
    parser.add_argument("--quick", action="store_true", help="small meshes only")
    options = parser.parse_args()
    if options.largest < min(SIZES):
        parser.error(f"--largest {options.largest}: use {min(SIZES)} or more")
    out = OUT / "quick" if options.quick else OUT  # so that a test does not overwrite what took minutes
    out.mkdir(parents=True, exist_ok=True)
    machine = f"{processor()}, {CORES} cores, load {os.getloadavg()[0]:.1f} at the start; one thread a rank"
    print(f"{machine}\n")

    sizes = QUICK_SIZES if options.quick else {n: factor for n, factor in SIZES.items() if n <= options.largest}
    contacts, runs = (QUICK_CONTACTS, 1) if options.quick else (CONTACTS, RUNS)
    ranks = [count for count in (1, 2, 4) if count <= max(2, CORES)]
    factors = list(sizes.values())
    smallest, middle = factors[0], factors[:3][-1]
    parts = {
        "unknowns": [Case(factor, 2, 2, FEW) for factor in factors],
        "contact modes": [Case(smallest, count, 1, MANY, runs) for count in contacts],
        "ranks": [Case(middle, 2, count, FEW) for count in ranks],
    }
    if not options.quick:
        cost(Case(max(QUICK_SIZES.values()), 1, 2, FEW), out)  # so that nothing is left to be compiled
    measured = {case: cost(case, out) for case in dict.fromkeys(case for cases in parts.values() for case in cases)}
    costs = {part: [measured[case] for case in cases] for part, cases in parts.items()}

    table_of_costs(costs, machine, out)
    table_of_goals(costs, out)
    picture(costs, out)
    check(costs)


def processor() -> str:
    """What the machine calls its processor."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    return next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), "unknown processor")


def cost(case: Case, out: Path) -> Cost:
    """Runs a case under mpirun."""
    file = out / f"cylinder_{case.factor:g}.msh"
    if not file.exists():
        mesh(file, case.factor)
    result = out / "case.json"
    result.unlink(missing_ok=True)
    command = [*MPIRUN, str(case.ranks), sys.executable, str(HERE / "measure.py"), str(file)]
    command += [str(case.contacts), str(case.order), str(case.runs), str(result)]
    done = subprocess.run(command, capture_output=True, text=True, env={"OMP_NUM_THREADS": "1"} | os.environ)
    if done.returncode:
        sys.exit(f"{' '.join(command)}\n{done.stdout}{done.stderr}")
    measured: dict[str, Any] = json.loads(result.read_text())
    by_time = sorted(measured.pop("stages"), key=lambda stages: sum(stages.values()))
    return Cost(case=case, stages=by_time[len(by_time) // 2], **measured)


def table_of_costs(costs: dict[str, list[Cost]], machine: str, out: Path) -> None:
    """Every case: to a CSV file stage by stage, and to a Markdown table in short."""
    stages = list(dict.fromkeys(stage for part in costs.values() for c in part for stage in c.stages))
    with (out / "costs.csv").open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(
            ["against", "unknowns", "contact modes", "ranks", "order", "runs", "assembly (s)"]
            + [f"{stage} (s)" for stage in stages]
            + ["reduction (s)", "peak memory of a rank (bytes)", "transfer error", "static error"]
        )
        for part, cases in costs.items():
            for c in cases:
                writer.writerow(
                    [part, c.unknowns, c.case.contacts, c.case.ranks, c.case.order, c.case.runs, c.assembly]
                    + [c.stages.get(stage, 0.0) for stage in stages]
                    + [c.reduction, c.memory, c.transfer_error, c.static_error]
                )
    heading = ("against", "unknowns", "contact modes", "order", "ranks", "assembly", "factorisation of K", "reduction")
    heading += ("largest stage beside it", "memory of a rank", "transfer error")
    rows = [
        (
            part,
            f"{c.unknowns:,}",
            c.case.contacts,
            c.case.order,
            c.case.ranks,
            f"{c.assembly:.2f} s",
            f"{c.stages[FACTORISATION]:.2f} s",
            f"{c.reduction:.2f} s",
            "{}, {:.0%}".format(*largest_stage(c)),
            f"{c.memory / 1e9:.2f} GB",
            f"{c.transfer_error:.1e}",
        )
        for part, cases in costs.items()
        for c in cases
    ]
    table = f"{machine}\n\n{markdown(heading, rows)}"
    (out / "costs.md").write_text(table)
    print(markdown(heading, rows))


def largest_stage(c: Cost) -> tuple[str, float]:
    """The stage beside the factorisation that takes most of the reduction, and its share."""
    name = max((stage for stage in c.stages if stage != FACTORISATION), key=lambda stage: c.stages[stage])
    return name, c.stages[name] / c.reduction


def table_of_goals(costs: dict[str, list[Cost]], out: Path) -> None:
    """What was aimed at, and what was measured."""
    by_contacts = {c.case.contacts: c.reduction for c in costs["contact modes"]}
    large = next((c for c in costs["unknowns"] if c.unknowns >= LARGE), None)
    what = "a model of 600,000 unknowns on two ranks" if large is None else f"{large.unknowns:,} unknowns on two ranks"
    measured = [
        (
            "100 contact modes cost at most 15 times one",
            by_contacts[100] / by_contacts[1] if 100 in by_contacts else None,
            15,
            "times",
        ),
        (f"{what}: at most 8 GB a rank", large and large.memory / 1e9, 8, "GB"),
        (
            f"{what}: the reduction at most 3 times the factorisation",
            large and large.reduction / large.stages[FACTORISATION],
            3,
            "times",
        ),
    ]
    rows = [
        (goal, "not in this run", "")
        if value is None
        else (goal, f"{value:.1f} {unit}", "yes" if value <= most else "NO")
        for goal, value, most, unit in measured
    ]
    table = markdown(("goal", "measured", "met"), rows)
    (out / "goals.md").write_text(table)
    print(table)


def picture(costs: dict[str, list[Cost]], out: Path) -> None:
    """Seconds, what they consist of, and memory, against unknowns, contact modes and ranks."""
    along = {
        "unknowns": [c.unknowns for c in costs["unknowns"]],
        "contact modes": [c.case.contacts for c in costs["contact modes"]],
        "ranks": [c.case.ranks for c in costs["ranks"]],
    }
    fixed = {
        "unknowns": "2 contact modes, order {order}, {ranks} ranks",
        "contact modes": "{size} unknowns, order {order}, {ranks} rank",
        "ranks": "{size} unknowns, 2 contact modes, order {order}",
    }
    by_stages = sorted((c for cases in costs.values() for c in cases), key=lambda c: -len(c.stages))
    stages = list(dict.fromkeys(stage for c in by_stages for stage in c.stages))
    colours = dict(zip(stages, mpl.colormaps["tab10"].colors, strict=False))
    figure, axes = plt.subplots(3, 3, figsize=(11, 9), sharey="row", layout="constrained")
    for (part, cases), (seconds, shares, memory) in zip(costs.items(), axes.T, strict=True):
        x, positions, bottom = along[part], np.arange(len(cases)), np.zeros(len(cases))
        seconds.loglog(x, [c.reduction for c in cases], "o-", color="black", label="reduction")
        factorisation = [c.stages[FACTORISATION] for c in cases]
        seconds.loglog(x, factorisation, "s-", color=colours[FACTORISATION], label=f"its {FACTORISATION}")
        seconds.loglog(x, [c.assembly for c in cases], "^--", color="grey", label="assembly, before it")
        for stage in stages:
            share = np.array([100 * c.stages.get(stage, 0.0) / c.reduction for c in cases])
            shares.bar(positions, share, bottom=bottom, color=colours[stage], label=stage, width=0.8)
            bottom += share
        memory.loglog(x, [c.memory / 1e9 for c in cases], "o-", color="black")
        shares.set_xticks(positions, map(short, x))
        for plain in (seconds, memory):
            plain.set_xticks(x, map(short, x))
            plain.minorticks_off()
            plain.grid(linewidth=0.4)
            plain.yaxis.set_major_formatter("{x:g}")
        for each in (seconds, shares, memory):
            each.set_xlabel(part)
        first = cases[0]
        title = fixed[part].format(order=first.case.order, ranks=first.case.ranks, size=short(first.unknowns))
        seconds.set_title(title, fontsize=10)
    least, most = (f(c.memory / 1e9 for cases in costs.values() for c in cases) for f in (min, max))
    axes[2, 0].set_ylim(10 ** np.floor(np.log10(least)), 10 ** np.ceil(np.log10(most)))
    for row, label in enumerate(("time (s)", "share of the reduction (%)", "peak memory of a rank (GB)")):
        axes[row, 0].set_ylabel(label)
    axes[1, 0].set_ylim(0, 100)
    axes[0, 0].legend(fontsize=9)
    handles, labels = axes[1, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=9, title="stages of the reduction")
    figure.savefig(out / "scaling.png", dpi=110)
    plt.close(figure)


def short(number: int) -> str:
    """A number in three or four characters."""
    thousands = number / 1e3
    return f"{number}" if number < 1000 else f"{thousands:.2g}k" if thousands < 100 else f"{thousands:.0f}k"


def check(costs: dict[str, list[Cost]]) -> None:
    """What every one of these timings has to be worth."""
    everything = [c for cases in costs.values() for c in cases]
    errors = {order: max(c.transfer_error for c in everything if c.case.order == order) for order in (FEW, MANY)}
    ranks = change([c.singular_values for c in costs["ranks"]], relative=True)
    apart = change([c.singular_values[:1] for c in costs["contact modes"]], relative=False)
    claims = {
        f"transfer functions at order {FEW}: wrong by {errors[FEW]:.1e}, at most 5e-5": errors[FEW] <= 5e-5,
        f"transfer functions at order {MANY}: wrong by {errors[MANY]:.1e}, at most 1e-6": errors[MANY] <= 1e-6,
        f"σ on any number of ranks: the same to {ranks:.1e}, at most 1e-8": ranks <= 1e-8,
        f"σ of a contact mode among others: the same to {apart:.1e} of σ_1, at most 1e-7": apart <= 1e-7,
    }
    for claim, holds in claims.items():
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    if not all(claims.values()):
        sys.exit(1)


def change(singular_values: list[list[list[float]]], *, relative: bool) -> float:
    """Largest difference of σ from the first case's, as a share of each σ or of the largest of its contact mode."""
    first, *others = (np.array(σ) for σ in singular_values)
    return max(float((np.abs(σ - first) / (first if relative else first[:, :1])).max()) for σ in others)


if __name__ == "__main__":
    main()
