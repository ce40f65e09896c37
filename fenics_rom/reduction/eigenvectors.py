"""Generalized eigenvectors in the shared space, computed once for all contact modes."""

from fenics_rom.errors import SceneError
from fenics_rom.reduction.problem import Problem


def share_eigenvectors(problem: Problem, count: int) -> None:
    """Makes the lowest eigenvectors the first columns of the shared space, which is empty or begins with some."""
    system, space = problem.system, problem.space
    count = min(count, system.elastic_size)
    if space.eigenvectors >= count:
        return
    if space.size:
        raise SceneError(f"{count} eigenvectors were asked for after other directions; ask for them first")
    problem.stages.report("eigenvectors", 0, count)
    with problem.stages("eigenvectors"):
        _, V = system.algebra.eigenpairs(system.mass, system.stiffness, count, problem.factor)
        space.append(V)
    space.eigenvectors = count
    problem.stages.report("eigenvectors", count, count)
