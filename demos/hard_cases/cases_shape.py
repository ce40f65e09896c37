"""Slender and thin bodies, bad cells, and meshes far from a metre in size."""

from collections.abc import Iterator

import numpy as np
from boxes import box
from measures import FULL_ORDER, accounts, at_rest, both_runs
from rows import Row

import fenics_rom as fr

YOUNG = 1e6  # Pa
PUSH = (0.0, 0.0, 1e-6)  # N


def rows(quick: bool) -> Iterator[Row]:
    """All of them; `quick`: on coarse meshes."""
    yield from slender(quick)
    yield from bad_cells(quick)
    yield from sizes()


def slender(quick: bool) -> Iterator[Row]:
    """Beams against Timoshenko's: F L³ / (3 E I) + 6 F L / (5 G A), with ν = 0."""
    for aspect in (10, 500) if quick else (10, 50, 100, 500):
        thick = 1 / aspect
        system = box((1.0, thick, thick), (12 if quick else 30, 1, 1), degree=2, young=YOUNG, poisson=0.0)
        area, bending = thick**2, thick**4 / 12
        exact = PUSH[2] * (1 / (3 * YOUNG * bending) + 6 / (5 * YOUNG / 2 * area))
        case, hard = f"beam, aspect {aspect}", "slender"
        error = abs(at_rest(system, "right", PUSH)[2] / exact - 1)
        yield Row(case, hard, "tip at rest against Timoshenko's beam", error, 0.01)
        yield from reduced_thin(case, hard, system)


def reduced_thin(case: str, hard: str, system: fr.System) -> Iterator[Row]:
    """Reduced against full order, of which nodal velocities in double precision hold the balance to fewer digits."""
    rom = fr.reduce(system, order=20)
    runs = both_runs(system, rom, PUSH)
    yield Row(case, hard, "order 20 against full order: error of the run", runs.error, 1e-3)
    yield from accounts(case, hard, runs, full=FULL_ORDER)


def bad_cells(quick: bool) -> Iterator[Row]:
    """Cells a hundred times as long as wide, and a hundred times as wide as thick."""
    count = 3 if quick else 6
    shapes = {
        "needles, aspect 100": ((count * 1.0, count * 0.01, count * 0.01), (count, count, count)),
        "flat cells, aspect 100": ((count * 0.1, count * 0.1, 0.002), (count, count, 2)),
    }
    for case, (lengths, bricks) in shapes.items():
        for degree in (1, 2):
            system = box(lengths, bricks, degree=degree)
            yield from reduced_thin(case, f"bad cells, degree {degree}", system)


def sizes() -> Iterator[Row]:
    """The same body in millimetres and in kilometres: with times as long as it is, all is in proportion."""
    tips, σ = {}, {}
    for size in (1.0, 1e-3, 1e3):
        damping = f"alpha = {1 / size!r}, beta = {1e-3 * size!r}"
        system = box((0.3 * size, 0.1 * size, 0.1 * size), (4, 2, 2), damping=damping)
        rom = fr.reduce(system, order=20)
        runs = both_runs(system, rom, np.array(PUSH) * size**2)
        tips[size] = runs.tip / size
        σ[size] = rom.contact_models["right"].hankel_singular_values[:20]
        case, hard = f"beam of {0.3 * size:g} m", "size"
        yield Row(case, hard, "order 20 against full order: error of the run", runs.error, 1e-4)
        yield from accounts(case, hard, runs)
        if size != 1.0:
            gap = np.abs(tips[size] - tips[1.0]).max() / np.abs(tips[1.0]).max()
            yield Row(case, hard, "run at full order against that of 0.3 m", gap, 1e-6)
            ratio = (σ[size] / σ[size][0]) / (σ[1.0] / σ[1.0][0])
            yield Row(case, hard, "σ / σ₁ against those of 0.3 m", np.abs(ratio - 1).max(), 1e-6)
