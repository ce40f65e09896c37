"""The same reduction by pyMOR: the same models, and what each of them takes.

    python3 -m venv pymor-venv && pymor-venv/bin/pip install pymor
    python demos/scaling/against_pymor.py --pymor pymor-venv/bin/python      # takes minutes, nearly all of them pyMOR's

pyMOR's `SOBTfvReductor` projects as this project does, on directions from the position Gramians, so for one contact
mode the models should be equally good: that is a check, and not a merit. The paper's cylinder is assembled here and its
matrices are handed to pyMOR, which runs by itself in a Python of its own, since it needs a newer NumPy than Debian's
dolfinx stands. Inputs are forces on two contact patches, outputs the mean displacements of the patches: six numbers.
(The whole shape, which is what counts here as a rule, would be 12,000 outputs to pyMOR.) The script

1. compares errors of the transfer functions, both from the same full solves by SciPy;
2. compares times for two contact modes of order 40, of one thread each, with pyMOR as it comes and with the best of its
   settings that was found.

Everything is written to demos/scaling/out/. The checks at the end are on accuracy only.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from cylinder import PAPER, mesh, places, scene
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import splu

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.report import markdown

HERE = Path(__file__).parent
OUT = HERE / "out"

ORDERS = (6, 12, 24)
ORDER = 40  # of the timings
RUNS = 5
FREQUENCIES = 2 * np.pi * np.concatenate([[0.0], np.geomspace(0.5, 500, 16)])  # rad/s; the lowest resonance is at 2 Hz
OURS = {"fenics_rom, for the outputs": "outputs", "fenics_rom, for the whole shape": "mass"}  # weighting
BEST = {"pc_lr": {"projection_shifts_subspace_columns": 4}, "po_lr": {"projection_shifts_subspace_columns": 2}}
PYMOR = {  # settings of its low-rank Lyapunov solver; of 1 to 8 columns for the shifts these took the fewest solves
    "pyMOR as it comes": {},
    "pyMOR, its best shifts": BEST,
    "pyMOR, the same, 150 steps": {gramian: settings | {"adi_maxiter": 150} for gramian, settings in BEST.items()},
}
PARITY = 2.0
FASTER = 100  # times, the goal
NO_LARGER = 1.01  # of an error: to the digits that are printed

Array = np.ndarray
Model = dict[str, Any]  # M, D, K, inputs B by contact mode, outputs C


def main() -> None:
    """Runs the demo."""
    parser = argparse.ArgumentParser(description="Compares with pyMOR.")
    parser.add_argument("--pymor", required=True, metavar="PYTHON", help="interpreter of an environment with pyMOR")
    parser.add_argument("--factor", type=float, default=PAPER, help=f"of the mesh size (default: {PAPER})")
    options = parser.parse_args()
    OUT.mkdir(exist_ok=True)
    warnings.simplefilter("ignore", FenicsRomWarning)
    system = cylinder(options.factor)
    model = matrices(system)
    load = f"load {os.getloadavg()[0]:.1f} at the start"
    print(f"Cylinder: {system.size:,} unknowns; {load}\n")

    rows, errors, seconds = [], {}, {}
    for label, weighting in OURS.items():
        bases, seconds[label] = ours(system, model, weighting)
        errors[label] = errors_of(model, bases)
    for label, settings in PYMOR.items():
        found = peer(options.pymor, model, settings)
        seconds[label] = sum(float(value) for key, value in found.items() if key.startswith("seconds_"))
        errors[label] = errors_of(model, {(name, r): found[f"basis_{r}_B_{name}"] for name, r in bases})
        solves = [found[f"columns_pc_B_{name}"] // B.shape[1] for name, B in model["inputs"].items()]
        solves.append(found["columns_po"] // model["outputs"].shape[1])
        print(f"{label}: {seconds[label]:.0f} s; {', '.join(map(str, solves))} blocks of the three Gramian factors")
    first = next(iter(seconds.values()))
    for label, error in errors.items():
        shown = [f"{error[r][0]:.1e}" for r in (*ORDERS, ORDER)] + [f"{error[ORDER][1]:.1e}"]
        rows.append((label, f"{seconds[label]:.3g} s", f"{seconds[label] / first:.3g}", *shown))
    heading = (
        *("model", f"time, order {ORDER}", "times"),
        *(f"error, order {r}" for r in (*ORDERS, ORDER)),
        f"of the whole shape, order {ORDER}",
    )
    setting = (
        f"{system.size:,} unknowns, 2 contact modes of 3 inputs, 6 outputs; {found['versions']}; one thread, {load}. "
        f"Times: both contact modes; fenics_rom's is the median of {RUNS} runs, certificate included, pyMOR's of one. "
        f"Errors: largest |H - H_r| of the outputs at {len(FREQUENCIES)} frequencies up to 500 Hz, as a share of the "
        "largest |H|; the worse contact mode."
    )
    table = f"{setting}\n\n{markdown(heading, rows)}"
    (OUT / "against_pymor.md").write_text(table)
    print(f"\n{table}")
    goals(errors, seconds)
    check(errors)


def cylinder(factor: float) -> fr.System:
    """The cylinder with two contact modes."""
    OUT.mkdir(exist_ok=True)
    file = OUT / f"cylinder_{factor:g}.msh"
    mesh(file, factor)
    return fr.assemble(scene(file, places(2)))


def matrices(system: fr.System) -> Model:
    """Its matrices in SciPy's formats; the outputs are the mean displacements of the contact patches."""
    square = {
        name: csr_matrix(operator.mat.getValuesCSR()[::-1], shape=(system.size, system.size))
        for name, operator in (("M", system.mass), ("D", system.damping), ("K", system.stiffness))
    }
    inputs = {name: system.input_matrix(name) for name in system.contacts}
    return square | {"inputs": inputs, "outputs": np.hstack(list(inputs.values()))}


