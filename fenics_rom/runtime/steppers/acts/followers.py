"""What turns with a body that deforms largely: tendons under 1 N and surfaces under 1 Pa, and their strokes."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from numpy import ndarray as Array

from fenics_rom.mechanics.readings import swept_volume, swept_volume_slope
from fenics_rom.rom.deformation import ReducedDeformation, ReducedTendon, monomial_slopes, monomials, monomials_back
from fenics_rom.rom.rom import Rom


class Follower(NamedTuple):
    """What turns with the body."""

    force: Callable[[Array], Array]  # of 1 N or 1 Pa at q, (m,)
    stroke: Callable[[Array], float]  # at q, m or m³
    pull_back: Callable[[Array, Array], Array]  # what w·force owes to q, (m,), of q and w
    slope: Callable[[Array], Array]  # ∂force/∂q, (m, m)
    stroke_slope: Callable[[Array], Array]  # ∂stroke/∂q, (m,): the force, where that has a potential to the last bit


def follower_loads(rom: Rom) -> list[tuple[int, Follower]]:
    """The inputs whose forces turn with the body: columns, counted from behind the contact's."""
    assert rom.deformation is not None
    loads: list[tuple[int, Follower]] = []
    column = 0
    for name, columns in rom.actuators.items():
        if name in rom.deformation.pressures or name in rom.deformation.tendons:
            loads.append((column, follower(rom.deformation, name)))
        column += columns
    return loads


def follower_of_tendon(tendon: ReducedTendon) -> Follower:
    """That of a cable."""
    return Follower(tendon.force, tendon.stroke, tendon.pull_back, tendon.slope, tendon.force)


def follower(body: ReducedDeformation, name: str) -> Follower:
    """That of a tendon or a pressure."""
    if name in body.tendons:
        return follower_of_tendon(body.tendons[name])
    polynomial = body.pressures[name]

    def force(q: Array) -> Array:
        at_one: Array = polynomial.dot(monomials(q))
        return at_one

    def pull_back(q: Array, w: Array) -> Array:
        return monomials_back(q, w @ polynomial)

    def slope(q: Array) -> Array:
        slopes: Array = polynomial @ monomial_slopes(q)
        return slopes

    def stroke_slope(q: Array) -> Array:
        return swept_volume_slope(force, slope, q)

    return Follower(force, partial(swept_volume, force), pull_back, slope, stroke_slope)
