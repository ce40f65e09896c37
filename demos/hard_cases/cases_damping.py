"""No damping, much damping, and damping in one place; energies of runs so long that round-off could add up."""

from collections.abc import Iterator
from contextlib import closing

import numpy as np
from boxes import box
from measures import accounts, both_runs
from rows import Row, said

import fenics_rom as fr
from fenics_rom.errors import SolverError, StepError
from fenics_rom.fem.linear_stepper import FullOrderStepper
from fenics_rom.runtime.steppers.midpoint import LARGEST_FUSED_ORDER

BEAM = (0.4, 0.1, 0.1)  # m
PUSH = (0.0, 0.0, 0.1)  # N
KEPT = 1e-9  # share of its energy that an undamped run may gain or lose


def rows(quick: bool) -> Iterator[Row]:
    """All of them; `quick`: short runs."""
    yield from damped()
    yield from undamped(quick)


def damped() -> Iterator[Row]:
    """Reduced against full order under each kind of damping."""
    dashpot = '[effects.damping]\nalpha = 0.0\nbeta = 0.0\n[effects.damping.dashpots.pot]\nsurface = "right"\n'
    kinds = {
        "α only": ("alpha = 2.0, beta = 0.0", ""),
        "β only": ("alpha = 0.0, beta = 1e-3", ""),
        "next to none": ("alpha = 1e-6, beta = 0.0", ""),
        "overdamped by α": ("alpha = 1e5, beta = 0.0", ""),
        "overdamped by β": ("alpha = 0.0, beta = 1e2", ""),
        "critical at one frequency": ("alpha = 0.0, beta = 0.05", ""),
        "one dashpot, weak": ("", dashpot + "coefficient = 1e-2"),
        "one dashpot, strong": ("", dashpot + "coefficient = 1e6"),
    }
    for case, (damping, effects) in kinds.items():
        system = box(BEAM, (4, 1, 1), damping=damping, effects=effects)
        rom = fr.reduce(system, order=40)
        runs = both_runs(system, rom, PUSH, steps=200)
        yield Row(case, "damping", "order 40 against full order: error of the run", runs.error, 1e-3)
        yield from accounts(case, "damping", runs)


def undamped(quick: bool) -> Iterator[Row]:
    """Balancing refuses; runs of lowest modes, stepped and in rollouts, and of the full order keep their energy."""
    system = box(BEAM, (6, 2, 2), damping="")
    try:
        fr.reduce(system, order=20)
        error = ""
    except SolverError as refused:
        error = str(refused)
    yield said("no damping", "no Gramians", error, "damping", "modal")
    steps = 10_000 if quick else 1_000_000
    orders = {"in one product": 20, "velocity first": LARGEST_FUSED_ORDER[1] + 15}
    for form, order in orders.items():
        rom = fr.reduce(system, order=order, method="modal")
        transfer_error = rom.contact_models["right"].transfer_errors.max()
        yield Row(f"no damping, order {order}", "infinite resonances", "validated transfer error", transfer_error, 1.0)
        ride = kept_by_steps(fr.Simulator(rom, dt=1e-3), steps)
        yield Row(f"no damping, order {order}", f"{steps:,} steps {form}", "energy gained or lost", ride, KEPT)
        rollout = kept_by_rollout(fr.Simulator(rom, dt=1e-3), steps)
        yield Row(f"no damping, order {order}", f"{steps:,} steps in rollouts", "energy gained or lost", rollout, KEPT)
    count = 500 if quick else 10_000
    kept = kept_at_full_order(system, count)
    yield Row("no damping, full order", f"{count:,} steps", "energy gained or lost", kept, KEPT)


def pluck(body: fr.Simulator) -> float:
    """Puts a body into a shape with all its modes in it, and gives its energy, J."""
    m = len(body.state[0])
    ω = np.sqrt(body.rom.contact_models[body.contact].eigenvalues)
    body.state = np.random.default_rng(0).standard_normal(m) / ω, np.zeros(m)
    return body.energy


def kept_by_steps(body: fr.Simulator, steps: int) -> float:
    """Largest change of energy in a free run, as a share of it; 1 where it leaves the finite numbers."""
    start, u, change = pluck(body), np.zeros(body.inputs), 0.0
    for step in range(steps):
        try:
            body.step(u)
        except StepError:
            return 1.0
        if step % 1000 == 999:
            change = max(change, abs(body.energy - start))
    return change / start


def kept_by_rollout(body: fr.Simulator, steps: int) -> float:
    """As kept_by_steps, in blocks."""
    start, u, change = pluck(body), np.zeros((10_000, body.inputs)), 0.0
    for _ in range(steps // len(u)):
        try:
            body.rollout(u, outputs=[])
        except StepError:
            return 1.0
        change = max(change, abs(body.energy - start))
    return change / start


def kept_at_full_order(system: fr.System, steps: int) -> float:
    """As kept_by_steps, of a beam that was pushed for ten steps."""
    B = system.input_matrix("right")
    with closing(FullOrderStepper(system, 1e-3)) as body:
        for _ in range(10):
            body.step_under(B @ np.array(PUSH))
        start, change = body.energy, 0.0
        for _ in range(steps):
            body.step_under(B @ np.zeros(3))
            change = max(change, abs(body.energy - start))
    return change / start
