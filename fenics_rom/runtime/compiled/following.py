"""Loads that act on the moved shape, compiled: `steppers.acts.following`."""

import math
from typing import NamedTuple

from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.runtime.compiled.small_matrices import dot
from fenics_rom.runtime.compiled.strain_tables import set_products


class Following(NamedTuple):
    """Pressures and tendons of a body with m modes, with the columns of their inputs."""

    pressures: Array  # columns (a,)
    polynomials: Array  # of their forces (a, m, n), of the products of (1, q), of squares the half
    tendons: Array  # columns of segments (s,)
    at_rest: Array  # segments (s, 3), m
    shapes: Array  # what they are with q, (s, 3, m)


@jit_part
def add_following(loads: Following, u: Array, q: Array, products: Array, force: Array) -> None:
    """Adds generalized forces (m,) of the inputs u (p,) on the body at q, whose products (n,) may be set."""
    if len(loads.pressures):
        set_products(1.0, q, products)
    for k in range(len(loads.pressures)):
        size, polynomial = u[loads.pressures[k]], loads.polynomials[k]
        if size != 0:
            for i in range(len(q)):
                force[i] += size * dot(polynomial[i], products)
    for s in range(len(loads.tendons)):
        size = u[loads.tendons[s]]
        if size != 0:
            shapes, at = loads.shapes[s], loads.at_rest[s]
            x, y, z = at[0] + dot(shapes[0], q), at[1] + dot(shapes[1], q), at[2] + dot(shapes[2], q)
            pull = size / math.sqrt(x * x + y * y + z * z)
            for i in range(len(q)):
                force[i] -= pull * (x * shapes[0, i] + y * shapes[1, i] + z * shapes[2, i])
