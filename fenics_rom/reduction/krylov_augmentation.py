"""Columns that augment every contact mode's Krylov space: dashpots, and outputs where those count."""

from dataclasses import dataclass

import numpy as np

from fenics_rom.reduction.low_rank_damping import low_rank_damping
from fenics_rom.reduction.problem import ReductionProblem
from fenics_rom.system.protocols import Array


@dataclass(frozen=True)
class KrylovAugmentation:
    """Columns that belong to the space of every contact mode.

    Attributes:
        columns: (rows here, c).
        complete: whether inputs and these columns lead to all resolvents by zero shifts alone, as they do where D is
            proportional but for dashpots.
    """

    columns: Array
    complete: bool


def find_augmentation(problem: ReductionProblem) -> KrylovAugmentation:
    """Finds the dashpots, and adds the columns of the outputs where those are what counts."""
    system = problem.system
    dashpots = low_rank_damping(system)
    columns = [np.empty((system.local_size, 0)) if dashpots is None else dashpots]
    if problem.weighting == "outputs":
        columns += system.outputs.values()
    return KrylovAugmentation(np.hstack(columns), dashpots is not None)
