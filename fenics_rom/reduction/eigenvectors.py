"""Generalized eigenvectors in the shared space, computed once for all contact modes."""

import numpy as np

from fenics_rom.errors import SceneError
from fenics_rom.reduction.common_basis import orthonormalize_against
from fenics_rom.reduction.problem import ReductionProblem


def share_eigenvectors(problem: ReductionProblem, count: int) -> None:
    """Makes the lowest eigenvectors the first columns of the shared space, which is empty or holds some and no more."""
    system, space = problem.system, problem.space
    count = min(count, system.elastic_size)
    if space.eigenvectors >= count:
        return
    if space.size > space.eigenvectors:
        raise SceneError(f"{count} eigenvectors were asked for after other directions; ask for them first")
    problem.stages.report("eigenvectors", 0, count)
    with problem.stages("eigenvectors"):
        _, V = system.algebra.eigenpairs(system.mass, system.stiffness, count, problem.factor)
        if space.size:  # those of equal eigenvalues may have come out otherwise than before
            V, *_ = orthonormalize_against(system, V, space.basis, space.mass_times_basis)
            V = V @ np.linalg.eigh(system.algebra.inner(V, system.stiffness @ V))[1]
        space.append(V)
    space.eigenvectors = space.size
    problem.stages.report("eigenvectors", count, count)
