"""Contact modes: one to two hundred; apart, overlapping, nested, identical; of dependent columns, or one node."""

from collections.abc import Iterator

import numpy as np
import scipy.sparse as sp
from boxes import box
from measures import ROUND_OFF, Account
from rows import Row, said

import fenics_rom as fr
from fenics_rom.errors import SceneError, StepError
from fenics_rom.runtime.switching import Projections

LENGTHS, BRICKS = (0.4, 0.1, 0.1), (6, 2, 2)  # m
TOP = 0.1  # m
NONE_ADDED = 1e-13  # of the stored energy, that a switch may add: a norm of products of some 50 columns
PAIRS = 50  # of contact modes, between which the worst states are looked for


def rows(quick: bool) -> Iterator[Row]:
    """All of them; `quick`: fewer contact modes and steps."""
    yield from many(quick)
    yield from related(quick)
    yield clamped_edge()
    yield from odd_columns(quick)


def near(x: float, radius: float, force: str = "resultant") -> str:
    """The table of a contact mode on top of the box, around x (m)."""
    return f'near = {{ point = [{x!r}, 0.05, {TOP!r}], radius = {radius!r} }}\nforce = "{force}"'


def many(quick: bool) -> Iterator[Row]:
    """Contact modes side by side on top of a beam, switched at random."""
    for count in (1, 20) if quick else (1, 10, 50, 200):
        contacts = {f"spot{k}": near(x, 0.06) for k, x in enumerate(np.linspace(0.05, 0.38, count).tolist())}
        rom = fr.reduce(box(LENGTHS, BRICKS, contacts=contacts), order=8)
        yield from ride_rows(f"{count} contact modes", "number", rom, 1000 if quick else 20_000)


def related(quick: bool) -> Iterator[Row]:
    """Contact modes that have something in common."""
    whole = 'surface = "top"\nforce = "resultant"'
    kinds = {
        "apart": {"one": near(0.1, 0.05), "two": near(0.35, 0.05)},
        "overlapping": {"one": near(0.2, 0.1), "two": near(0.25, 0.1)},
        "nested": {"one": near(0.2, 0.05), "two": near(0.2, 0.12), "all": whole},
        "identical": {"one": near(0.2, 0.1), "two": near(0.2, 0.1)},
        "every node of the top, and one even push": {"one": 'surface = "top"\nforce = "nodal"', "two": whole},
        "reaching the clamped edge": {"one": near(0.0, 0.1), "two": near(0.35, 0.05)},
    }
    for case, contacts in kinds.items():
        rom = fr.reduce(box(LENGTHS, BRICKS, contacts=contacts), order=12)
        yield from ride_rows(case, "patches", rom, 1000 if quick else 20_000)
        if case == "identical":
            body, account = switching_ride(rom, 1000)
            lost = abs(body.ledger.lost_in_switching) / account.scale
            yield Row(case, "patches", "lost in switching, relative", lost, ROUND_OFF)


def clamped_edge() -> Row:
    """A contact mode whose whole surface is held is refused."""
    contacts = {"held": 'surface = "left"\nforce = "resultant"'}
    try:
        box(LENGTHS, BRICKS, contacts=contacts)
        error = ""
    except SceneError as refused:
        error = str(refused)
    return said("on the clamped face", "cannot move", error, "contacts.held", "whole patch is clamped")


def odd_columns(quick: bool) -> Iterator[Row]:
    """One node, columns that depend on each other or differ by 1e16, all of a body's nodes."""
    n = 60
    chain = sp.diags([-np.ones(n - 1), 2 * np.ones(n), -np.ones(n - 1)], [-1, 0, 1])
    unit, even = np.eye(n), np.ones((n, 1)) / n
    kinds = {
        "one node": unit[:, [30]],
        "dependent columns": np.hstack([unit[:, :2], unit[:, :1] + unit[:, 1:2], 2 * unit[:, :1]]),
        "columns that differ by 1e-13": np.hstack([even, even + 1e-13 * unit[:, :1]]),
        "columns of 1e-8 and 1e8": np.hstack([1e-8 * unit[:, :1], 1e8 * unit[:, [40]]]),
        "a column of zeros beside one": np.hstack([np.zeros((n, 1)), even]),
        "a column for each node": unit,
    }
    for case, columns in kinds.items():
        contacts = {"one": columns, "two": unit[:, [-1]]}
        system = fr.System(
            mass=sp.identity(n), stiffness=chain, damping=0.01 * chain + 0.01 * sp.identity(n), contacts=contacts
        )
        yield from ride_rows(case, "columns", fr.reduce(system, order=20), 1000 if quick else 20_000)


def switching_ride(rom: fr.Rom, steps: int) -> tuple[fr.Simulator, Account]:
    """A random push at every step, in a random contact mode."""
    random, names = np.random.default_rng(0), list(rom.contact_models)
    body = fr.Simulator(rom, dt=1e-2)
    account = Account(body)
    for _ in range(steps):
        body.switch(names[random.integers(len(names))])
        try:
            body.step(random.standard_normal(body.inputs))
        except StepError:
            account.excess = np.inf
            break
        account.look()
    return body, account


def most_added(rom: fr.Rom) -> float:
    """Most that a switch adds to the stored energy, as a share of it, from the states that its maps stretch most."""
    body, projections, names = fr.Simulator(rom, dt=1e-2), Projections(rom), list(rom.contact_models)
    pairs = [(one, other) for one in names for other in names if one != other]
    worst = -1.0
    for k in np.random.default_rng(0).permutation(len(pairs))[:PAIRS]:
        start, end = pairs[k]
        maps = projections.between(start, end)
        e, r = (np.linalg.svd(one_map)[2][0] for one_map in maps)
        for share in (0.0, 1.0):  # of elastic energy
            body.switch(start)
            body.state = share * e / body.rom.contact_models[start].safe_frequencies, (1 - share) * r
            before = body.energy
            body.switch(end)
            worst = max(worst, body.energy / before - 1)
    return worst


def ride_rows(case: str, hard: str, rom: fr.Rom, steps: int) -> Iterator[Row]:
    """What a ride through the contact modes of a ROM must keep."""
    _, account = switching_ride(rom, steps)
    yield Row(case, hard, f"{steps:,} switches: stored beyond supplied", account.relative_excess, ROUND_OFF)
    yield Row(case, hard, "gap of the energy account", account.relative_gap, ROUND_OFF)
    if len(rom.contact_models) > 1:
        yield Row(case, hard, "most that a switch can add, of the stored energy", most_added(rom), NONE_ADDED)
