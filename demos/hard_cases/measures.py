"""What is measured of a hard case: energy accounts, and reduced runs against those at full order."""

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass

import numpy as np
from rows import Row

import fenics_rom as fr
from fenics_rom.fem.linear_stepper import FullOrderStepper

Array = np.ndarray

ROUND_OFF = 1e-12  # of the largest energy or work, to which accounts close
FULL_ORDER = 2e-9  # the same where stiffness spans so much that nodal velocities in double precision cannot balance


class Account:
    """Follows a simulator, reduced or at full order.

    Args:
        body: the simulator.

    Attributes:
        scale: largest energy, work or loss so far, J.
        gap: largest that the account missed so far, J.
        excess: most that was stored beyond what was supplied so far, J.
    """

    def __init__(self, body: fr.Simulator | FullOrderStepper):
        self._body, self._start = body, body.energy
        self.scale, self.gap, self.excess = self._start, 0.0, 0.0

    def look(self) -> None:
        """Reads the account."""
        stored, account = self._body.energy, self._body.ledger
        assert account is not None
        beyond = stored - self._start - account.supplied
        self.scale = max(self.scale, stored, abs(account.supplied), account.dissipated, abs(account.lost_in_switching))
        self.gap = max(self.gap, abs(beyond + account.dissipated + account.lost_in_switching))
        self.excess = max(self.excess, beyond)

    @property
    def relative_gap(self) -> float:
        """The gap as a share of the scale; 1 where that is not finite."""
        return _share(self.gap, self.scale)

    @property
    def relative_excess(self) -> float:
        """The excess as a share of the scale; 1 where that is not finite."""
        return _share(self.excess, self.scale)


def _share(part: float, whole: float) -> float:
    if not np.isfinite([part, whole]).all():
        return 1.0
    return part / whole if whole else 0.0


@dataclass(frozen=True)
class Runs:
    """A reduced run beside that at full order.

    Attributes:
        error: largest difference of the tip at any instant, as a share of its largest displacement.
        full_gap, reduced_gap: what the accounts missed, relative.
        tip: (steps, 3) of the full order, m.
    """

    error: float
    full_gap: float
    reduced_gap: float
    tip: Array


def both_runs(system: fr.System, rom: fr.Rom, push: Sequence[float], *, steps: int = 60, dt: float = 0.0) -> Runs:
    """Pushes in the first contact mode for half of the steps, and lets go.

    Args:
        system: the full order, with an output "tip".
        rom: its reduced model.
        push: N.
        steps: how many.
        dt: s; 0: a fortieth of the lowest natural period.
    """
    name, mode = next(iter(rom.contact_models.items()))
    dt = dt or 2 * np.pi / np.sqrt(mode.eigenvalues[rom.rigid]) / 40
    B, rest = system.input_matrix(name), np.zeros(len(push))
    with closing(FullOrderStepper(system, dt)) as full:
        reduced = fr.Simulator(rom, dt)
        accounts = Account(full), Account(reduced)
        tips = []
        for step in range(steps):
            u = np.array(push) if step < steps // 2 else rest
            full.step_under(B @ u)
            reduced.step(u)
            for account in accounts:
                account.look()
            tips.append((full.displacement("tip")[0], reduced.displacement("tip")[0]))
    tip, ours = np.array(tips).transpose(1, 0, 2)
    error = float(np.abs(ours - tip).max() / np.abs(tip).max())
    return Runs(error, accounts[0].relative_gap, accounts[1].relative_gap, tip)


def accounts(case: str, hard: str, runs: Runs, full: float = ROUND_OFF) -> Iterator[Row]:
    """That the accounts of both runs close.

    Args:
        case, hard: as in Row.
        runs: the runs.
        full: to what at full order, relative.
    """
    yield Row(case, hard, "gap of the energy account at full order", runs.full_gap, full)
    yield Row(case, hard, "gap of the energy account reduced", runs.reduced_gap, 5 * ROUND_OFF)


def at_rest(system: fr.System, contact: str, push: Sequence[float]) -> Array:
    """Where the tip comes to rest under a push (N), (3,) m."""
    with closing(system.algebra.factor((1.0, system.stiffness))) as factor:
        x = factor.solve(system.input_matrix(contact) @ np.array(push)[:, None])
    return system.algebra.inner(system.outputs["tip"], x)[:, 0]
