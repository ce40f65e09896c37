"""One basis for all contact modes, from columns that each weigh what they matter."""

from collections.abc import Mapping

import numpy as np

from fenics_rom.reduction.balancing import choose_order
from fenics_rom.reduction.gram import significant_eigenpairs
from fenics_rom.reduction.problem import RankedBasis, ReductionProblem
from fenics_rom.reduction.projection import RetainedBasis
from fenics_rom.system.protocols import Array

SMALL_MOTION_WEIGHT = (
    0.03  # of a run's weight that the directions of small motions have together, for each contact mode
)


def retained_basis(problem: ReductionProblem, columns: Array) -> RetainedBasis:
    """The leading left singular vectors of weighted columns (rows here, c) in the mass norm, as many as are asked for.

    The order of several contact modes is the largest, as they have one basis; a tolerance is the share of the sum of
    singular values that may be left out.
    """
    w, E = significant_eigenpairs(problem.system.algebra.inner(columns, problem.system.mass @ columns))
    order = max(problem.order.values()) if isinstance(problem.order, Mapping) else problem.order
    m = choose_order(np.sqrt(w), order, problem.tolerance)
    if len(w) < m:
        problem.messages.append(f"order {m} was asked for, {len(w)} directions were seen and kept")
    coordinates = problem.space.add(columns @ (E[:, :m] / np.sqrt(w[:m])))
    span = np.linalg.qr(coordinates)[0]
    return RetainedBasis(span, coordinates, np.empty(0))


def weighted_snapshots(problem: ReductionProblem, runs: list[Array]) -> Array:
    """The shapes of all runs, each run as important as any other: it may be of a load that moves the body little."""
    return np.hstack([shapes / _mass_norm(problem, shapes) for shapes in runs])


def weighted_small_motions(problem: ReductionProblem, bases: Mapping[str, RankedBasis]) -> Array:
    """The directions of linear contact modes, weighted by their singular values: so that small loads stay right."""
    columns = []
    for name, ranked in bases.items():
        m = problem.order_of(name) or len(ranked.singular_values)
        T = problem.space.basis[:, : len(ranked.coordinates)] @ ranked.coordinates[:, :m]
        T = T / np.sqrt(np.diag(problem.system.algebra.inner(T, problem.system.mass @ T)))
        σ = ranked.singular_values[: T.shape[1]]
        columns.append(SMALL_MOTION_WEIGHT * T * σ / np.linalg.norm(σ))
    return np.hstack(columns)


def _mass_norm(problem: ReductionProblem, shapes: Array) -> float:
    """√(tr XᵀMX) of shapes X (rows here, s)."""
    return float(np.sqrt(np.trace(problem.system.algebra.inner(shapes, problem.system.mass @ shapes))))
