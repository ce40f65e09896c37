"""Nearly incompressible material, and stiffness and density that jump within a body."""

from collections.abc import Iterator

from boxes import box
from measures import FULL_ORDER, ROUND_OFF, accounts, at_rest, both_runs
from rows import Row, said

import fenics_rom as fr

THICK = (0.3, 0.1, 0.1)  # m
PUSH = (0.0, 0.0, 1.0)  # N


def rows(quick: bool) -> Iterator[Row]:
    """All of them; `quick`: on coarse meshes."""
    yield from incompressible(quick)
    yield from contrast(quick)


def incompressible(quick: bool) -> Iterator[Row]:
    """A thick beam near ν = 0.5: its tip against a mesh twice as fine, and its reduced model against itself."""
    bricks, bound = ((6, 2, 2), 0.1) if quick else ((9, 3, 3), 0.05)
    finer = (2 * bricks[0], 2 * bricks[1], 2 * bricks[2])
    errors = {}
    for ν in (0.49, 0.499, 0.4999):
        case, hard = f"thick beam, ν = {ν}", "nearly incompressible"
        reference = at_rest(box(THICK, finer, degree=2, poisson=ν), "right", PUSH)[2]
        system, linear = (box(THICK, bricks, degree=degree, poisson=ν) for degree in (2, 1))
        errors[ν], locked = (float(abs(at_rest(s, "right", PUSH)[2] / reference - 1)) for s in (system, linear))
        yield Row(case, hard, "degree 2: error of the tip at rest", errors[ν], bound)
        yield Row(case, hard, "degree 1: share of the tip's displacement that locks away", locked, 0.3, at_least=True)
        yield said(case, "degree 1 locks", " ".join(linear.warnings), "lock", "mesh.degree = 2")
        runs = both_runs(system, fr.reduce(system, order=30), PUSH)
        yield Row(case, hard, "order 30 against full order: error of the run", runs.error, 1e-5)
        yield from accounts(case, hard, runs)
    growth = errors[0.4999] / errors[0.49]
    yield Row("thick beam", "nearly incompressible", "degree 2: error at ν = 0.4999 by that at 0.49", growth, 1.5)


def contrast(quick: bool) -> Iterator[Row]:
    """Halves of which one is a million times stiffer, or ten thousand times heavier, than the other."""
    soft, stiff, light, heavy = (1e5, 0.3, 1e3), (1e11, 0.3, 1e3), (1e5, 0.3, 1e1), (1e5, 0.3, 1e5)  # Pa, 1, kg/m3
    pairs = {
        "stiff root, soft tip": (stiff, soft, 30, 1e-5),
        "soft root, stiff tip": (soft, stiff, 30, 1e-5),
        "heavy root, light tip": (heavy, light, 60, 2e-2),
        "light root, heavy tip": (light, heavy, 60, 1e-3),
    }
    for case, (root, tip, order, bound) in pairs.items():
        hard = "stiffness 1 : 1e6" if stiff in (root, tip) else "density 1 : 1e4"
        materials = {"root": (lambda p: p[:, 0] < 0.15, *root), "tip": (lambda p: p[:, 0] > 0.15, *tip)}
        system = box(THICK, (4, 2, 2) if quick else (8, 3, 3), materials=materials)
        rom = fr.reduce(system, order=order)
        runs = both_runs(system, rom, PUSH)
        yield Row(case, hard, f"order {order} against full order: error of the run", runs.error, bound)
        yield from accounts(case, hard, runs, full=FULL_ORDER if tip is stiff else ROUND_OFF)
        if case == "heavy root, light tip":  # by mass a light tip hardly counts
            runs = both_runs(system, fr.reduce(system, order=30, weighting="nodal"), PUSH)
            yield Row(case, hard, "order 30, weighting = 'nodal': error of the run", runs.error, 0.05)
