"""What stating errors costs: processor time of single steps and of rollouts, with and without.

    python demos/bounds/costs.py           # 2 min
    python demos/bounds/costs.py --quick   # the chain with one input

A rollout reads an output after each step. The bodies are those of bounds.py, and a chain of 200 masses under one and
three forces. Runs with and without errors take turns, and medians of their ratios are printed. Rollouts have taken so
many steps before that errors are kept by compiled loops; they are taken in NumPy alone, too.
"""

import argparse
import os
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from bounds import scenes
from numpy import ndarray as Array

import fenics_rom as fr
from fenics_rom.compilation import numpy_alone
from fenics_rom.io.markdown import markdown
from fenics_rom.runtime.error_maps import MANY

H = 1e-3  # s
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
ROLLED, STEPPED, TURNS = 16_384, 2_048, 15


def chain(forces: int) -> fr.System:
    """Masses between springs, some of which are pushed."""
    n, unit = 200, np.eye(200)
    K = 1e3 * sp.diags([-np.ones(n - 1), 2 * np.ones(n), -np.ones(n - 1)], [-1, 0, 1])
    pushed = {"contacts": {"end": unit[:, :forces]}, "outputs": {"far": unit[:, [n - 9]]}}
    return fr.System(mass=1e-2 * sp.identity(n), stiffness=K, rayleigh=(1.0, 1e-3), **pushed)


def roll(body: fr.Simulator, inputs: Array) -> None:
    """Takes steps at once."""
    body.rollout(inputs, outputs=[next(iter(body.rom.outputs))])


def step(body: fr.Simulator, inputs: Array) -> None:
    """Takes them one by one."""
    for u in inputs:
        body.step(u)


def costs(rom: fr.Rom, move: Callable[[fr.Simulator, Array], None], steps: int) -> tuple[float, float, float]:
    """Microseconds of a step without errors and with, and by which share these are more."""
    inputs = np.random.default_rng(0).standard_normal((steps, fr.Simulator(rom, H).inputs))
    bodies, taken = [fr.Simulator(rom, H, errors=errors) for errors in (False, True)], []
    if move is roll:
        bodies[1].rollout(np.resize(inputs, (MANY + 1, inputs.shape[1])))
    for _ in range(TURNS + 1):
        turn = []
        for body in bodies:
            start = time.process_time()
            move(body, inputs)
            turn.append(1e6 * (time.process_time() - start) / steps)
        taken.append(turn)
    without, beside = np.array(taken[1:]).T  # the first one makes maps
    return float(np.median(without)), float(np.median(beside)), float(np.median(beside / without)) - 1


def main() -> None:
    """Measures, and prints a table."""
    parser = argparse.ArgumentParser(description="What stating errors costs.")
    parser.add_argument("--quick", action="store_true", help="the chain with one input alone")
    quick = parser.parse_args().quick
    if not ONE_THREAD.items() <= os.environ.items():  # read when NumPy is loaded, so it takes another start
        os.execve(sys.executable, [sys.executable, *sys.argv], os.environ | ONE_THREAD)
    warnings.simplefilter("ignore")
    systems = {"chain, 1 input": chain(1)}
    if not quick:
        bodies = {f"{name}, 3 inputs": fr.assemble(replace(scene, run=None)) for name, scene in scenes().items()}
        systems |= {"chain, 3 inputs": chain(3)} | bodies
    rows = []
    for name, system in systems.items():
        for order in (20, 40):
            rom = fr.reduce(system, order=order, errors=True)
            assert rom.error_model is not None
            found = [costs(rom, *given) for given in ((step, STEPPED), (roll, ROLLED))]
            with numpy_alone():
                found.append(costs(rom, roll, ROLLED))
            told = [f"{a:.2f}, {b:.2f}, +{100 * more:.0f} %" for a, b, more in found]
            rows.append((name, f"{order}, {len(rom.error_model.eigenvalues)}", *told))
    heads = "body", "order, directions of the finer model", "single step: without, with", "rollout", "in NumPy alone"
    print(markdown(heads, rows))


if __name__ == "__main__":
    main()
