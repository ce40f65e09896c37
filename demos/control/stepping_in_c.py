"""Steps of an exported model in C, beside Python's, and beside the bare product of a step in NumPy."""

import ctypes
import subprocess
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np

import fenics_rom as fr
from fenics_rom.io.markdown import markdown

LOOP = """
#include "plant.h"

void run(plant *body, const plant_real *inputs, int rows, long steps);

void run(plant *body, const plant_real *inputs, int rows, long steps)
{
    long k;
    for (k = 0; k < steps; ++k)
        plant_step(body, inputs + k % rows * PLANT_INPUTS);
}
"""
FLAGS = ["-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror", "-O2", "-fPIC", "-shared"]
REALS = {"C, double": ("double", []), "C, float": ("float", ["-DPLANT_SINGLE"])}
STEPS = {"python": 20_000, "C": 200_000}  # in a round
ROUNDS, QUICK_ROUNDS = 21, 1  # the best of which counts
CHECKED = 1000  # steps after which states are compared
TENSION = 0.1  # N
MODEL_NAMES = (line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("model name"))
PROCESSOR = next(MODEL_NAMES, "unknown: a processor").split(":")[1].strip()

Array = np.ndarray


class Rates(NamedTuple):
    """What was measured."""

    table: str
    errors: dict[tuple[int, str], float]  # of order and form: of the state, relative
    gain: dict[int, float]  # of C in double over Python, both with their account, by order


def compare_rates(roms: Mapping[int, fr.Rom], out: Path, quick: bool) -> Rates:
    """Steps each model in every form, in turns."""
    rows, errors, gain = [], {}, {}
    for order, rom in roms.items():
        h = 1e-3
        inputs = TENSION * np.random.default_rng(0).standard_normal((CHECKED, 3))
        loops: dict[str, tuple[int, Callable[[int], None]]] = {}
        expected = python_steps(fr.Simulator(rom, h), inputs)
        for form, (kind, flags) in REALS.items():
            body, run = compiled(rom, out / f"order_{order}_{kind}", kind, flags, h)
            table = np.ascontiguousarray(inputs, dtype=np.float64 if kind == "double" else np.float32)
            run(body, table, CHECKED)
            found = np.concatenate([np.frombuffer(body.e, table.dtype), np.frombuffer(body.r, table.dtype)])
            errors[order, form] = float(np.linalg.norm(found - expected) / np.linalg.norm(expected))
            loops[form] = STEPS["C"], partial(run, body, table)
        for form, ledger in (("Python, `step`", False), ("Python, `step`, energy account kept", True)):
            loops[form] = STEPS["python"], partial(repeat, fr.Simulator(rom, h, ledger=ledger), list(inputs))
        loops["NumPy, the bare product"] = STEPS["python"], partial(bare_product, rom, h)
        seconds = dict.fromkeys(loops, np.inf)
        for _ in range(QUICK_ROUNDS if quick else ROUNDS):
            for form, (steps, loop) in loops.items():
                start = perf_counter()
                loop(steps)
                seconds[form] = min(seconds[form], (perf_counter() - start) / steps)
        gain[order] = seconds["Python, `step`, energy account kept"] / seconds["C, double"]
        for form, each in seconds.items():
            off = f"{errors[order, form]:.0e}" if (order, form) in errors else ""
            rows.append((order, form, f"{1 / each:,.0f}", f"{1e9 * each:,.0f}", off))
    return Rates(markdown(("order", "form", "steps per second", "ns", "off from Python"), rows), errors, gain)


def compiled(
    rom: fr.Rom, folder: Path, kind: str, flags: list[str], h: float
) -> tuple[ctypes.Structure, Callable[[ctypes.Structure, Array, int], None]]:
    """A body at rest in C, and what steps it under rows of inputs that repeat."""
    folder.mkdir(exist_ok=True)
    source = fr.export(rom, folder / "plant.c", dt=h)
    (folder / "loop.c").write_text(LOOP)
    library = folder / "plant.so"
    subprocess.run(["cc", *FLAGS, *flags, source, folder / "loop.c", "-o", library], check=True)
    real, order = (ctypes.c_double if kind == "double" else ctypes.c_float), rom.contact_models["side"].order

    class Plant(ctypes.Structure):
        _fields_ = (
            ("contact", ctypes.c_int),
            ("e", real * order),
            ("r", real * order),
            *((name, ctypes.c_double) for name in ("supplied", "dissipated", "lost_in_switching")),
        )

    body, code = Plant(), ctypes.CDLL(library)
    code.plant_init(ctypes.byref(body))

    def run(body: ctypes.Structure, inputs: Array, steps: int) -> None:
        code.run(ctypes.byref(body), inputs.ctypes, len(inputs), ctypes.c_long(steps))

    return body, run


def python_steps(body: fr.Simulator, inputs: Array) -> Array:
    """[ω q, r] after all of them."""
    for u in inputs:
        body.step(u)
    return body.energy_coordinates.copy()


def repeat(body: fr.Simulator, inputs: list[Array], steps: int) -> None:
    """Steps under inputs that repeat."""
    step = body.step
    for _ in range(steps // len(inputs)):
        for u in inputs:
            step(u)


def bare_product(rom: fr.Rom, h: float, steps: int) -> None:
    """[A B] times [x, u], with nothing taken over."""
    A, B, _, _ = rom.state_space("side", dt=h)
    whole, given, out, dot = np.hstack([A, B]), np.zeros(len(A) + B.shape[1]), np.zeros(len(A)), np.dot
    for _ in range(steps):
        dot(whole, given, out=out)
