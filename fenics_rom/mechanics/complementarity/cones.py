"""The projection onto the cones of Coulomb's law, of all pairs at once, in axes that last (see Frames).

P(z) = z_n⁺ n + z_t min(1, μ z_n⁺/|z_t|), which is taken apart by the normals where these differ from pair to pair.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.complementarity.solution import is_none

_ONES, _TINY = np.ones(3), np.array(1e-300)


class Projected(NamedTuple):
    """What is nearest to z in the cones."""

    forces: Array  # P(z) (3, C), N; z itself where it lies in all of them, so that all pairs stick
    length: Array  # |z_t| (C,), N
    cone: Array  # μ z_n⁺ (C,), N


def project(z: Array, normals: Array | None, μ: Array, zeros: Array) -> Projected:
    """Of z (3, C), N, with normals (3, C), None where all are the first of the axes; μ and 0 are given as (C,)."""
    if normals is None:
        pressure, across, length = z[0], z, np.hypot(z[1], z[2])
        cone = μ * pressure
        if is_none(length >= cone):
            return Projected(z, length, cone)
    else:
        pressure = _ONES.dot(z * normals)
        normal = pressure * normals
        across = z - normal
        length, cone = np.sqrt(_ONES.dot(across * across)), μ * pressure
    np.maximum(cone, zeros, out=cone)
    share = np.maximum(length, cone)
    share += _TINY
    np.divide(cone, share, share)
    forces = across * share
    if normals is None:
        np.maximum(pressure, zeros, out=forces[0])
        return Projected(forces, length, cone)
    if pressure.item(pressure.argmin()) < 0.0:
        normal = np.maximum(pressure, zeros) * normals
    forces += normal
    return Projected(forces, length, cone)
