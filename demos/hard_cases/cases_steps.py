"""Step sizes over nine decades, spikes, and switches without end."""

from collections.abc import Iterator

import numpy as np
from boxes import box
from cases_contact import near
from measures import ROUND_OFF, Account
from rows import Row

import fenics_rom as fr
from fenics_rom.errors import StepError

CONTACTS = {"right": 'surface = "right"\nforce = "resultant"', "spot": near(0.2, 0.06), "root": near(0.1, 0.06)}
DECADES = (-8.0, 1.0)  # of the step, s
SPIKE = 1e9  # N


def rows(quick: bool) -> Iterator[Row]:
    """All of them; `quick`: fewer steps."""
    yield from rides(2_000 if quick else 50_000)
    yield from switches(20_000 if quick else 1_000_000)


def rides(steps: int) -> Iterator[Row]:
    """Steps of any size, spikes, and switches among them."""
    system = box((0.4, 0.1, 0.1), (6, 2, 2), contacts=CONTACTS)
    for order in (20, 100):
        rom = fr.reduce(system, order=order)
        kind = f"order {order}"
        yield from of(kind, f"{steps:,} steps of 1e-8 to 10 s", any_steps(rom, steps))
        yield from of(kind, f"{steps:,} steps of 1e-8 to 10 s, a switch each", any_steps(rom, steps, switch=True))
        yield from of(kind, f"{steps:,} steps, spikes of 1e9 N", spikes(rom, steps))
    free = box((0.4, 0.1, 0.1), (6, 2, 2), contacts=CONTACTS, damping="")
    rom = fr.reduce(free, order=20, method="modal+static")
    yield from of("no damping", f"{steps:,} steps of 1e-8 to 10 s, a switch each", any_steps(rom, steps, switch=True))
    yield from of("no damping", f"{steps:,} steps, spikes of 1e9 N", spikes(rom, steps))


def switches(steps: int) -> Iterator[Row]:
    """A switch at every step, one by one and in blocks."""
    rom = fr.reduce(box((0.4, 0.1, 0.1), (6, 2, 2), contacts=CONTACTS), order=8)
    yield from of("order 8", f"{steps:,} random switches, stepped", endless(rom, steps))
    yield from of("order 8", f"{steps:,} random switches, in rollouts", rolled_out(rom, steps))


def of(case: str, hard: str, account: Account) -> Iterator[Row]:
    """What an account must keep."""
    yield Row(case, hard, "stored beyond supplied, relative", account.relative_excess, ROUND_OFF)
    yield Row(case, hard, "gap of the energy account", account.relative_gap, ROUND_OFF)


def any_steps(rom: fr.Rom, steps: int, switch: bool = False) -> Account:
    """Another step size at every step, and random forces."""
    random, names = np.random.default_rng(1), list(rom.contact_models)
    body = fr.Simulator(rom, dt=1e-3)
    account = Account(body)
    for _ in range(steps):
        body.dt = float(10 ** random.uniform(*DECADES))
        if switch:
            body.switch(names[random.integers(len(names))])
        if not stepped(body, random.standard_normal(body.inputs), account):
            break
    return account


def spikes(rom: fr.Rom, steps: int) -> Account:
    """Nothing, but for a spike once in a while, and switches."""
    random, names = np.random.default_rng(2), list(rom.contact_models)
    body = fr.Simulator(rom, dt=1e-3)
    account = Account(body)
    for _ in range(steps):
        if random.random() < 0.1:
            body.switch(names[random.integers(len(names))])
        force = SPIKE * random.standard_normal(body.inputs) if random.random() < 0.01 else np.zeros(body.inputs)
        if not stepped(body, force, account):
            break
    return account


def endless(rom: fr.Rom, steps: int) -> Account:
    """A switch and a push at every step."""
    random, names = np.random.default_rng(3), list(rom.contact_models)
    body = fr.Simulator(rom, dt=1e-3)
    account = Account(body)
    pushes, choices = random.standard_normal((steps, body.inputs)), random.integers(len(names), size=steps)
    for push, choice in zip(pushes, choices.tolist(), strict=True):
        body.switch(names[choice])
        if not stepped(body, push, account):
            break
    return account


def rolled_out(rom: fr.Rom, steps: int) -> Account:
    """The same in one go of ten thousand after another."""
    random, names = np.random.default_rng(3), np.array(list(rom.contact_models), dtype=object)
    body = fr.Simulator(rom, dt=1e-3)
    account = Account(body)
    for _ in range(steps // 10_000):
        pushes = random.standard_normal((10_000, body.inputs))
        try:
            body.rollout(pushes, contact=names[random.integers(len(names), size=10_000)], outputs=[])
        except StepError:
            account.excess = account.gap = np.inf
            break
        account.look()
    return account


def stepped(body: fr.Simulator, push: np.ndarray, account: Account) -> bool:
    """Takes a step and looks at the account; what leaves the finite numbers breaks the law."""
    try:
        body.step(push)
    except StepError:
        account.excess = account.gap = np.inf
        return False
    account.look()
    return True
