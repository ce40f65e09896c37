"""Loads that act on the moved body: pressures and tendons of a body that deforms largely."""

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.readings import swept_volume, swept_volume_slope
from fenics_rom.rom.deformation import (
    ReducedBar,
    ReducedDeformation,
    ReducedRim,
    ReducedTendon,
    monomial_slopes,
    monomials,
)
from fenics_rom.rom.rom import Rom

Acting = TypeVar("Acting")


class Pressure(NamedTuple):
    """Of 1 Pa on a surface; the same questions as to a ReducedTendon."""

    polynomial: Array  # (m, monomials), of its forces

    def force(self, q: Array) -> Array:
        """At q, (m,)."""
        force: Array = self.polynomial.dot(monomials(q))
        return force

    def slope(self, q: Array) -> Array:
        """∂force/∂q (m, m)."""
        slope: Array = self.polynomial @ monomial_slopes(q)
        return slope

    def stroke(self, q: Array) -> float:
        """By how much the volume behind it is more than at rest, m³."""
        return swept_volume(self.force, q)

    def stroke_slope(self, q: Array) -> Array:
        """∂stroke/∂q (m,): the force, as nearly as that has a potential."""
        return swept_volume_slope(self.force, self.slope, q)


Follower: TypeAlias = ReducedTendon | ReducedBar | Pressure  # what turns with the body: of 1 N or 1 Pa


def follower(body: ReducedDeformation, name: str) -> Follower:
    """That of a tendon, a bar or a pressure."""
    lines: dict[str, Follower] = {**body.tendons, **body.bars}
    return lines[name] if name in lines else Pressure(body.pressures[name])


class FollowingLoads(NamedTuple):
    """The inputs of a contact mode whose forces turn with what they act on, with their places."""

    followers: list[tuple[int, Follower]]
    rims: list[tuple[int, ReducedRim]]  # edges of pressures on open surfaces

    @staticmethod
    def of(rom: Rom, width: int, found: Sequence[tuple[int, Follower]] = ()) -> "FollowingLoads | None":
        """Those of a ROM with so many inputs, and what is found in steps; None where nothing follows.

        Args:
            rom: the reduced models.
            width: number p of inputs of the contact mode.
            found: loads that are found in steps, with their places counted from the first input that all contact modes
                share.
        """
        body, column = rom.deformation, width - sum(rom.actuators.values()) - sum(rom.loads.values())
        if body is None:
            return None
        followers, rims = [(column + place, each) for place, each in found], list[tuple[int, ReducedRim]]()
        for name, columns in rom.actuators.items():
            if name in body.pressures or name in body.tendons:
                followers.append((column, follower(body, name)))
            if name in body.rims:
                rims.append((column, body.rims[name]))
            column += columns
        return FollowingLoads(followers, rims) if followers else None

    @property
    def places(self) -> tuple[list[int], list[int]]:
        """Of the inputs of all followers, and of those with a rim."""
        return [column for column, _ in self.followers], [column for column, _ in self.rims]

    def force(self, u: Array, q: Array) -> Array:
        """Generalized forces (m,) under u (p,) on the body at q."""
        return _total(self.followers, u, np.zeros(len(q)), lambda each: each.force(q))

    def slope(self, u: Array, q: Array) -> Array:
        """∂force/∂q (m, m)."""
        return _total(self.followers, u, np.zeros((len(q), len(q))), lambda each: each.slope(q))

    def wrench(self, u: Array, q: Array, origin: Array) -> Array:
        """Force, N, and torque about an origin (3,), m, of pressures on open surfaces, (6,), in the frame's axes."""
        return _total(self.rims, u, np.zeros(6), lambda rim: rim.wrench(q, origin))

    def wrench_slopes(self, u: Array, q: Array, origin: Array) -> Array:
        """What `wrench` changes by with q, (6, m)."""
        return _total(self.rims, u, np.zeros((6, len(q))), lambda rim: rim.wrench_slopes(q, origin))


def _total(acting: list[tuple[int, Acting]], u: Array, total: Array, of_one: Callable[[Acting], Array]) -> Array:
    """Sum of what inputs u (p,) do, onto a total that is overwritten, by what inputs of 1 do."""
    for column, each in acting:
        if size := u.item(column):
            total += size * of_one(each)
    return total