def ours(system: fr.System, model: Model, weighting: str) -> tuple[dict[tuple[str, int], Array], float]:
    """Bases by contact mode and order, and the median time of the largest order, certificate included."""
    watched = replace(system, outputs={"patches": model["outputs"]})
    bases, times = {}, []
    for order in (*ORDERS, *[ORDER] * RUNS):
        start = time.perf_counter()
        rom = fr.reduce(watched, order=order, weighting=weighting)
        times.append(time.perf_counter() - start)
        bases |= {(name, order): rom.basis @ mode.coordinates for name, mode in rom.modes.items()}
    return bases, statistics.median(times[-RUNS:])


def peer(python: str, model: Model, settings: dict[str, dict[str, int]]) -> dict[str, Any]:
    """What pyMOR makes of the same matrices: bases, times, versions."""
    given, result = OUT / "matrices.npz", OUT / "pymor.npz"
    parts = {f"{a}_{part}": getattr(model[a], part) for a in "MDK" for part in ("data", "indices", "indptr")}
    np.savez(given, C=model["outputs"], **parts, **{f"B_{name}": B for name, B in model["inputs"].items()})
    orders = ",".join(map(str, (*ORDERS, ORDER)))
    one_thread = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    command = [python, str(HERE / "pymor_worker.py"), str(given), str(result), orders, json.dumps(settings)]
    done = subprocess.run(command, env=os.environ | one_thread, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{' '.join(command)}\n{done.stdout}{done.stderr}")
    with np.load(result) as found:
        return dict(found)


def errors_of(model: Model, bases: dict[tuple[str, int], Array]) -> dict[int, tuple[float, float]]:
    """Transfer errors of the outputs and of the whole shape by order, the worse contact mode.

    Largest |H - H_r| over FREQUENCIES as a share of the largest |H|, in the Frobenius norm; of the shape in the mass
    norm. H from full solves, H_r from the Galerkin projection on the basis, whoever it comes from.
    """
    M, D, K, C = (model[name] for name in ("M", "D", "K", "outputs"))
    norms: dict[tuple[str, int], list[tuple[Array, Array]]] = {key: [] for key in bases}
    projected = {}
    for (name, order), basis in bases.items():
        V = np.linalg.qr(basis)[0]
        projected[name, order] = (V, *(V.T @ (A @ V) for A in (M, D, K)), V.T @ model["inputs"][name])
    for ω in FREQUENCIES:
        factor = splu((K + 1j * ω * D - ω**2 * M).tocsc())
        full = {name: factor.solve(B.astype(complex)) for name, B in model["inputs"].items()}
        for (name, order), (V, m, d, k, b) in projected.items():
            x = full[name]
            error = x - V @ np.linalg.solve(k + 1j * ω * d - ω**2 * m, b)
            norms[name, order].append(tuple(np.array([np.linalg.norm(C.T @ y), mass_norm(M, y)]) for y in (error, x)))
    worst: dict[int, tuple[float, float]] = {}
    for (_, order), pairs in norms.items():
        errors, sizes = (np.max(values, axis=0) for values in zip(*pairs, strict=True))
        worst[order] = tuple(np.maximum(worst.get(order, (0.0, 0.0)), errors / sizes))
    return worst


def mass_norm(M: csr_matrix, x: Array) -> float:
    """√tr(xᴴ M x)."""
    return float(np.sqrt(np.vdot(x, M @ x).real))


def goals(errors: dict[str, dict[int, tuple[float, float]]], seconds: dict[str, float]) -> None:
    """What was aimed at, and what was measured."""
    here, rows = next(iter(OURS)), []
    for label in PYMOR:
        times, larger = seconds[label] / seconds[here], errors[here][ORDER][0] / errors[label][ORDER][0]
        met = times >= FASTER and larger <= NO_LARGER
        goal = f"{FASTER} times faster at no larger error: {label}"
        rows.append((goal, f"{times:.0f} times, {larger:.3f} of its error", "yes" if met else "NO"))
    table = markdown(("goal", "measured", "met"), rows)
    with (OUT / "against_pymor.md").open("a") as file:
        file.write(f"\n{table}")
    print(table)


def check(errors: dict[str, dict[int, tuple[float, float]]]) -> None:
    """Both make equally good models."""
    claims = {}
    here = errors[next(iter(OURS))]
    for label in PYMOR:
        for order in ORDERS:
            ratio = here[order][0] / errors[label][order][0]
            claims[f"order {order}, {label}: error {ratio:.3f} times pyMOR's, within {PARITY:g}"] = (
                1 / PARITY <= ratio <= PARITY
            )
    for claim, holds in claims.items():
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    if not all(claims.values()):
        sys.exit(1)


if __name__ == "__main__":
    main()
