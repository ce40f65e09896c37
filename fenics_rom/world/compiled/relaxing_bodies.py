"""Branches of the material of a held soft body of small strains, in a step of `soft_bodies`.

They pull beside its coordinates, and beside what its points do beyond the basis, as in `runtime.compiled.linear_step`.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.compiled_arrays import flat
from fenics_rom.mechanics.compiled.copying import copy, fill
from fenics_rom.runtime.compiled.arrays_at import cube_at, matrix_at
from fenics_rom.runtime.compiled.branches import (
    add_pull,
    add_row_of_pull,
    set_force,
    set_forces,
    step_branches,
    stored_in,
)
from fenics_rom.runtime.compiled.contact_points import WHOLE, Points, end_points
from fenics_rom.runtime.compiled.touching import FORGOTTEN


class Relaxed(NamedTuple):
    """N branches, as in `linear_step.Body` and `linear_step.State`."""

    numbers: Array  # (8, N)
    share: Array  # (m, m) or (0, 0)
    rows: Array  # (N, 2, m)
    rows_before: Array
    beyond: Array  # (N, 2, 3P)
    beyond_before: Array


@jit_part
def relaxed_in(t: Array) -> Relaxed:
    """What six rows have of it."""
    numbers, share, rows, before = matrix_at(t[0]), matrix_at(t[1]), cube_at(t[2]), cube_at(t[3])
    return Relaxed(numbers, share, rows, before, cube_at(t[4]), cube_at(t[5]))


@jit_part
def draw_back(relaxed: Relaxed, inverse: Array, ω: Array, rate: Array) -> None:
    """Adds to r̂ (m,) what the branches do to it, by A⁻¹ (m, m)."""
    pull = np.zeros(len(ω))
    set_forces(relaxed.share, relaxed.rows)
    add_pull(relaxed.numbers, relaxed.rows, pull)
    pull *= ω
    rate -= np.dot(inverse, pull)


@jit_part
def draw_points_back(relaxed: Relaxed, points: Points) -> None:
    """Adds to the free velocities of points what branches do to them beyond the basis."""
    if len(points.R):
        pull = np.zeros(points.free.size)
        add_row_of_pull(relaxed.numbers, relaxed.beyond, 1, pull)
        free = flat(points.free)
        for k in range(len(free)):
            free[k] -= pull[k] / points.times[WHOLE]


@jit_part
def relax(relaxed: Relaxed, ω: Array, r̂: Array) -> tuple[float, float]:
    """Takes the step of branches within the basis: what it dissipates, J, and twice the energy stored there."""
    copy(relaxed.rows, relaxed.rows_before)
    rate, stress = ω * r̂, np.empty(len(ω))
    set_force(relaxed.share, rate, stress)
    heat = step_branches(relaxed.numbers, relaxed.rows, rate, stress)
    return heat, 2 * stored_in(relaxed.numbers, relaxed.rows)


@jit_part
def relax_points(relaxed: Relaxed, points: Points, h: float) -> tuple[float, float]:
    """As `end_points`, with branches."""
    pull = np.zeros((2 if len(points.R) else 0, points.free.size))
    copy(relaxed.beyond, relaxed.beyond_before)
    for row in range(len(pull)):
        add_row_of_pull(relaxed.numbers, relaxed.beyond, row, pull[row])
    lost, stored = end_points(points, h, pull)
    if len(pull):
        lost += step_branches(relaxed.numbers, relaxed.beyond, pull[0], pull[1])
        stored += 2 * stored_in(relaxed.numbers, relaxed.beyond)
        if not points.pushed.any() and stored < 2 * FORGOTTEN:
            fill(points.beyond, 0.0)
            fill(relaxed.beyond, 0.0)
            return lost, 0.0
    return lost, stored
