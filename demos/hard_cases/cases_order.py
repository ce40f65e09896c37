"""Orders from one to more than there is, and cuts between equal Hankel singular values."""

import warnings
from collections.abc import Iterator

import numpy as np
import scipy.sparse as sp
from boxes import box
from cases_contact import near, ride_rows
from measures import both_runs
from rows import Row, said

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning

PUSH = (0.1, 0.1, 0.1)  # N


def rows(quick: bool) -> Iterator[Row]:
    """All of them; `quick`: short rides."""
    steps = 500 if quick else 20_000
    yield from orders(steps)
    yield from equal(steps)


def orders(steps: int) -> Iterator[Row]:
    """The run's error falls to round-off, and more than there is does no harm."""
    contacts = {"right": 'surface = "right"\nforce = "resultant"', "spot": near(0.2, 0.06)}
    system = box((0.4, 0.1, 0.1), (4, 1, 1), contacts=contacts)
    bounds = {1: 1.5, 2: 1.5, 5: 0.1, 20: 1e-2, system.size: 1e-9, 10 * system.size: 1e-9}
    for order, bound in bounds.items():
        case = f"order {order} of {system.size} unknowns"
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", FenicsRomWarning)
            rom = fr.reduce(system, order=order)
        yield Row(case, "order", "error of the run against full order", both_runs(system, rom, PUSH).error, bound)
        yield from ride_rows(case, "order", rom, steps)
        if order > system.size:
            messages = " ".join(str(warning.message) for warning in caught)
            yield said(case, "more than there is", messages, f"order {order} was asked for", "numerically there")


def equal(steps: int) -> Iterator[Row]:
    """Pairs of equal σ, cut in the middle: two strings that know nothing of each other, and a square beam."""
    rom, errors = {}, {}
    for order in (8, 9, 10):
        rom[order] = fr.reduce(two_strings(), order=order)
        errors[order] = rom[order].contact_models["one"].transfer_errors.max()
    σ = rom[9].contact_models["one"].hankel_singular_values
    pair = abs(σ[8] / σ[9] - 1)
    case, hard = "two equal strings, order 9", "cut between equal σ"
    yield Row(case, hard, "difference of the two σ at the cut, relative", pair, 1e-9)
    yield Row(case, hard, "transfer error, by that of order 8", errors[9] / errors[8], 1.01)
    yield Row("two equal strings, order 10", hard, "transfer error, by that of order 9", errors[10] / errors[9], 1.01)
    yield from ride_rows(case, hard, rom[9], steps)
    contacts = {"right": 'surface = "right"\nforce = "resultant"', "spot": near(0.2, 0.06)}
    beam = box((0.4, 0.1, 0.1), (4, 2, 2), contacts=contacts)
    yield from ride_rows("square beam, order 9", "cut between nearly equal σ", fr.reduce(beam, order=9), steps)


def two_strings(n: int = 40) -> fr.System:
    """Two equal strings, in coordinates that mix them, each with an end that is pushed; and both, pushed midway."""
    string = sp.diags([-np.ones(n - 1), 2 * np.ones(n), -np.ones(n - 1)], [-1, 0, 1])
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    ends = np.kron(turn, np.eye(n))[:, [0, n]]
    middles = np.kron(turn, np.eye(n))[:, [n // 2, n + n // 3]]
    K = sp.block_diag([string, string])
    return fr.System(mass=sp.identity(2 * n), stiffness=K, damping=0.05 * K, contacts={"one": ends, "two": middles})
