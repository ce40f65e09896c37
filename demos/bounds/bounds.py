"""Bound, estimate and truth of the error of three bodies over time, also where the contact mode changes at every step.

    python demos/bounds/bounds.py           # 1 min
    python demos/bounds/bounds.py --quick   # the plate alone, fewer steps

Everything is written to demos/bounds/out/. The checks at the end fail if a claim does not hold.
"""

import argparse
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy import ndarray as Array
from random_runs import ROUND_OFF, Errors, compare

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.io.markdown import markdown
from fenics_rom.scene.file import parse_scene

HERE = Path(__file__).parent
ORDERS = (10, 20, 40)
FINGER = """
name = "finger"
mesh = {{ file = "{file}", degree = 2 }}
material = {{ young = 1.0e6, poisson = 0.45, density = 1070.0 }}
supports = {{ clamped = ["root"] }}
contacts.tip = {{ near = {{ point = [0.09, 0.0, -0.01], radius = 0.008 }} }}
contacts.middle = {{ near = {{ point = [0.05, 0.0, -0.01], radius = 0.008 }} }}
outputs.end = {{ points = [[0.1, 0.0, 0.0]] }}
effects = {{ inertia = {{}}, damping = {{ alpha = 1.0, beta = 2e-3 }} }}
"""


def main() -> None:
    """Runs the demo; exits with 1 where a claim fails."""
    parser = argparse.ArgumentParser(description="Errors that runs state themselves.")
    parser.add_argument("--quick", action="store_true", help="the plate alone, fewer steps")
    quick = parser.parse_args().quick
    out = HERE / "out" / "quick" if quick else HERE / "out"
    out.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore", FenicsRomWarning)  # of the plate's cells, which are the paper's
    rows, runs = [], {}
    for name, scene in list(scenes().items())[: 1 if quick else None]:
        h, contacts, inputs = history(list(scene.contacts)[:2], 60 if quick else 300)
        system = fr.assemble(replace(scene, run=None))
        models = [fr.reduce(system, order=order, errors=True) for order in ORDERS]
        runs[name] = h, compare(system, models, h, contacts, inputs)
        rows += [row_of(f"{name}, {system.size:,}", *each) for each in zip(ORDERS, runs[name][1], strict=True)]
    heads = ("body, unknowns", "order", "error", "bound / error", "estimate / error")
    table = markdown(heads, rows)
    print(table)
    (out / "bounds.md").write_text(table)
    draw(runs, out / "bounds.png")
    every = [each for _, errors in runs.values() for each in errors]
    claims = [
        ("no error is above its bound", max(each.broken for each in every) <= ROUND_OFF),
        ("no error of an output is above its bound", max(each.outputs for each in every) <= ROUND_OFF),
        ("estimates are within a factor of 1.5", all(1 / 1.5 < each.ratio < 1.5 for each in every)),
        ("bounds are below twice the error", max(each.effectivity for each in every) < 2),
    ]
    for claim, holds in claims:
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    sys.exit(0 if all(holds for _, holds in claims) else 1)


def scenes() -> dict[str, fr.Scene]:
    """The plate, the cylinder and the finger."""
    demos = HERE.parent
    return {
        "plate": fr.read_scene(demos / "plate" / "plate.toml"),
        "cylinder": fr.read_scene(demos / "cylinder" / "cylinder.toml"),
        "finger": parse_scene(FINGER.format(file=demos.parent / "meshes" / "finger.msh")),
    }


def history(names: list[str], third: int) -> tuple[float, list[str], Array]:
    """Step, s, contact modes and forces (steps, 3), N: a push, its release, noise while contact changes each step."""
    noise = np.random.default_rng(0).standard_normal((third, 3))
    push = np.tile([0.0, 0.3, 1.0], (third, 1))
    contacts = 2 * third * names[:1] + [names[step % 2] for step in range(third)]
    return 1e-3, contacts, np.vstack([push, 0 * push, noise])


def row_of(name: str, order: int, run: Errors) -> tuple[str, ...]:
    """What the table says of a run."""
    largest = run.true.max() / run.largest
    return name, str(order), f"{largest:.1e}", f"{run.effectivity:.3f}", f"{run.ratio:.3f}"


def draw(runs: dict[str, tuple[float, list[Errors]]], file: Path) -> None:
    """Of each body and two orders error, bound and estimate over time, as shares of the largest energy norm."""
    figure, axes = plt.subplots(1, len(runs), figsize=(3.6 * len(runs), 3.4), layout="constrained", squeeze=False)
    for (name, (h, errors)), view in zip(runs.items(), axes[0], strict=True):
        for k, (order, run) in enumerate(list(zip(ORDERS, errors, strict=True))[:2]):
            times = h * np.arange(1, len(run.true) + 1)
            view.semilogy(times, run.bound / run.largest, color=f"C{k}", linewidth=2.0, label=f"bound, order {order}")
            view.semilogy(times, run.true / run.largest, color=f"C{k}", linewidth=3.0, alpha=0.35, label="error")
            view.semilogy(times, run.estimate / run.largest, color="k", linewidth=0.8, linestyle=":", label="estimate")
        view.set(title=name, xlabel="time (s)", ylabel="error in the energy norm (1)")
        view.grid(alpha=0.3)
        for part in (1, 2):
            view.axvline(h * part * len(errors[0].true) / 3, color="0.6", linewidth=0.5)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    figure.savefig(file, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    main()
