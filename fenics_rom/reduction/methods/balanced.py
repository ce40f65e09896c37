"""Method "balanced": second-order balanced truncation by the position Gramians, paper (5)-(8)."""

from collections.abc import Iterator

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SolverError
from fenics_rom.reduction.adi import ModalSubspace, low_rank_gramians, projected_observability
from fenics_rom.reduction.balancing import (
    balance,
    balanced_by_textbook,
    balanced_in,
    choose_order,
    output_weight,
    ranked_basis,
)
from fenics_rom.reduction.eigenvectors import share_eigenvectors
from fenics_rom.reduction.gramians import gramian_factors, square_root
from fenics_rom.reduction.krylov import (
    CONVERGENCE_TOLERANCE,
    WARNING_CHANGE,
    directions_by_change,
    directions_by_residual,
    relative_change,
)
from fenics_rom.reduction.krylov_augmentation import KrylovAugmentation, find_augmentation
from fenics_rom.reduction.problem import RankedBasis, ReductionProblem

MAX_COLUMNS_WITHOUT_EIGENVECTORS = 24  # of all input matrices: so few are better served by Krylov spaces alone
SHARED_EIGENVECTORS = 100  # by more columns than that; twice the order where that is more
COLUMNS_AT_ONCE = 48  # whose blocks are solved for together then
FEW_COLUMNS_AT_ONCE = 12  # and else: fewer, so that a stopped run has something finished
LARGE_REMAINDER = 1e-4  # share of all motions still missing in the Gramian, beyond which σ are not computed yet
STABLE_SWEEPS = 2  # over which σ must not change: with light damping one can pass by chance


def balanced(problem: ReductionProblem) -> Iterator[tuple[str, RankedBasis]]:
    """Balanced directions, by the route to the Gramians that the problem names."""
    if problem.lyapunov == "krylov":
        yield from _krylov(problem)
    elif problem.lyapunov == "adi":
        augmentation = find_augmentation(problem)
        for name in problem.contacts:
            yield name, _adi(problem, name, augmentation)
    else:
        yield from _in_all_eigenvectors(problem)


def _in_all_eigenvectors(problem: ReductionProblem) -> Iterator[tuple[str, RankedBasis]]:
    system, space = problem.system, problem.space
    share_eigenvectors(problem, system.elastic_size)
    whole = space.subspace(np.eye(system.elastic_size))
    for name in problem.contacts:
        B = system.forces(name)
        with problem.stages("balancing"):
            if problem.lyapunov == "closed-form":
                inputs = whole.coordinates.T @ system.algebra.inner(space.basis, B)
                ranked = ranked_basis(whole, balanced_in(problem, whole, inputs))
            else:
                ranked = balanced_by_textbook(problem, B, as_printed=problem.lyapunov == "as-printed")
        yield name, ranked


def _krylov(problem: ReductionProblem) -> Iterator[tuple[str, RankedBasis]]:
    """Contact modes in groups; where there are many columns, with eigenvectors to share."""
    names = tuple(problem.system.contacts)  # of a run that goes on those that are finished, too
    widths = [problem.system.count_forces(name) for name in names]
    if sum(widths) <= MAX_COLUMNS_WITHOUT_EIGENVECTORS:
        directions, columns = directions_by_change, FEW_COLUMNS_AT_ONCE
    else:
        highest = max(problem.order_of(name) or 0 for name in names)
        share_eigenvectors(problem, max(SHARED_EIGENVECTORS, 2 * highest))
        directions, columns, names = directions_by_residual, COLUMNS_AT_ONCE, problem.contacts
    size, augmentation = max(1, columns // max(widths)), find_augmentation(problem)
    for first in range(0, len(names), size):
        group = names[first : first + size]
        if set(group) & set(problem.contacts):
            yield from directions(problem, group, augmentation)


def _adi(problem: ReductionProblem, name: str, augmentation: KrylovAugmentation) -> RankedBasis:
    """From a low-rank Gramian, grown until σ no longer change."""
    system, factor, order = problem.system, problem.factor, problem.order_of(name)
    σ, change, stable_sweeps = np.empty(0), 1.0, 0
    with problem.stages("shifts and sweeps"):
        for gramian in low_rank_gramians(system, factor, system.forces(name), augmentation.columns):
            if gramian.remaining > LARGE_REMAINDER:
                continue
            balanced = balance(gramian.factor, _observability_factor(problem, gramian.space))
            change = relative_change(balanced.singular_values, σ, order, problem.tolerance)
            σ, stable_sweeps = balanced.singular_values, stable_sweeps + 1 if change <= CONVERGENCE_TOLERANCE else 0
            if stable_sweeps == STABLE_SWEEPS:
                break
    if not len(σ):
        raise SolverError(
            f"contact mode {name!r}: after {gramian.shifts} shifts a motion of {gramian.remaining:.0e} of all was "
            "still missing in the Gramian; lyapunov = 'krylov' is the other route"
        )
    if stable_sweeps < STABLE_SWEEPS and change > WARNING_CHANGE:
        problem.messages.append(
            f"contact mode {name!r}: its Hankel singular values are known to {change:.0e} only, after {gramian.shifts} "
            "shifts: the model may lack directions; its validation says how good it is, and a lower order is surer"
        )
    T = balanced.transformation[:, : choose_order(σ, order, problem.tolerance)]
    return RankedBasis(problem.space.add(gramian.space.basis @ T), σ, True)


def _observability_factor(problem: ReductionProblem, space: ModalSubspace) -> Array:
    """Square root of the observability Gramian: exact where it has a closed form, else of the projected system."""
    system, X = problem.system, space.basis
    if system.rayleigh is not None and problem.weighting == "mass":
        return square_root(projected_observability(system, problem.factor, X))
    no_inputs = np.empty((X.shape[1], 0))
    return gramian_factors(space.eigenvalues, space.damping, no_inputs, output_weight(problem, X))[1]
