"""Methods "modal" and "modal+static": the lowest eigenvectors, as they are or after the static shapes of the inputs."""

from collections.abc import Iterator

import numpy as np

from fenics_rom.errors import SceneError
from fenics_rom.reduction.common_basis import orthogonal_complement, pad_rows
from fenics_rom.reduction.eigenvectors import share_eigenvectors
from fenics_rom.reduction.problem import RankedBasis, ReductionProblem
from fenics_rom.reduction.residual_compliance import has_residual_compliance


def modal(problem: ReductionProblem) -> Iterator[tuple[str, RankedBasis]]:
    """The lowest eigenvectors of K v = γ M v, whatever the inputs are."""
    share_eigenvectors(problem, _highest_order(problem))
    for name in problem.contacts:
        yield name, RankedBasis(np.eye(problem.space.eigenvectors))


def modal_static(problem: ReductionProblem) -> Iterator[tuple[str, RankedBasis]]:
    """K⁻¹B first, so that loads at rest are exact, then the lowest eigenvectors (Craig & Bampton 1968 do likewise).

    Contact points that keep their residual compliance need no static shapes: beside eigenvectors it is exact at rest,
    and moves by itself, as nothing couples the two by mass (MacNeal 1971, Rubin 1975).
    """
    share_eigenvectors(problem, _highest_order(problem))
    system, yields = problem.system, has_residual_compliance(problem)
    for name in problem.contacts:
        B = np.hstack([*system.actuators.values(), *system.loads.values(), system.contacts[name][:, :0]])
        with problem.stages("solves with K"):
            statics = problem.factor.solve(B if yields else system.forces(name))
        shapes = problem.space.add(statics)
        V = pad_rows(np.eye(problem.space.eigenvectors), len(shapes))
        yield name, RankedBasis(np.hstack([orthogonal_complement(shapes, shapes[:, :0]), V]))


def _highest_order(problem: ReductionProblem) -> int:
    orders = [problem.order_of(name) for name in problem.contacts]
    known = [order for order in orders if order is not None]
    if len(known) < len(orders):
        raise SceneError("eigenvectors have no singular values for a tolerance to leave out; give an order")
    return max(known)
