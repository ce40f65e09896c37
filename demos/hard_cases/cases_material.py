"""Nearly incompressible material, and stiffness and density that jump within a body."""

from collections.abc import Iterator, Sequence

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


def incompressible(quick: bool, ratios: Sequence[float] = (0.49, 0.499, 0.4999)) -> Iterator[Row]:
    """A thick beam near ν = 0.5: its tip against a mesh twice as fine, and its reduced model against itself."""
    bricks, bound = ((6, 2, 2), 0.1) if quick else ((9, 3, 3), 0.05)
    finer = (2 * bricks[0], 2 * bricks[1], 2 * bricks[2])
    errors = {}
    for ν in ratios:
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
    growth = errors[ratios[-1]] / errors[ratios[0]]
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
    bricks = (4, 2, 2) if quick else (8, 3, 3)
    for case, (root, tip, order, bound) in pairs.items():
        hard = "stiffness 1 : 1e6" if stiff in (root, tip) else "density 1 : 1e4"
        materials = {"root": (lambda p: p[:, 0] < 0.15, *root), "tip": (lambda p: p[:, 0] > 0.15, *tip)}
        system = box(THICK, bricks, materials=materials)
        rom = fr.reduce(system, order=order)
        runs = both_runs(system, rom, PUSH)
        yield Row(case, hard, f"order {order} against full order: error of the run", runs.error, bound)
        yield from accounts(case, hard, runs, full=FULL_ORDER if tip is stiff else ROUND_OFF)
        mass = THICK[0] * THICK[1] * THICK[2] * (root[2] + tip[2]) / 2
        yield Row(case, hard, "mass against ρ times volume", abs(system.body.node_mass.sum() / mass - 1), 1e-12)
        if case == "stiff root, soft tip":
            half = box((THICK[0] / 2, *THICK[1:]), (bricks[0] // 2, *bricks[1:]), young=soft[0])
            gap = at_rest(system, "right", PUSH)[2] / at_rest(half, "right", PUSH)[2] - 1
            yield Row(case, hard, "tip at rest against the soft half alone, clamped", abs(gap), 1e-4)
        if case == "heavy root, light tip":  # by mass a light tip hardly counts
            messages = " ".join(fr.reduce(system, order=30).warnings)
            yield said(case, "order 30 by mass", messages, "'right' misses", "weighs little", "weighting = 'nodal'")
            by_node = fr.reduce(system, order=30, weighting="nodal")
            runs = both_runs(system, by_node, PUSH)
            yield Row(case, hard, "order 30, weighting = 'nodal': error of the run", runs.error, 0.05)
            yield Row(case, hard, "order 30, weighting = 'nodal': warnings", len(by_node.warnings), 0)
