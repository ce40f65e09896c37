"""One M-orthonormal basis for all contact modes: W_i = X C_i, so that what is tall is kept and worked on once."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy import ndarray as Array

from fenics_rom.system.system import System

DEFLATION_TOLERANCE = 1e-10  # share of a unit column that must be new for it to count as a direction
GRAM_ROUND_OFF = 1e-14  # share of the largest eigenvalue of a Gram matrix below which it is noise
GRAM_SPREAD = 1e-8  # smallest eigenvalue of a Gram matrix, as a share of the largest, whose direction is accurate
RESERVED = 256  # columns that a basis has addresses for; they take memory as they are written


@dataclass(frozen=True)
class Subspace:
    """A part of the shared space, in the basis of it that diagonalizes M and K."""

    coordinates: Array  # S (k, r) in the shared basis, SᵀS = I
    eigenvalues: Array  # γ (r,), diagonal of SᵀXᵀKXS, 1/s²
    damping: Array  # SᵀXᵀDXS, its diagonal (r,) where D is proportional, else (r, r), 1/s


class CommonBasis:
    """A growing basis X (rows here, k), XᵀMX = I, RᵀMX = 0, and what K and D are in it.

    Attributes:
        stiffness: XᵀKX (k, k), 1/s².
        damping: XᵀDX (k, k), 1/s; None where D is proportional.
        eigenvectors: how many of the first columns are generalized eigenvectors.
    """

    def __init__(self, system: System):
        self._system = system
        self._rigid, self._size = system.rigid.shape[1], 0
        capacity = self._rigid + min(RESERVED, system.size)
        self._transposed = np.empty((capacity, system.local_size))  # a column of R, X is a row: cheap to append
        self._transposed[: self._rigid] = system.rigid.T
        self.stiffness = np.empty((0, 0))
        self.damping = None if system.rayleigh is not None else np.empty((0, 0))
        self.eigenvectors = 0

    @property
    def size(self) -> int:
        """Number k of basis vectors."""
        return self._size

    @property
    def basis(self) -> Array:
        """X (rows here, k), kg^-1/2."""
        return self._transposed[self._rigid : self._rigid + self._size].T

    def add(self, block: Array) -> Array:
        """Coordinates of columns, (k, columns); what they add to the basis is appended to it."""
        # with R, as what a small new direction magnifies must not be a motion that no method asked for
        whole = self._transposed[: self._rigid + self._size].T
        new, coordinates = orthonormalize_against(self._system, block, whole)
        self.append(new)
        return coordinates[self._rigid :]

    def append(self, new: Array) -> None:
        """Further M-orthonormal columns, orthogonal to the basis."""
        begin, end = self._rigid + self._size, self._rigid + self._size + new.shape[1]
        if end > len(self._transposed):
            grown = np.empty((end + end // 4, self._transposed.shape[1]))
            grown[:begin] = self._transposed[:begin]
            self._transposed = grown
        self._transposed[begin:end] = new.T
        self._size += new.shape[1]
        self.stiffness = self._extended(self.stiffness, self._system.stiffness @ new)
        if self.damping is not None:
            self.damping = self._extended(self.damping, self._system.damping @ new)

    def _extended(self, projected: Array, product: Array) -> Array:
        """XᵀAX with the rows and columns of the new vectors, whose A-product is given."""
        old = len(projected)
        columns = self._system.algebra.inner(self.basis, product)
        matrix = np.empty((self._size, self._size))
        matrix[:old, :old] = projected
        matrix[:, old:] = columns
        matrix[old:, :old] = columns[:old].T
        matrix[old:, old:] = (columns[old:] + columns[old:].T) / 2
        return matrix

    def subspace(self, span: Array, units: int = 0) -> Subspace:
        """The subspace that orthonormal coordinates (at most k, r) span, K-diagonal (paper (10)-(11)).

        Products with its first columns cost nothing where they are the first unit vectors, so many `units`.
        """
        S = pad_rows(span, self._size)
        K = S.T @ np.hstack([self.stiffness[:, :units], self.stiffness @ S[:, units:]])
        γ, rotation = np.linalg.eigh((K + K.T) / 2)
        S = S @ rotation
        return Subspace(S, γ, self.damping_in(S, γ))

    def damping_in(self, S: Array, γ: Array) -> Array:
        """SᵀXᵀDXS where S diagonalizes K: (r,) for proportional damping, else (r, r)."""
        if self._system.rayleigh is not None:
            α, β = self._system.rayleigh
            return α + β * γ
        D = S.T @ self.damping @ S
        return (D + D.T) / 2


def pad_rows(coordinates: Array, size: int) -> Array:
    """Coordinates (any, r) in a basis that has grown to a size since, (size, r)."""
    return np.pad(coordinates, ((0, size - len(coordinates)), (0, 0)))


def orthonormalize_against(system: System, block: Array, basis: Array) -> tuple[Array, Array]:
    """What a block (rows here, c) adds to an M-orthonormal basis (rows here, k), M times which would be as large.

    Gram matrices square the spectrum, so each pass takes only directions within four decades of the largest, of columns
    scaled alike; what is left is tried again until it is below DEFLATION_TOLERANCE of the column that it came from.

    Returns:
        M-orthonormal columns (rows here, new), and the coordinates of the block, (k + new, c).
    """
    inner, M = system.algebra.inner, system.mass
    remainder, coordinates = block, np.zeros((basis.shape[1], block.shape[1]))
    for _ in range(2):
        projections = inner(basis, M @ remainder)
        coordinates += projections
        remainder = remainder - basis @ projections
    M_remainder = M @ remainder
    gram = inner(remainder, M_remainder)
    smallest = DEFLATION_TOLERANCE**2 * (np.sum(coordinates**2, axis=0) + np.diag(gram))
    new, M_new, candidates = remainder[:, :0], remainder[:, :0], remainder
    while True:
        large = np.diag(gram) > smallest
        if not large.any():
            break
        candidates, gram, smallest = candidates[:, large], gram[large][:, large], smallest[large]
        sizes = np.sqrt(np.diag(gram))
        w, E = np.linalg.eigh(gram / sizes[:, None] / sizes)
        accurate = w > GRAM_SPREAD * w[-1]
        Y = candidates @ (E[:, accurate] / sizes[:, None] / np.sqrt(w[accurate]))
        Y = Y - basis @ inner(basis, M @ Y)  # division by a small norm magnified what was left of the old
        Y = Y - new @ inner(M_new, Y)
        MY = M @ Y
        triangle = np.linalg.cholesky(inner(Y, MY))
        Y, MY = (scipy.linalg.solve_triangular(triangle, columns.T, lower=True).T for columns in (Y, MY))
        new, M_new = np.hstack([new, Y]), np.hstack([M_new, MY])
        if accurate.all():
            break
        for _ in range(2):
            candidates = candidates - new @ inner(M_new, candidates)
        gram = inner(candidates, M @ candidates)
    return new, np.vstack([coordinates, inner(new, M_remainder)])


def orthogonal_complement(block: Array, span: Array) -> Array:
    """Orthonormal basis of what a block of coordinates (k, any) adds to orthonormal columns, (k, new)."""
    norms = np.linalg.norm(block, axis=0)
    block = block[:, norms > 0] / norms[norms > 0]
    for _ in range(2):
        block = block - span @ (span.T @ block)
    U, s, _ = np.linalg.svd(block, full_matrices=False)
    new = U[:, s > DEFLATION_TOLERANCE]
    new = new - span @ (span.T @ new)
    return np.linalg.qr(new)[0]


def significant_eigenpairs(gram: Array, floor: float | None = None) -> tuple[Array, Array]:
    """Eigenvalues w (r,) above a floor, by default the round-off, descending, and their eigenvectors E (c, r).

    Of G = XᵀMX the left singular vectors of X in the norm of M are X E / √w, and √w the singular values: proper
    orthogonal decomposition in any inner product (Sirovich 1987).
    """
    w, E = np.linalg.eigh(gram)
    significant = w > (GRAM_ROUND_OFF * w[-1] if floor is None else floor)
    return w[significant][::-1], E[:, significant][:, ::-1]


def block_starts(blocks: Iterable[Array]) -> Array:
    """Index of the first column of each of some blocks side by side, and the number of all columns at the end."""
    return np.cumsum([0, *(block.shape[1] for block in blocks)])


def split_like(columns: Array, blocks: Iterable[Array]) -> list[Array]:
    """Columns in parts as wide as the blocks."""
    return np.split(columns, block_starts(blocks)[1:-1], axis=1)
