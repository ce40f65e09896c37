"""Forces of joints within a step: those of contacts alone are unknown then, as `contact_step.Guide` has it.

W of joints is singular where these hold something twice. A pivoted factor tells how much of it is independent, and what
forces move nothing; forces have no part of these, as by a pseudo-inverse.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.mechanics.compiled.copying import add_row, copy, fill


class Factor(NamedTuple):
    """Of a matrix (n, n), nearly symmetric and nearly positive semidefinite, of some rank."""

    LU: Array  # (n, n) in the order of its pivots
    order: Array  # (n,)
    rank: int
    idle: Array  # (n - rank, n) orthonormal: what it makes nothing of


class Held(NamedTuple):
    """What joints make of C contacts."""

    factor: Factor  # of W of the joints
    spreadᵀ: Array  # (3C, 3J) forces of joints per force of contact, with the other sign
    contactsᵀ: Array  # (3C, 3C) W of the contacts where joints hold


@jit_part
def factor_of(matrix: Array, least: float) -> Factor:
    """Changes the matrix; least: pivot that counts, as a share of the largest."""
    n, rank, largest = len(matrix), 0, 0.0
    order = np.arange(n)
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if matrix[i, i] > matrix[pivot, pivot]:
                pivot = i
        largest = max(largest, matrix[pivot, pivot])
        if not matrix[pivot, pivot] > least * largest:
            break
        if pivot != k:
            order[k], order[pivot] = order[pivot], order[k]
            for j in range(n):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
            for i in range(n):
                matrix[i, k], matrix[i, pivot] = matrix[i, pivot], matrix[i, k]
        rank = k + 1
        row, whole = matrix[k], 1 / matrix[k, k]
        for i in range(k + 1, n):
            other, share = matrix[i], matrix[i, k] * whole
            other[k] = share
            for j in range(k + 1, n):
                other[j] -= share * row[j]
    idle = np.zeros((n - rank, n))
    for m in range(n - rank):
        of = idle[m]
        of[order[rank + m]] = 1.0
        for i in range(rank - 1, -1, -1):
            total = matrix[i, rank + m]
            for j in range(i + 1, rank):
                total += matrix[i, j] * of[order[j]]
            of[order[i]] = -total / matrix[i, i]
        for _ in range(2):  # once more, as round-off asks
            _leave_out(idle[:m], of)
        size = 1 / np.sqrt(of.dot(of))
        for j in range(n):
            of[j] *= size
    return Factor(matrix, order, rank, idle)


@jit_part
def _leave_out(idle: Array, x: Array) -> None:
    for m in range(len(idle)):
        share = 0.0
        for j in range(len(x)):
            share += idle[m, j] * x[j]
        add_row(idle[m], -share, x)


@jit_part
def solve_held(factor: Factor, b: Array, x: Array) -> None:
    """Sets x (n,) to what a matrix makes b (n,) of, as far as it can, with no part that it makes nothing of."""
    LU, order, rank = factor.LU, factor.order, factor.rank
    y = np.empty(rank)
    for i in range(rank):
        y[i] = b[order[i]]
        for j in range(i):
            y[i] -= LU[i, j] * y[j]
    fill(x, 0.0)
    for i in range(rank - 1, -1, -1):
        for j in range(i + 1, rank):
            y[i] -= LU[i, j] * y[j]
        y[i] /= LU[i, i]
        x[order[i]] = y[i]
    _leave_out(factor.idle, x)


@jit_part
def hold(Wᵀ: Array, C: int, least: float) -> Held:
    """What joints make of the first C of some pairs with the operator Wᵀ (3n, 3n); least: as of `factor_of`."""
    first, n = 3 * C, len(Wᵀ)
    own = np.empty((n - first, n - first))
    for i in range(n - first):
        for j in range(n - first):
            own[i, j] = Wᵀ[first + j, first + i]
    factor = factor_of(own, least)
    spreadᵀ, contactsᵀ = np.empty((first, n - first)), np.empty((first, first))
    for r in range(first):
        solve_held(factor, Wᵀ[r, first:], spreadᵀ[r])
        of, to = Wᵀ[r], contactsᵀ[r]
        for k in range(first):
            to[k] = of[k]
        for j in range(n - first):
            add_row(Wᵀ[first + j], -spreadᵀ[r, j], to)
    return Held(factor, spreadᵀ, contactsᵀ)


@jit_part
def without_contact(held: Held, Wᵀ: Array, u: Array, forces: Array) -> None:
    """Sets forces (J, 3) that hold joints where contacts have none, and adds what they move contacts by to u (n, 3).

    u: of all pairs without forces, m/s; of joints it stays.
    """
    C = len(held.spreadᵀ) // 3
    first, z = 3 * C, np.empty(3 * len(forces))
    moving, of_contacts = u.reshape(3 * len(u)), np.zeros(3 * C)
    solve_held(held.factor, moving[first:], z)
    for j in range(len(z)):
        add_row(Wᵀ[first + j], -z[j], of_contacts)
    for k in range(3 * C):
        moving[k] += of_contacts[k]
    for j in range(len(forces)):
        for k in range(3):
            forces[j, k] = -z[3 * j + k]


@jit_part
def join(held: Held, f: Array, without: Array, forces: Array) -> None:
    """Sets forces (J, 3) of joints under those of contacts (C, 3), from those without these (J, 3)."""
    copy(without, forces)
    numbers = forces.reshape(3 * len(forces))
    for c in range(len(f)):
        for k in range(3):
            if f[c, k] != 0.0:
                add_row(held.spreadᵀ[3 * c + k], -f[c, k], numbers)
