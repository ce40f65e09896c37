"""Subspaces in which the Gramians are computed exactly: all eigenvectors, or a block Krylov space."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from fenics_rom.system import Array, Factor, System

GROWTH = 1.15  # of a Krylov space between two looks at it
DEFLATION = 1e-10  # share of a unit column that must be new for it to count as a direction


@dataclass(frozen=True)
class Subspace:
    """An M-orthonormal basis that diagonalizes K.

    Attributes:
        basis: X (rows here, k), XᵀMX = I, XᵀKX = diag(γ), kg^-1/2.
        eigenvalues: γ (k,), 1/s².
        damping: XᵀDX, its diagonal (k,) where D is proportional, else (k, k), 1/s.
    """

    basis: Array
    eigenvalues: Array
    damping: Array


def damping_in(system: System, basis: Array, γ: Array) -> Array:
    """XᵀDX in a basis that diagonalizes M and K: (k,) for proportional damping, else (k, k)."""
    if system.rayleigh is not None:
        α, β = system.rayleigh
        return α + β * γ
    D = system.algebra.inner(basis, system.damping @ basis)
    return (D + D.T) / 2


def all_eigenvectors(system: System) -> Subspace:
    """The whole space, for models small enough to be dense."""
    γ, V = system.algebra.eigenpairs(system.mass, system.stiffness, system.size)
    return Subspace(V, γ, damping_in(system, V, γ))


def krylov_spaces(system: System, factor: Factor, start: Array) -> Iterator[Subspace]:
    """Growing block Krylov spaces of K⁻¹M from K⁻¹ start: moments of the transfer function at s = 0.

    One factor of K serves all blocks. Directions that add nothing are left out. A space is worth looking at when it
    has grown by a share; the last one is that which cannot grow any more.

    Args:
        system: the full-order model.
        factor: of K.
        start: (rows here, p) input (and output) columns.
    """
    basis = np.empty((len(start), 0))
    block = factor.solve(start)
    seen = 0
    while True:
        new = orthonormal_rest(system, block, basis)
        basis = np.hstack([basis, new])
        complete = new.shape[1] == 0 or basis.shape[1] == system.size
        if complete or basis.shape[1] >= GROWTH * seen:
            seen = basis.shape[1]
            yield diagonalized(system, basis)
        if complete:
            return
        block = factor.solve(system.mass @ new)


def diagonalized(system: System, basis: Array) -> Subspace:
    """The same space in the basis that diagonalizes K (simultaneously with M, paper (10)-(11))."""
    K = system.algebra.inner(basis, system.stiffness @ basis)
    γ, rotation = np.linalg.eigh((K + K.T) / 2)
    basis = basis @ rotation
    return Subspace(basis, γ, damping_in(system, basis, γ))


def orthonormal_rest(system: System, block: Array, basis: Array) -> Array:
    """M-orthonormal basis of what a block adds to an M-orthonormal basis, (rows here, new).

    Gram matrices square the spectrum, so each pass takes only directions within four decades of the largest;
    what is left is tried again until it is below DEFLATION of the unit columns it came from.
    """
    inner, M = system.algebra.inner, system.mass
    old = basis.shape[1]
    norms = np.sqrt(np.diag(inner(block, M @ block)))
    block = block[:, norms > 0] / norms[norms > 0]
    while block.shape[1]:
        for _ in range(2):
            block = block - basis @ inner(basis, M @ block)
        w, E = np.linalg.eigh(inner(block, M @ block))
        take = w > max(1e-8 * w[-1], DEFLATION**2)
        if not take.any():
            break
        new = block @ (E[:, take] / np.sqrt(w[take]))
        for _ in range(2):  # division by a small norm magnified what was left of the old directions
            new = new - basis @ inner(basis, M @ new)
            new = scipy.linalg.solve_triangular(np.linalg.cholesky(inner(new, M @ new)), new.T, lower=True).T
        basis = np.hstack([basis, new])
        if take.all():
            break
    return basis[:, old:]
