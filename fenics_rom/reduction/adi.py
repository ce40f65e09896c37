"""The controllability Gramian by alternating directions (LR-ADI): low-rank, second-order, in real arithmetic.

For E ż = A z + F u with z = (x, v), E = diag(I, M), A = [0 I; -K -D] and F = (0, B), the Gramian P of
A P Eᵀ + E P Aᵀ + F Fᵀ = 0 is built column by column. What is left of the equation after each step is W Wᵀ, with W of
as many columns as B.

Sources: Benner, Kürschner & Saak 2013 (10.1007/s11075-012-9569-7) for complex pairs in real arithmetic and the carried
residual; Benner & Saak 2011 for the second-order form; Benner, Kürschner & Saak 2014 for shifts from projections. Which
of the projected eigenvalues are taken, and how the rest is measured, is this project's.
"""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from fenics_rom.errors import SolverError
from fenics_rom.reduction.common_basis import orthonormal_rest
from fenics_rom.reduction.gramians import UNDAMPED
from fenics_rom.system.protocols import Array, Factor
from fenics_rom.system.system import System

START = 8  # vectors that the first shifts are found in
SWEEP = 8  # shifts between two looks at the Gramian
MOST_SHIFTS = 600  # each costs a factorisation
DEPENDENT = 1e-13  # share of the largest column of B that counts as none
# Share of the largest singular value of Z that is dropped. What is dropped is orthogonal to what stays, so it changes
# σ² by its square only: σ of 1e-8 of the largest is known to 1e-9.
TRUNCATION = 1e-13


@dataclass(frozen=True)
class Span:
    """A subspace in the M-orthonormal basis that diagonalizes K.

    Attributes:
        basis: X (rows here, k), XᵀMX = I, XᵀKX = diag(γ), kg^-1/2.
        eigenvalues: γ (k,), 1/s².
        damping: XᵀDX, its diagonal (k,) where D is proportional, else (k, k), 1/s.
    """

    basis: Array
    eigenvalues: Array
    damping: Array


@dataclass(frozen=True)
class LowRankGramian:
    """The position block Wc ≈ (X Z) (X Z)ᵀ, as far as it is known.

    Attributes:
        space: X, which holds the columns of the factor and those of its krylov_augmentation.
        factor: Z (k, c) in the coordinates of that space, c <= k.
        shifts: number of factorisations that it took; a complex pair counts once.
        rest: length of the largest motion that the residual still adds to the factor, as a share of |Z|; of a σ it
            changes about half the square of what it is as a share of that σ.
        residual: root of the static energy of what is left (`Residual.energy`), as a share of that of the start.
    """

    space: Span
    factor: Array
    shifts: int
    rest: float
    residual: float


@dataclass(frozen=True)
class Residual:
    """W, whose W Wᵀ is what is left of the Lyapunov equation.

    Attributes:
        motion: (rows here, p) its part in dx/dt = v, m/s.
        force: (rows here, p) its part in the momentum balance, N.
    """

    motion: Array
    force: Array

    def energy(self, system: System, factor: Factor) -> float:
        """Energy of A⁻¹W, the state in which the system would rest under it; it falls with every step.

        A step multiplies W by a Cayley transform of A, which commutes with A⁻¹ and is a contraction of the energy.

        Args:
            system: the full-order model.
            factor: of K.
        """
        inner = system.algebra.inner
        force = self.force + system.damping @ self.motion
        kinetic = inner(self.motion, system.mass @ self.motion)
        return float(np.trace(kinetic) + np.trace(inner(force, factor.solve(force))))


