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
from numpy import ndarray as Array

from fenics_rom.errors import SolverError
from fenics_rom.reduction.common_basis import orthonormalize_against
from fenics_rom.reduction.gramians import NO_DAMPING
from fenics_rom.system.protocols import Factor
from fenics_rom.system.system import System

INITIAL_VECTORS = 8  # of the space whose Ritz values are the first shifts
SHIFTS_PER_SWEEP = 8  # between two evaluations of the Gramian
MAX_SHIFTS = 600  # each costs a factorisation
DEPENDENCE_TOLERANCE = 1e-13  # share of the largest column of B that counts as none
# Share of the largest singular value of Z that is dropped. What is dropped is orthogonal to what stays, so it changes
# σ² by its square only: σ of 1e-8 of the largest is known to 1e-9.
TRUNCATION_TOLERANCE = 1e-13


@dataclass(frozen=True)
class ModalSubspace:
    """A subspace in the M-orthonormal basis that diagonalizes K."""

    basis: Array  # X (rows here, k), XᵀMX = I, XᵀKX = diag(γ), kg^-1/2
    eigenvalues: Array  # γ (k,), 1/s²
    damping: Array  # XᵀDX, its diagonal (k,) where D is proportional, else (k, k), 1/s


@dataclass(frozen=True)
class LowRankGramian:
    """The position block Wc ≈ (X Z) (X Z)ᵀ, as far as it is known.

    What remains is the length of the largest motion that the residual still adds to the factor, as a share of |Z|; of a
    σ it changes about half the square of what it is as a share of that σ.
    """

    space: ModalSubspace  # X, which holds the columns of the factor and those of its augmentation
    factor: Array  # Z (k, c) in the coordinates of that space, c <= k
    shifts: int  # number of factorisations that it took; a complex pair counts once
    remaining: float
    residual: float  # root of the static energy of what is left (`Residual.energy`), as a share of that of the start


@dataclass(frozen=True)
class Residual:
    """W, whose W Wᵀ is what is left of the Lyapunov equation."""

    motion: Array  # (rows here, p) its part in dx/dt = v, m/s
    force: Array  # (rows here, p) its part in the momentum balance, N

    def energy(self, system: System, factor: Factor) -> float:
        """Energy of A⁻¹W, the state in which the system would rest under it; `factor` is of K.

        It falls with every step, which multiplies W by a Cayley transform of A: that commutes with A⁻¹ and is a
        contraction of the energy.
        """
        inner = system.algebra.inner
        force = self.force + system.damping @ self.motion
        kinetic = inner(self.motion, system.mass @ self.motion)
        return float(np.trace(kinetic) + np.trace(inner(force, factor.solve(force))))


def low_rank_gramians(
    system: System, factor: Factor, B: Array, augmentation: Array | None = None
) -> Iterator[LowRankGramian]:
    """Controllability Gramians of growing rank, one after each sweep of shifts; it is for the caller to stop.

    The residual says little about which σ have converged: watch σ, from the factor and `projected_observability` or an
    observability Gramian projected on the space. With light damping one sweep may leave σ as they are and the next
    not, so look at two, or at `remaining`. The iteration ends by itself after `MAX_SHIFTS` only, so whoever reaches its
    end has a Gramian that has not converged.

    A projected observability Gramian is only as good as the space holds the motions after a release, and local
    dashpots and outputs turn those into others. Their columns may augment B: the space then serves them as if
    they were inputs; they cost solves, but no factorisations, and the Gramian is that of B alone, whose dependent
    columns cost nothing. `factor` is of K.

    Raises:
        SolverError: there is no damping, so that the Gramian does not exist.
    """
    force, compliance = _with_compliance(system, factor, B)
    inputs = force.shape[1]
    if augmentation is not None and augmentation.shape[1]:
        augmenting, their_compliance = _with_compliance(system, factor, augmentation)
        force = np.hstack([force, np.sqrt(compliance / their_compliance) * augmenting])  # alike in size: one truncation
    residual = Residual(0 * force, force)
    initial_energy, shift_count = residual.energy(system, factor), 0
    space = _first_space(system, factor, force)
    λ, contributions = _contributions(system, space, residual)
    basis, parts = force[:, :0], [np.empty((0, 0)), np.empty((0, 0))]
    while shift_count < MAX_SHIFTS:
        blocks = []
        for μ in select_shifts(λ, contributions):
            block, residual = apply_shift(system, residual, μ)
            blocks.append(block)
        columns = np.hstack(blocks)
        of_inputs = np.arange(columns.shape[1]) % force.shape[1] < inputs
        space, parts = _compressed(system, basis, parts, [columns[:, of_inputs], columns[:, ~of_inputs]])
        basis, shift_count = space.basis, shift_count + len(blocks)
        λ, contributions = _contributions(system, space, residual)
        remaining = float(contributions.max() / np.linalg.norm(parts[0], 2))
        relative_residual = float(np.sqrt(residual.energy(system, factor) / initial_energy))
        yield LowRankGramian(space, parts[0], shift_count, remaining, relative_residual)


