"""Method "balanced": second-order balanced truncation by the position Gramians, paper (5)-(8)."""

from collections.abc import Iterator

import numpy as np

from fenics_rom.errors import SolverError
from fenics_rom.reduction.adi import Span, low_rank_gramians, observed
from fenics_rom.reduction.balancing import balance, order_of
from fenics_rom.reduction.eigenvectors import share_eigenvectors
from fenics_rom.reduction.gramians import gramian_factors, square_root
from fenics_rom.reduction.krylov import SETTLED, UNREST, change_of, directions_by_change, directions_by_residual
from fenics_rom.reduction.krylov_augmentation import Company, company_of
from fenics_rom.reduction.problem import RankedBasis, ReductionProblem
from fenics_rom.reduction.realization import balanced_by_textbook, balanced_in, directions_of, output_weight
from fenics_rom.system.protocols import Array

MOST_COLUMNS = 24  # of all input matrices, that are better served by Krylov spaces alone than with eigenvectors
EIGENVECTORS = 100  # shared by more columns than that; twice the order where that is more
GROUP = 48  # columns whose blocks are solved for together then
SMALL_GROUP = 12  # and else: fewer, so that a stopped run has something finished
MUCH = 1e-4  # share of all motions that is still to come, with which σ need not be looked at


def balanced(problem: ReductionProblem) -> Iterator[tuple[str, RankedBasis]]:
    """Balanced directions, by the route to the Gramians that the problem names."""
    if problem.lyapunov == "krylov":
        yield from _krylov(problem)
    elif problem.lyapunov == "adi":
        krylov_augmentation = company_of(problem)
        for name in problem.contacts:
            yield name, _adi(problem, name, krylov_augmentation)
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
                found = directions_of(whole, balanced_in(problem, whole, inputs))
            else:
                found = balanced_by_textbook(problem, B, as_printed=problem.lyapunov == "as-printed")
        yield name, found


def _krylov(problem: ReductionProblem) -> Iterator[tuple[str, RankedBasis]]:
    """Contact modes in groups; where there are many columns, with eigenvectors to share."""
    names = problem.contacts
    widths = [problem.system.forces(name).shape[1] for name in names]
    if sum(widths) <= MOST_COLUMNS:
        directions, columns = directions_by_change, SMALL_GROUP
    else:
        share_eigenvectors(problem, max(EIGENVECTORS, 2 * max(problem.order_of(name) or 0 for name in names)))
        directions, columns = directions_by_residual, GROUP
    size, krylov_augmentation = max(1, columns // max(widths)), company_of(problem)
    for first in range(0, len(names), size):
        yield from directions(problem, names[first : first + size], krylov_augmentation)


def _adi(problem: ReductionProblem, name: str, krylov_augmentation: Company) -> RankedBasis:
    """From a low-rank Gramian, grown until σ have stayed for two sweeps: with light damping one can pass by chance."""
    system, factor, order = problem.system, problem.factor, problem.order_of(name)
    σ, change, stable_sweeps = np.empty(0), 1.0, 0
    with problem.stages("shifts and sweeps"):
        for found in low_rank_gramians(system, factor, system.forces(name), krylov_augmentation.columns):
            if found.rest > MUCH:
                continue
            balanced = balance(found.factor, _observed(problem, found.space))
            change = change_of(balanced.singular_values, σ, order, problem.tolerance)
            σ, stable_sweeps = balanced.singular_values, stable_sweeps + 1 if change <= SETTLED else 0
            if stable_sweeps == 2:
                break
    if not len(σ):
        raise SolverError(
            f"contact mode {name!r}: after {found.shifts} shifts a motion of {found.rest:.0e} of all was still missing "
            "in the Gramian; lyapunov = 'krylov' is the other route"
        )
    if stable_sweeps < 2 and change > UNREST:
        problem.messages.append(
            f"contact mode {name!r}: Hankel singular values still changed by {change:.0e} after {found.shifts} shifts; "
            "ask for a lower order"
        )
    T = balanced.transformation[:, : order_of(σ, order, problem.tolerance)]
    return RankedBasis(problem.space.add(found.space.basis @ T), σ, True)


def _observed(problem: ReductionProblem, space: Span) -> Array:
    """Square root of the observability Gramian: exact where it has a closed form, else of the projected system."""
    system, X = problem.system, space.basis
    if system.rayleigh is not None and problem.weighting == "mass":
        return square_root(observed(system, problem.factor, X))
    no_inputs = np.empty((X.shape[1], 0))
    return gramian_factors(space.eigenvalues, space.damping, no_inputs, output_weight(problem, X))[1]
