"""Method "static": the shapes of the loads at rest, K⁻¹B, which is all that a quasi-static run needs."""

from collections.abc import Iterator

import numpy as np

from fenics_rom.reduction.common_basis import significant_eigenpairs
from fenics_rom.reduction.problem import RankedBasis, ReductionProblem


def static(problem: ReductionProblem) -> Iterator[tuple[str, RankedBasis]]:
    """Ordered by the compliance BᵀK⁻¹B = U Λ Uᵀ: the shapes K⁻¹B U, the most compliant combination of forces first.

    They are stiffness-orthogonal, and what r of them leave out of the displacement energy of any force of length 1 is
    at most Λ_(r+1). All of them are exact.
    """
    for name in problem.contacts:
        B = problem.system.forces(name)
        with problem.stages("solves with K"):
            shapes = problem.factor.solve(B)
        compliance = problem.system.algebra.inner(B, shapes)
        Λ, U = significant_eigenpairs((compliance + compliance.T) / 2)
        yield name, problem.directions(shapes @ (U / np.sqrt(Λ)), Λ)
