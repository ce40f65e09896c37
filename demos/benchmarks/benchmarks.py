"""Published cases of large deformation, vibration and contact that nobody here wrote, at full order.

    python demos/benchmarks/benchmarks.py             # some minutes
    python demos/benchmarks/benchmarks.py --quick     # fewer loads on coarser meshes

Loads of beams and of the flag are put on at once. The table has the mesh, the published number, the one found here, and
how often a system of equations was solved on the way. It is written to demos/benchmarks/out/, with --quick to
out/quick/.
"""

import argparse
import sys
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from balloon import balloon
from beam import tip_of_cantilever, torsion_constant
from dynamics import flag_that_falls, twisted_column
from hertz import hertz
from nafems import hot_solid, pressed_plate, solid_plate, tapered_membrane
from plain_newton import time_beside_plain_newton
from rubber import cook, pressed_cube
from solids import LARGE, PLANE_STRAIN, Row, bar, mesh_of, tip_under
from struck_bar import struck_bar
from toggle import toggle

from fenics_rom.errors import FenicsRomWarning
from fenics_rom.io.markdown import markdown

Array = np.ndarray
OUT = Path(__file__).parent / "out"
MAX_ITERATIONS = 25
MAX_TIMES = 2.0  # the processor time of plain Newton


def princeton(quick: bool) -> Iterator[Row]:
    """Dowell & Traybar, 1975, beside a beam; y and z at 45° of Bauchau et al., Multibody System Dynamics 37 (2016)."""
    length, wide, thick, young = 0.508, 0.0123777, 0.0032024, 71.7e9
    bricks = (40, 2, 1) if quick else (60, 3, 2)
    system = coarse = bar(bricks, lambda p: p * (length, wide, thick), young, 0.31, 2700.0)
    G, area = young / (2 * (1 + 0.31)), wide * thick
    along = np.array([young * area, 5 / 6 * G * area, 5 / 6 * G * area])
    second_moments = wide * thick**3 / 12, thick * wide**3 / 12
    bending = np.array([G * torsion_constant(wide, thick), *(young * moment for moment in second_moments)])
    most = 0
    for force in (13.345,) if quick else (4.448, 8.896, 13.345):
        for degrees in (0, 45, 90) if quick else range(0, 91, 15):
            β = np.radians(degrees)
            load = np.array([0.0, -force * np.cos(β), force * np.sin(β)])
            tip, iterations = tip_under(system, *load)
            most = max(most, iterations)
            what, beam = f"tip under {force} N at {degrees}°, m", tip_of_cantilever(length, along, bending, load)
            published, found = float(np.linalg.norm(beam)), float(np.linalg.norm(tip))
            allowed = 0.015 if quick else 0.01
            yield Row("Princeton beam", mesh_of(system, bricks), what, published, found, allowed, iterations)
    assert most <= MAX_ITERATIONS
    if not quick:
        fine = (60, 4, 2)
        system = bar(fine, lambda p: p * (length, wide, thick), young, 0.31, 2700.0)
        tip, iterations = tip_under(system, 0.0, -13.345 / np.sqrt(2), 13.345 / np.sqrt(2))
        for axis, published in ((1, -15.186e-3), (2, 156.467e-3)):
            what = f"{'xyz'[axis]} under 13.345 N at 45°, m"
            yield Row("Princeton beam", mesh_of(system, fine), what, published, float(tip[axis]), 0.01, iterations)
    times = time_beside_plain_newton(coarse, bricks, np.array([length, wide, thick]), young, 0.31, 13.345)
    print("13.345 N at 45°: {:.2f} s, plain Newton {:.2f} s in {} iterations".format(*times), flush=True)
    assert quick or times[0] <= MAX_TIMES * times[1]


def curved_cantilever(quick: bool) -> Iterator[Row]:
    """An eighth of a circle (Bathe & Bolourchi, 1979); the tip of a spectral element."""

    def place(p: Array) -> Array:
        angle, radius = np.pi / 4 * p[:, 0], 99.5 + p[:, 1]
        return np.column_stack([radius * np.sin(angle), radius * np.cos(angle), p[:, 2]])

    bricks = (16, 1, 1) if quick else (24, 1, 1)
    system = bar(bricks, place, 1e7, 0.0, 1.0)
    tip, iterations = tip_under(system, 0.0, 0.0, 600.0)
    published = float(np.linalg.norm([-23.65, 13.72, 53.58]))
    yield Row("45° curved cantilever", mesh_of(system, bricks), "tip under 600", published,
              float(np.linalg.norm(tip)), 0.01, iterations)  # fmt: skip


