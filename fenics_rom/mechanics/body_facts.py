"""What a body is in plain numbers, and which of them look like a mistake of units."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy import ndarray as Array

LONGEST = 10.0  # m
LIGHTEST = 1e-6  # kg
PLAUSIBLE_YOUNG = (100.0, 2e12)  # Pa, from the softest gels to diamond
NEAR_FLAT = 1e-2  # radius ratio below which a cell counts as near-flat


@dataclass(frozen=True)
class CellQuality:
    """How good tetrahedra are, by their radius ratio 3 r/R of inscribed and circumscribed sphere: 1 regular, 0 flat.

    Cavendish, Field & Frey (1985); the same is Gmsh's gamma. (Compared with others by Parthasarathy et al., 1994.)

    Attributes:
        count: number of cells.
        near_flat: how many of them have a ratio below `NEAR_FLAT`.
        least, mean: of their ratios.
    """

    count: int
    near_flat: int
    least: float
    mean: float

    @property
    def array(self) -> Array:
        """As files hold it, (4,)."""
        return np.array([self.count, self.near_flat, self.least, self.mean])

    @classmethod
    def from_array(cls, array: Array | None) -> "CellQuality | None":
        """Of what a file holds, if it does."""
        return None if array is None else cls(int(array[0]), int(array[1]), float(array[2]), float(array[3]))

    def __str__(self) -> str:
        flat = f", {self.near_flat} of them near-flat (below {NEAR_FLAT:g})" if self.near_flat else ""
        return f"{self.count}{flat}; radius ratio 3 r/R from {self.least:.2g}, mean {self.mean:.2g}"


def quality_of(ratios: Array) -> CellQuality:
    """The summary of radius ratios (C,)."""
    return CellQuality(len(ratios), int((ratios < NEAR_FLAT).sum()), float(ratios.min()), float(ratios.mean()))


def body_lines(
    nodes: Array, node_mass: Array, frequency: float | None = None, cells: CellQuality | None = None
) -> dict[str, str]:
    """Size, mass, first frequency and cells of a body of nodes (N, 3), m, with masses (N,), kg; none without nodes."""
    if not len(nodes):
        return {}
    size = " x ".join(f"{length:.4g}" for length in np.ptp(nodes, axis=0))
    oscillates = "" if frequency is None else f", first frequency {frequency:.4g} Hz"
    lines = {"body": f"{size} m, {node_mass.sum():.4g} kg{oscillates}"}
    return lines if cells is None else lines | {"cells": str(cells)}


def implausible(nodes: Array, mass: float, young: Mapping[str, float]) -> Iterator[str]:
    """What looks like a mistake of units.

    Args:
        nodes: (N, 3), m.
        mass: of the body, kg.
        young: Young's modulus of each material by where the scene says it, Pa.
    """
    longest = float(np.ptp(nodes, axis=0).max())
    if longest > LONGEST:
        yield (
            f"the body is {longest:.4g} m long: coordinates are in metres; of a mesh in millimetres mesh.scale = 1e-3 "
            "is the cure"
        )
    if mass < LIGHTEST:
        yield (
            f"the body weighs {mass:.3g} kg, less than {LIGHTEST:g} kg: densities are in kg/m3 and lengths in metres "
            "(mesh.scale multiplies those of the mesh)"
        )
    low, high = PLAUSIBLE_YOUNG
    for where, E in young.items():
        if not low <= E <= high:
            yield (
                f"{where}.young = {E:g} Pa: from the softest gels to diamond it is {low:g} to {high:g} Pa; silicones "
                "have 1e4 to 1e7 Pa, and 1 MPa is 1e6"
            )