def apply_shift(system: System, residual: Residual, μ: complex) -> tuple[Array, Residual]:
    """One shift, or a complex one and its conjugate together: new columns of Z, and what is left.

    V = (A + μE)⁻¹ W has the positions x = (μ²M - μD + K)⁻¹ (μ M w - D w - f) and the velocities w - μ x. With
    δ = Re μ / Im μ, both steps of a pair together add to Z the columns √(-4 Re μ) (Re V + δ Im V) and
    √(-4 Re μ) √(1 + δ²) Im V (Benner, Kürschner & Saak 2013).

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
    remaining = Residual(w + weight * columns[0], f + weight * (system.mass @ v))
    return np.sqrt(weight) * np.hstack(columns), remaining


def select_shifts(λ: Array, contributions: Array) -> list[complex]:
    """Shifts for a sweep: the eigenvalue λ that contributes most, and so on with what it leaves of the others.

    Of each λ a shift leaves |λ - μ̄| / |λ + μ|, and if μ is complex, of that |λ - μ| / |λ + μ̄| for its conjugate.
    """
    selected: list[complex] = []
    while len(selected) < min(SHIFTS_PER_SWEEP, len(λ)):
        μ = complex(λ[np.argmax(contributions)])
        selected.append(μ)
        contributions = contributions * np.abs((λ - np.conj(μ)) / (λ + μ))
        if μ.imag:
            contributions = contributions * np.abs((λ - μ) / (λ + np.conj(μ)))
    return selected


def _contributions(system: System, space: ModalSubspace, residual: Residual) -> tuple[Array, Array]:
    """Eigenvalues λ of the projected system in the upper left quarter, and what each still adds to Z, (l,) both.

    That is a motion of length |x| |c| / √(-2 Re λ), with x the position of its eigenvector and c the coordinates of W
    in the eigenvectors; √2 of it together with that of the conjugate.
    """
    X, ω, inner = space.basis, np.sqrt(space.eigenvalues), system.algebra.inner
    D = np.diag(space.damping) if space.damping.ndim == 1 else space.damping
    # of the state (ω q, r), in which the matrix is skew-symmetric but for the damping
    λ, E = np.linalg.eig(np.block([[np.zeros_like(D), np.diag(ω)], [-np.diag(ω), -D]]))
    state = np.vstack([ω[:, None] * inner(X, system.mass @ residual.motion), inner(X, residual.force)])
    # critically damped motions have one eigenvector for two eigenvalues; rank-revealing QR stands that
    c = scipy.linalg.lstsq(E, state.astype(complex), lapack_driver="gelsy")[0]
    damped = (λ.imag >= 0) & (λ.real < -np.finfo(float).eps * np.abs(λ).max())
    if not damped.any():
        raise SolverError(NO_DAMPING)
    lengths = np.linalg.norm(E[: len(ω)] / ω[:, None], axis=0) * np.linalg.norm(c, axis=1)
    λ = λ[damped]
    return λ, lengths[damped] / np.sqrt(-np.where(λ.imag > 0, 1, 2) * λ.real)


def independent_columns(system: System, B: Array) -> Array:
    """B' with B'B'ᵀ = B Bᵀ and as few columns as can be, (rows here, rank)."""
    inner = system.algebra.inner
    rotated = B @ np.linalg.eigh(inner(B, B))[1]
    norms = np.sqrt(np.diag(inner(rotated, rotated)))  # of the columns: the roots of the eigenvalues would be too rough
    return rotated[:, norms > DEPENDENCE_TOLERANCE * norms.max()]