def heavy_cantilever(_quick: bool) -> Iterator[Row]:
    """0.12 kg with 0.2 kg at its tip, whose weight is a force there: FL³/3EI + qL⁴/8EI."""
    size, g = np.array([0.9, 0.07, 0.055]), 9.81
    bricks = (24, 2, 2)
    effects = f"{LARGE}gravity = {{ acceleration = [0.0, 0.0, {-g}] }}\n"
    system = bar(bricks, lambda p: p * size, 8e6, 0.25, 0.12 / float(size.prod()), effects)
    tip, iterations = tip_under(system, 0.0, 0.0, -0.2 * g, 1.0)
    yield Row("cantilever with a mass", mesh_of(system, bricks), "sag, m", 75.2e-3, -float(tip[2]), 0.015, iterations)


def flag(quick: bool) -> Iterator[Row]:
    """Turek & Hron (2006), CSM1 and CSM2: a flag behind a cylinder sinks by its weight, in plane strain."""

    def place(p: Array) -> Array:
        y = 0.02 * (p[:, 1] - 0.5)
        pole = 0.2 + np.sqrt(0.05**2 - y**2)
        return np.column_stack([pole + p[:, 0] * (0.6 - pole), y, 0.01 * p[:, 2]])

    bricks, poisson = (50, 4, 1) if quick else (80, 8, 1), 0.4
    for name, shear, published in (("CSM1", 0.5e6, (-7.187e-3, -66.10e-3)), ("CSM2", 2e6, (-0.469e-3, -16.97e-3))):
        effects = f"{LARGE}gravity = {{ acceleration = [0.0, -2.0, 0.0] }}\n"
        system = bar(bricks, place, 2 * shear * (1 + poisson), poisson, 1000.0, effects, PLANE_STRAIN)
        tip, iterations = tip_under(system, 0.0, 0.0, 0.0, 1.0)
        for axis, expected, found in zip("xy", published, tip[:2], strict=True):
            what = f"end of the flag in {axis}, m"
            yield Row(f"Turek-Hron {name}", mesh_of(system, bricks), what, expected, float(found), 0.01, iterations)


CASES = (princeton, curved_cantilever, heavy_cantilever, flag, tapered_membrane, solid_plate, pressed_plate, hot_solid,
         cook,
         pressed_cube, balloon, flag_that_falls, twisted_column, toggle, hertz, struck_bar)  # fmt: skip


def main() -> int:
    """Runs all of them; 1 if a claim does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer loads on coarser meshes")
    quick = parser.parse_args().quick
    warnings.simplefilter("ignore", FenicsRomWarning)
    rows: list[Row] = []
    for case in CASES:
        start = time.perf_counter()
        rows += case(quick)
        print(f"{rows[-1].case}: {time.perf_counter() - start:.1f} s", flush=True)
    heads = ["case", "mesh", "number", "published", "here", "off", "iterations"]
    table = [
        [r.case, r.mesh, r.what, f"{r.published:.5g}", f"{r.found:.5g}", f"{r.found / r.published - 1:+.2%}",
         "" if r.iterations is None else str(r.iterations)]
        for r in rows
    ]  # fmt: skip
    text = markdown(heads, table)
    print(text)
    out = OUT / "quick" if quick else OUT
    out.mkdir(parents=True, exist_ok=True)
    (out / "benchmarks.md").write_text(text)
    failures = 0
    for r in rows:
        holds = abs(r.found / r.published - 1) <= r.allowed and (r.iterations or 0) <= MAX_ITERATIONS
        failures += not holds
        print(f"  {'holds' if holds else 'FAILS'}: {r.case}, {r.what}, to {r.allowed:.1%}")
    return int(failures > 0)


if __name__ == "__main__":
    sys.exit(main())
