"""One basis for all contact modes, from columns that each weigh what they matter."""

from collections.abc import Mapping

import numpy as np

from fenics_rom.reduction.balancing import order_of
from fenics_rom.reduction.problem import RankedBasis, ReductionProblem
from fenics_rom.reduction.projection import RetainedBasis
from fenics_rom.system.protocols import Array

ROUND_OFF = 1e-14  # share of the largest eigenvalue of a Gram matrix below which it is noise
LINEAR = 0.03  # of a run's weight that the directions of small motions have together, for each contact mode


def kept_of(problem: ReductionProblem, columns: Array) -> RetainedBasis:
    """The leading left singular vectors of weighted columns (rows here, c) in the mass norm, as many as are asked for.

    The order of several contact modes is the largest, as they have one basis; a tolerance is the share of the sum of
    singular values that may be left out.
    """
    inner, M = problem.system.algebra.inner, problem.system.mass
    w, E = np.linalg.eigh(inner(columns, M @ columns))
    there = w > ROUND_OFF * w[-1]
    w, E = w[there][::-1], E[:, there][:, ::-1]
    asked = max(problem.order.values()) if isinstance(problem.order, Mapping) else problem.order
    m = order_of(np.sqrt(w), asked, problem.tolerance)
    if len(w) < m:
        problem.messages.append(f"order {m} was asked for, {len(w)} directions were seen and kept")
    coordinates = problem.space.add(columns @ (E[:, :m] / np.sqrt(w[:m])))
    span = np.linalg.qr(coordinates)[0]
    return RetainedBasis(span, coordinates, np.empty(0))


def snapshots(problem: ReductionProblem, runs: list[Array]) -> Array:
    """The shapes of all runs, each run as important as any other: it may be of a load that moves the body little."""
    return np.hstack([shapes / _size(problem, shapes) for shapes in runs])


def small_motions(problem: ReductionProblem, found: Mapping[str, RankedBasis]) -> Array:
    """The directions of linear contact modes, weighted by their singular values: so that small loads stay right."""
    columns = []
    for name, directions in found.items():
        m = problem.order_of(name) or len(directions.singular_values)
        T = problem.space.basis[:, : len(directions.coordinates)] @ directions.coordinates[:, :m]
        T = T / np.sqrt(np.diag(problem.system.algebra.inner(T, problem.system.mass @ T)))
        σ = directions.singular_values[: T.shape[1]]
        columns.append(LINEAR * T * σ / np.linalg.norm(σ))
    return np.hstack(columns)


def _size(problem: ReductionProblem, shapes: Array) -> float:
    return float(np.sqrt(np.trace(problem.system.algebra.inner(shapes, problem.system.mass @ shapes))))
