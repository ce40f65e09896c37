"""Method "pod": proper orthogonal decomposition of full-order runs, one for each contact mode."""

from collections.abc import Iterator
from contextlib import closing

import numpy as np
from numpy import ndarray as Array

from fenics_rom.reduction.common_basis import significant_eigenpairs
from fenics_rom.reduction.problem import RankedBasis, ReductionProblem
from fenics_rom.system.protocols import Factor
from fenics_rom.system.system import System

PERIODS = 3  # of the slowest motion that the inputs excite
STEPS_PER_PERIOD = 50


def pod(problem: ReductionProblem) -> Iterator[tuple[str, RankedBasis]]:
    """Each contact mode's columns are switched on at rest, one run each; displacements and velocities are snapshots.

    In the mass norm, velocities divided by the frequency of the slowest motion, which makes both alike. The runs are
    passive midpoint integration, paper (2)-(4), of all columns of a contact mode at once.
    """
    system = problem.system
    statics = {}
    for name in problem.contacts:
        with problem.stages("solves with K"):
            statics[name] = problem.factor.solve(system.forces(name))
    slowest = min(_frequency(system, shapes) for shapes in statics.values())
    h = 2 * np.pi / slowest / STEPS_PER_PERIOD
    with problem.stages("factorisation of the step"):
        factor = system.algebra.factor((2 / h, system.mass), (1.0, system.damping), (h / 2, system.stiffness))
    with closing(factor):
        for name in problem.contacts:
            with problem.stages("full-order runs"):
                snapshots = _snapshots(system, factor, system.forces(name), h, slowest)
            with problem.stages("orthonormal basis"):  # by left singular vectors in the mass norm (Sirovich 1987)
                w, E = significant_eigenpairs(system.algebra.inner(snapshots, system.mass @ snapshots))
                basis = problem.directions(snapshots @ (E / np.sqrt(w)), np.sqrt(w))
            yield name, basis


def _frequency(system: System, shapes: Array) -> float:
    """Lowest Rayleigh quotient of the static shapes, as rad/s: their slowest motion, from above."""
    inner = system.algebra.inner
    stiffness, mass = inner(shapes, system.stiffness @ shapes), inner(shapes, system.mass @ shapes)
    return float(np.sqrt((np.diag(stiffness) / np.diag(mass)).min()))


def _snapshots(system: System, factor: Factor, B: Array, h: float, ω: float) -> Array:
    """x and v/ω of the response to unit steps, (rows here, 2 p PERIODS STEPS_PER_PERIOD)."""
    x, v = np.zeros_like(B), np.zeros_like(B)
    snapshots = []
    for _ in range(PERIODS * STEPS_PER_PERIOD):
        mid = factor.solve(B + 2 / h * (system.mass @ v) - system.stiffness @ x)
        x, v = x + h * mid, 2 * mid - v
        snapshots += [x, v / ω]
    return np.hstack(snapshots)