def projected_observability(system: System, factor: Factor, X: Array) -> Array:
    """Xᵀ Wo X for D = α M + β K and the mass-weighted shape, exactly: no Lyapunov equation, (k, k); `factor` is of K.

    Wo = β/2 M + α/2 M K⁻¹ M + ½ M D⁻¹ M.
    """
    assert system.rayleigh is not None, "the closed form is that of proportional damping"
    α, β = system.rayleigh
    MX = system.mass @ X
    with closing(system.algebra.factor((α, system.mass), (β, system.stiffness))) as damping:
        doubled = β * X + α * factor.solve(MX) + damping.solve(MX)
    Wo = system.algebra.inner(MX, doubled) / 2
    return (Wo + Wo.T) / 2


def _with_compliance(system: System, factor: Factor, B: Array) -> tuple[Array, float]:
    """Independent columns and their compliance tr BᵀK⁻¹B, m/N."""
    columns = independent_columns(system, B)
    return columns, Residual(0 * columns, columns).energy(system, factor)


def _first_space(system: System, factor: Factor, force: Array) -> ModalSubspace:
    """A block Krylov space of K⁻¹M from K⁻¹B, of `INITIAL_VECTORS` or what there is."""
    basis = new = orthonormalize_against(system, factor.solve(force), force[:, :0])[0]
    while basis.shape[1] < INITIAL_VECTORS and new.shape[1]:
        new = orthonormalize_against(system, factor.solve(system.mass @ new), basis)[0]
        basis = np.hstack([basis, new])
    return _diagonalized(system, basis)


def _diagonalized(system: System, basis: Array) -> ModalSubspace:
    """The space of an M-orthonormal basis."""
    K = system.algebra.inner(basis, system.stiffness @ basis)
    γ, rotation = np.linalg.eigh((K + K.T) / 2)
    X = basis @ rotation
    if system.rayleigh is not None:
        α, β = system.rayleigh
        return ModalSubspace(X, γ, α + β * γ)
    D = system.algebra.inner(X, system.damping @ X)
    return ModalSubspace(X, γ, (D + D.T) / 2)


def _compressed(
    system: System, basis: Array, parts: list[Array], columns: list[Array]
) -> tuple[ModalSubspace, list[Array]]:
    """The space of all parts and their new columns without what is round-off, and the parts in its coordinates.

    Parts (k, any), the factor and what augments it, are in an M-orthonormal basis (rows here, k); columns (rows here,
    any) are what is new in each.
    """
    inner, remainder = system.algebra.inner, np.hstack(columns)
    for _ in range(2):  # what is too small a share of a column to be a direction is too large to be lost
        basis = np.hstack([basis, orthonormalize_against(system, remainder, basis)[0]])
        remainder = remainder - basis @ inner(basis, system.mass @ remainder)
    projected = [inner(basis, system.mass @ new) for new in columns]
    grown = [
        np.hstack([np.pad(old, ((0, len(new) - len(old)), (0, 0))), new])
        for old, new in zip(parts, projected, strict=True)
    ]
    U, s, _ = np.linalg.svd(np.hstack(grown), full_matrices=False)
    significant = U[:, s > TRUNCATION_TOLERANCE * s[0]]
    space = _diagonalized(system, basis @ significant)
    change_of_basis = inner(space.basis, system.mass @ basis)
    decomposed = (np.linalg.svd(change_of_basis @ part, full_matrices=False) for part in grown)
    return space, [U * s for U, s, _ in decomposed]  # of the same Z Zᵀ, and no more columns than rows