def low_rank_gramians(
    system: System, factor: Factor, B: Array, krylov_augmentation: Array | None = None
) -> Iterator[LowRankGramian]:
    """Controllability Gramians of growing rank, one after each sweep of shifts; it is for the caller to stop.

    The residual says little about which σ are settled: watch σ, from the factor and `observed` or an observability
    Gramian projected on the space. With light damping one sweep may leave σ as they are and the next not, so look at
    two, or at `rest`. The iteration ends by itself after `MOST_SHIFTS` only, so whoever reaches its end has a Gramian
    that has not settled.

    A projected observability Gramian is only as good as the space holds the motions after a release, and local
    dashpots and outputs turn those into others. Their columns may augment B: the space then serves them as if
    they were inputs; they cost solves, but no factorisations, and the Gramian is that of B alone.

    Args:
        system: the full-order model.
        factor: of K.
        B: (rows here, p) input matrix; dependent columns cost nothing.
        krylov_augmentation: (rows here, any).

    Raises:
        SolverError: there is no damping, so that the Gramian does not exist.
    """
    force, compliance = _independent(system, factor, B)
    inputs = force.shape[1]
    if krylov_augmentation is not None and krylov_augmentation.shape[1]:
        others, other = _independent(system, factor, krylov_augmentation)
        force = np.hstack([force, np.sqrt(compliance / other) * others])  # alike in size, for one truncation
    residual = Residual(0 * force, force)
    start, done = residual.energy(system, factor), 0
    space = _first_space(system, factor, force)
    λ, contributions = _contributions(system, space, residual)
    basis, parts = force[:, :0], [np.empty((0, 0)), np.empty((0, 0))]
    while done < MOST_SHIFTS:
        blocks = []
        for μ in shifts(λ, contributions):
            block, residual = step(system, residual, μ)
            blocks.append(block)
        columns = np.hstack(blocks)
        own = np.arange(columns.shape[1]) % force.shape[1] < inputs
        space, parts = _compressed(system, basis, parts, [columns[:, own], columns[:, ~own]])
        basis, done = space.basis, done + len(blocks)
        λ, contributions = _contributions(system, space, residual)
        rest = float(contributions.max() / np.linalg.norm(parts[0], 2))
        yield LowRankGramian(space, parts[0], done, rest, float(np.sqrt(residual.energy(system, factor) / start)))


def step(system: System, residual: Residual, μ: complex) -> tuple[Array, Residual]:
    """One shift, or a complex one and its conjugate together: new columns of Z, and what is left.

    V = (A + μE)⁻¹ W has the positions x = (μ²M - μD + K)⁻¹ (μ M w - D w - f) and the velocities w - μ x. With
    δ = Re μ / Im μ, both steps of a pair together add to Z the columns √(-4 Re μ) (Re V + δ Im V) and
    √(-4 Re μ) √(1 + δ²) Im V (Benner, Kürschner & Saak 2013).

    Args:
        system: the full-order model.
        residual: W = (w, f), p columns.
        μ: shift with Re μ < 0, 1/s.

    Returns:
        positions of the new columns, (rows here, p) for a real shift and (rows here, 2 p) for a pair; the new W.
    """
    w, f = residual.motion, residual.force
    shift = μ if μ.imag else μ.real
    with closing(
        system.algebra.factor((shift**2, system.mass), (-shift, system.damping), (1.0, system.stiffness))
    ) as factor:
        x = factor.solve(shift * (system.mass @ w) - system.damping @ w - f)
    v = w - shift * x
    if μ.imag:
        δ, weight = μ.real / μ.imag, -4 * μ.real
        columns = [x.real + δ * x.imag, np.sqrt(1 + δ**2) * x.imag]
        v = v.real + δ * v.imag
    else:
        weight, columns = -2 * μ.real, [x]
    left = Residual(w + weight * columns[0], f + weight * (system.mass @ v))
    return np.sqrt(weight) * np.hstack(columns), left


def shifts(λ: Array, contributions: Array) -> list[complex]:
    """Shifts for a sweep: the eigenvalue that contributes most, and so on with what that shift leaves of the others.

    Of each λ it leaves |λ - μ̄| / |λ + μ|, and if μ is complex, of that |λ - μ| / |λ + μ̄| for its conjugate.

    Args:
        λ: (l,) eigenvalues of a projected system, 1/s.
        contributions: (l,) to the factor, as long as there is no shift.
    """
    taken: list[complex] = []
    while len(taken) < min(SWEEP, len(λ)):
        μ = complex(λ[np.argmax(contributions)])
        taken.append(μ)
        contributions = contributions * np.abs((λ - np.conj(μ)) / (λ + μ))
        if μ.imag:
            contributions = contributions * np.abs((λ - μ) / (λ + np.conj(μ)))
    return taken


def _contributions(system: System, space: Span, residual: Residual) -> tuple[Array, Array]:
    """Eigenvalues λ of the projected system in the upper left quarter, and what each still adds to Z, (l,) both.

    That is a motion of length |x| |c| / √(-2 Re λ), with x the position of its eigenvector and c the coordinates of W
    in the eigenvectors; √2 of it together with that of the conjugate.

    Args:
        system: the full-order model.
        space: what to project on.
        residual: W.

    Raises:
        SolverError: no motion in that space is damped.
    """
    X, ω, inner = space.basis, np.sqrt(space.eigenvalues), system.algebra.inner
    D = np.diag(space.damping) if space.damping.ndim == 1 else space.damping
    # of the state (ω q, r), in which the matrix is skew-symmetric but for the damping
    λ, E = np.linalg.eig(np.block([[np.zeros_like(D), np.diag(ω)], [-np.diag(ω), -D]]))
    state = np.vstack([ω[:, None] * inner(X, system.mass @ residual.motion), inner(X, residual.force)])
    # critically damped motions have one eigenvector for two eigenvalues; rank-revealing QR stands that
    c = scipy.linalg.lstsq(E, state.astype(complex), lapack_driver="gelsy")[0]
    there = (λ.imag >= 0) & (λ.real < -np.finfo(float).eps * np.abs(λ).max())
    if not there.any():
        raise SolverError(UNDAMPED)
    lengths = np.linalg.norm(E[: len(ω)] / ω[:, None], axis=0) * np.linalg.norm(c, axis=1)
    λ = λ[there]
    return λ, lengths[there] / np.sqrt(-np.where(λ.imag > 0, 1, 2) * λ.real)


