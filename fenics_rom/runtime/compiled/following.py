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


@jit_part
def add_following_slope(loads: Following, u: Array, q: Array, size: float, slope: Array) -> None:
    """Adds, so many times, what these forces change by with q (m, m)."""
    for k in range(len(loads.pressures)):
        if u[loads.pressures[k]] != 0:
            add_pressed_slope(loads.polynomials[k], q, size * u[loads.pressures[k]], slope)
    for s in range(len(loads.tendons)):
        if u[loads.tendons[s]] != 0:
            add_pulled_slope(loads.at_rest[s], loads.shapes[s], q, size * u[loads.tendons[s]], slope)


@jit_part
def add_pressed_slope(polynomial: Array, q: Array, size: float, slope: Array) -> None:
    """Adds that of a pressure of 1 Pa."""
    m = len(q)
    for n in range(m):
        row, into, at = polynomial[n], slope[n], m + 1
        for i in range(m):
            into[i] += size * (row[1 + i] + row[at] * q[i])
            for j in range(i + 1, m):
                into[i] += size * row[at + j - i] * q[j]
                into[j] += size * row[at + j - i] * q[i]
            at += m - i


@jit_part
def add_pulled_slope(at_rest: Array, shapes: Array, q: Array, size: float, slope: Array) -> None:
    """Adds that of a segment of a cable under 1 N."""
    x, y, z = at_rest[0] + dot(shapes[0], q), at_rest[1] + dot(shapes[1], q), at_rest[2] + dot(shapes[2], q)
    length = math.sqrt(x * x + y * y + z * z)
    x, y, z, size = x / length, y / length, z / length, size / length
    for i in range(len(q)):
        along = x * shapes[0, i] + y * shapes[1, i] + z * shapes[2, i]
        a, b, c = shapes[0, i] - along * x, shapes[1, i] - along * y, shapes[2, i] - along * z
        for j in range(len(q)):
            slope[i, j] -= size * (a * shapes[0, j] + b * shapes[1, j] + c * shapes[2, j])
