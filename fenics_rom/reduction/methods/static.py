"""Method "static": the shapes of the loads at rest, K⁻¹B, which is all that a quasi-static run needs."""

from collections.abc import Iterator

import numpy as np

from fenics_rom.reduction.common_basis import significant_eigenpairs
from fenics_rom.reduction.problem import RankedBasis, ReductionProblem


def static(problem: ReductionProblem) -> Iterator[tuple[str, RankedBasis]]:
    """Ordered by the compliance BᵀK⁻¹B = U Λ Uᵀ: the shapes K⁻¹B U, the most compliant combination of forces first.

    They are stiffness-orthogonal, and what r of them leave out of the displacement energy of any force of length 1 is
    at most Λ_(r+1). All of them are exact.

    Where obstacles can touch the body, those of actuators and loads come first: they are few, and forces on hundreds of
    nodes, many of them more compliant, would take their places, although these nodes keep their residual compliance.
    """
    system = problem.system
    shared = sum(system.widths.values())
    for name in problem.contacts:
        B = system.forces(name)
        with problem.stages("solves with K"):
            shapes = problem.factor.solve(B)
        compliance = system.algebra.inner(B, shapes)
        compliance = (compliance + compliance.T) / 2
        first = np.zeros((len(compliance), 0))  # such combinations of forces that their shapes are K-orthonormal
        if name in system.contact_points and shared:
            columns = slice(system.contacts[name].shape[1], system.contacts[name].shape[1] + shared)
            Λ, U = significant_eigenpairs(compliance[columns, columns])
            first = np.zeros((len(compliance), len(Λ)))
            first[columns] = U / np.sqrt(Λ)
        along = compliance @ first
        Λ, U = significant_eigenpairs(compliance - along @ along.T)
        combinations = np.hstack([first, (U - first @ (along.T @ U)) / np.sqrt(Λ)])
        yield name, problem.directions(shapes @ combinations, np.hstack([np.full(first.shape[1], Λ[0]), Λ]))
