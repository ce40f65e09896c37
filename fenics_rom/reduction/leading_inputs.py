"""Of the inputs of a contact mode that may be touched in many places the combinations that move the body most.

A basis of some order follows no more directions than it has, and with a force at every node of a skin there are
thousands. Their static shapes K⁻¹B have rapidly less mass: combinations beyond several times the order are left out.
"""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.reduction.common_basis import significant_eigenpairs
from fenics_rom.reduction.problem import ReductionProblem
from fenics_rom.system.columns import sum_of

FEWEST = 400  # inputs that are all taken, whatever the order
INPUTS_PER_DIRECTION = 4  # of the order: all of 900 inputs change σ up to the order by 5e-3 then, twice as many by 4e-4
OVERSAMPLING = 20  # random combinations beside so many


def leading_inputs(problem: ReductionProblem, name: str) -> Array:
    """All that can act in a contact mode (rows here, p), or the combinations of most mass at rest where p is large.

    Orthonormal combinations E of B, found by random ones that K⁻¹B draws closer once (Halko, Martinsson & Tropp 2011).
    Where a tolerance chooses the order all are taken.
    """
    system, p, order = problem.system, problem.system.count_forces(name), problem.order_of(name)
    if order is None or p <= max(FEWEST, (count := INPUTS_PER_DIRECTION * order) + OVERSAMPLING):
        return system.forces(name)
    problem.messages.append(
        f"contact mode {name!r}: of {p} inputs the {count} combinations that move the body most are looked "
        "at; singular values up to the order are known to about a percent, and more is neglected than their sum tells; "
        "the static and frequency response errors are of all inputs"
    )
    inner, M, solve, blocks = system.algebra.inner, system.mass, problem.factor.solve, list(system.force_blocks(name))

    def combined(E: Array) -> Array:
        return sum_of(system.forces(name, some) @ E[some] for some in blocks)

    def pulled(loads: Array) -> Array:
        return np.concatenate([inner(system.forces(name, some), loads) for some in blocks])

    with problem.stages("leading inputs"):
        random = np.random.default_rng(0).standard_normal((p, count + OVERSAMPLING))
        E = np.linalg.qr(pulled(solve(M @ solve(combined(random)))))[0]
        shapes = solve(combined(E))
        _, V = significant_eigenpairs(inner(shapes, M @ shapes))
        return combined(E @ V[:, :count])
