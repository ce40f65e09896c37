"""What contact points yield beyond the basis, compiled: `steppers.residual_motion`."""

from typing import Protocol

from numpy import ndarray as Array

from fenics_rom.compilation import jit_part, jit_sums
from fenics_rom.mechanics.compiled.copying import add_row, copy, fill
from fenics_rom.mechanics.compiled.work_space import release, take, taken


class Yielding(Protocol):
    """What P contact points do beyond the basis."""

    @property
    def R(self) -> Array:
        """Residual compliance (3P, 3P), m/N; (0, 0) where there is none."""

    @property
    def inertia(self) -> float:
        """2τ²/h, s, of what carries a force beyond the basis."""

    @property
    def whole(self) -> float:
        """a, s."""

    @property
    def lost(self) -> float:
        """β + (θ - ½) h, s."""

    @property
    def τ(self) -> float:
        """s."""


@jit_part
def set_yielding_of(R: Array, f: Array, rates: Array) -> None:
    """Sets R f (3P,)."""
    fill(rates, 0.0)
    for k in range(len(f)):
        if f[k] != 0.0:
            add_row(R[k], f[k], rates)


@jit_sums
def step_beyond(
    body: Yielding, h: float, beyond: Array, pull: Array, f: Array, rates: Array, space: Array
) -> tuple[float, float, float]:
    """Takes the step of what points do beyond the basis: what it loses, J, the power of f there, W, twice its energy.

    The rates (3P,) begin as R f, and become those of y in it. Of branches `pull`, as of `ask_points`, becomes
    those of g and y. Takes 3P numbers of the space, and gives them back.
    """
    g, y, g_rate, y_rate, begun = beyond[0], beyond[1], beyond[2], beyond[3], taken(space)
    forces, share, inertia = take(space, len(f)), 1 / body.whole, body.inertia
    lost = power = stored = 0.0
    for k in range(len(f)):  # one loop for each array: of one for all LLVM does not know that they are apart
        forces[k] = (inertia * g_rate[k] - g[k] + f[k]) * share
    for k in range(len(f)):
        rates[k] = (inertia * y_rate[k] - y[k] + rates[k]) * share
    if len(pull) > 0:
        add_row(pull[0], -share, forces)
        add_row(pull[1], -share, rates)
        copy(forces, pull[0])
        copy(rates, pull[1])
    for k in range(len(f)):
        g[k] += h * forces[k]
    for k in range(len(f)):
        y[k] += h * rates[k]
    for k in range(len(f)):
        g_rate[k] = 2 * forces[k] - g_rate[k]
    for k in range(len(f)):
        y_rate[k] = 2 * rates[k] - y_rate[k]
    for k in range(len(f)):
        lost += forces[k] * rates[k]
        power += f[k] * rates[k]
        stored += g[k] * y[k] + body.τ**2 * g_rate[k] * y_rate[k]
    release(space, begun)
    return h * body.lost * lost, power, stored