def independent(system: System, B: Array) -> Array:
    """B' with B'B'ᵀ = B Bᵀ and as few columns as can be, (rows here, rank)."""
    inner = system.algebra.inner
    rotated = B @ np.linalg.eigh(inner(B, B))[1]
    norms = np.sqrt(np.diag(inner(rotated, rotated)))  # of the columns: the roots of the eigenvalues would be too rough
    return rotated[:, norms > DEPENDENT * norms.max()]


def observed(system: System, factor: Factor, X: Array) -> Array:
    """Xᵀ Wo X for proportional damping and the mass-weighted shape, exactly: no Lyapunov equation, (k, k).

    Wo = β/2 M + α/2 M K⁻¹ M + ½ M D⁻¹ M for D = α M + β K.

    Args:
        system: the full-order model, with `rayleigh`.
        factor: of K.
        X: (rows here, k).
    """
    assert system.rayleigh is not None, "the closed form is that of proportional damping"
    α, β = system.rayleigh
    MX = system.mass @ X
    with closing(system.algebra.factor((α, system.mass), (β, system.stiffness))) as damping:
        seen = β * X + α * factor.solve(MX) + damping.solve(MX)
    Wo = system.algebra.inner(MX, seen) / 2
    return (Wo + Wo.T) / 2


def _independent(system: System, factor: Factor, B: Array) -> tuple[Array, float]:
    """`independent` columns and their compliance tr BᵀK⁻¹B, m/N."""
    columns = independent(system, B)
    return columns, Residual(0 * columns, columns).energy(system, factor)


def _first_space(system: System, factor: Factor, force: Array) -> Span:
    """A block Krylov space of K⁻¹M from K⁻¹B, of `START` vectors or what there is."""
    basis = new = orthonormal_rest(system, factor.solve(force), force[:, :0], force[:, :0])[0]
    while basis.shape[1] < START and new.shape[1]:
        new = orthonormal_rest(system, factor.solve(system.mass @ new), basis, system.mass @ basis)[0]
        basis = np.hstack([basis, new])
    return _span(system, basis)


def _span(system: System, basis: Array) -> Span:
    """The span of an M-orthonormal basis."""
    K = system.algebra.inner(basis, system.stiffness @ basis)
    γ, rotation = np.linalg.eigh((K + K.T) / 2)
    X = basis @ rotation
    if system.rayleigh is not None:
        α, β = system.rayleigh
        return Span(X, γ, α + β * γ)
    D = system.algebra.inner(X, system.damping @ X)
    return Span(X, γ, (D + D.T) / 2)


def _compressed(system: System, basis: Array, parts: list[Array], columns: list[Array]) -> tuple[Span, list[Array]]:
    """The span of all parts and their new columns without what is round-off, and the parts in its coordinates.

    Args:
        system: the full-order model.
        basis: (rows here, k) M-orthonormal.
        parts: (k, any) each, in that basis: the factor, and its krylov_augmentation.
        columns: (rows here, any), what is new in each part.
    """
    inner, rest = system.algebra.inner, np.hstack(columns)
    for _ in range(2):  # what is too small a share of a column to be a direction is too large to be lost
        basis = np.hstack([basis, orthonormal_rest(system, rest, basis, system.mass @ basis)[0]])
        rest = rest - basis @ inner(basis, system.mass @ rest)
    added = [inner(basis, system.mass @ new) for new in columns]
    grown = [
        np.hstack([np.pad(old, ((0, len(new) - len(old)), (0, 0))), new]) for old, new in zip(parts, added, strict=True)
    ]
    U, s, _ = np.linalg.svd(np.hstack(grown), full_matrices=False)
    kept = U[:, s > TRUNCATION * s[0]]
    space = _span(system, basis @ kept)
    turned = inner(space.basis, system.mass @ basis)
    return space, [_shortened(turned @ part) for part in grown]


def _shortened(Z: Array) -> Array:
    """Z' with Z'Z'ᵀ = Z Zᵀ and no more columns than rows."""
    U, s, _ = np.linalg.svd(Z, full_matrices=False)
    return U * s
