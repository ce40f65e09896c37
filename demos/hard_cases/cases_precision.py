"""Single precision: what it costs, and where it must not be used."""

from collections.abc import Iterator

import numpy as np
from boxes import box
from measures import FULL_ORDER
from rows import Row

import fenics_rom as fr

BEAM, BRICKS = (0.4, 0.1, 0.1), (6, 2, 2)  # m
PUSH = np.array([0.0, 0.0, 0.1])  # N
READ = 100  # instants at which two runs are compared
PER_STEP = 6e-8  # 2⁻²⁴, single precision's rounding: share of its energy that a step may add
FORTIETH = 1 / 40


def rows(quick: bool) -> Iterator[Row]:
    """All of them; `quick`: short runs."""
    steps = 4_000 if quick else 100_000
    yield from accuracy(steps)
    yield from drift(steps)


def accuracy(steps: int) -> Iterator[Row]:
    """Bodies with damping, in steps of all sizes."""
    system = box(BEAM, BRICKS)
    for order, case in ((20, "order 20"), (100, "order 100, stiff modes")):
        rom = fr.reduce(system, order=order)
        for part, bound in ((FORTIETH, 1e-5), (1e-4, 1e-3), (1e-6, 1e-2)):  # of the lowest period
            error, gap = beside_double(rom, part, steps)
            hard = f"float32, {steps:,} steps of {part:g} periods"
            yield Row(case, hard, "error of the tip against float64", error, bound)
            yield Row(case, hard, "gap of the energy account", gap, 10 * bound)


def drift(steps: int) -> Iterator[Row]:
    """Without damping round-off adds up."""
    free = fr.reduce(box(BEAM, BRICKS, damping=""), order=20, method="modal")
    for dtype, bound in ((np.float32, steps * PER_STEP), (np.float64, FULL_ORDER)):
        hard = f"{np.dtype(dtype)}, {steps:,} steps of 1e-3 s"
        yield Row("no damping", hard, "energy gained, relative", gained(free, dtype, steps), bound)


def beside_double(rom: fr.Rom, part: float, steps: int) -> tuple[float, float]:
    """Pushes for half of the steps; error of the tip, relative to its largest displacement, and gap of the account.

    Args:
        rom: with an output "tip".
        part: of the lowest period, that a step takes.
        steps: how many.
    """
    dt = part * 2 * np.pi / np.sqrt(rom.contact_models["right"].eigenvalues[0])
    double, single = (fr.Batch(rom, 1, dt, dtype=dtype, ledger=True) for dtype in (np.float64, np.float32))
    largest = error = 0.0
    for step in range(1, steps + 1):
        for body in (double, single):
            body.step(PUSH if step <= steps // 2 else 0 * PUSH)
        if step % (steps // READ) == 0:
            exact, tip = (body.displacement("tip") for body in (double, single))
            largest, error = max(largest, np.abs(exact).max()), max(error, np.abs(tip - exact).max())
    gap = abs(single.energy - single.supplied + single.dissipated)[0] / single.supplied[0]
    return float(error / largest), float(gap)


def gained(rom: fr.Rom, dtype: type, steps: int) -> float:
    """Energy that a free run without damping gained, as a share of what it began with."""
    body = fr.Batch(rom, 1, 1e-3, dtype=dtype)
    γ = rom.contact_models["right"].eigenvalues
    body.set_state(np.random.default_rng(0).standard_normal(len(γ)) / np.sqrt(γ), np.zeros(len(γ)))
    start, rest = body.energy[0], np.zeros(body.inputs)
    for _ in range(steps):
        body.step(rest)
    return float(body.energy[0] / start - 1)
