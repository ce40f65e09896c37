"""Branches of a material that relaxes, in strains that are carried along, compiled: `mechanics.viscoelasticity`.

Of each of N branches there is its strain w and C₀ w, (N, 2, size), and a column of coefficients (8, N).
"""

from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.mechanics.compiled.copying import copy
from fenics_rom.runtime.compiled.small_matrices import dot, multiply

PULL, KEPT, MOVED, DECAY, GAIN, VISCOUS, NUMERICAL, RATIO = range(8)  # rows, as `MaxwellBranches.numbers` has them


@jit_part
def set_force(share: Array, strain: Array, force: Array) -> None:
    """Sets the force (size,) of a strain: a share (size, size) of it, or itself where that is (0, 0)."""
    if len(share) > 0:
        multiply(share, strain, force)
    else:
        copy(strain, force)


@jit_part
def set_forces(share: Array, branches: Array) -> None:
    """Sets those of the strains of branches."""
    for b in range(len(branches)):
        set_force(share, branches[b, 0], branches[b, 1])


@jit_part
def add_pull(numbers: Array, branches: Array, stress: Array) -> None:
    """Adds the stress (size,) that the strains at the start of a step add in it."""
    add_row_of_pull(numbers, branches, 1, stress)


@jit_part
def add_row_of_pull(numbers: Array, branches: Array, row: int, to: Array) -> None:
    """Adds (size,) what the strains at the start of a step add in it, of row 0, or its stress, of row 1."""
    for b in range(len(branches)):
        size, own = numbers[PULL, b], branches[b, row]
        for k in range(len(own)):
            to[k] += size * own[k]


@jit_part
def step_branches(numbers: Array, branches: Array, rate: Array, stress: Array) -> float:
    """Takes a step at a rate of the strains (size,) and its stress; what it dissipates, J."""
    heat = 0.0
    for b in range(len(branches)):
        w, f, viscous, changed = branches[b, 0], branches[b, 1], 0.0, 0.0
        kept, moved, decay, gain = numbers[KEPT, b], numbers[MOVED, b], numbers[DECAY, b], numbers[GAIN, b]
        for k in range(len(w)):
            viscous += (kept * w[k] + moved * rate[k]) * (kept * f[k] + moved * stress[k])
            w_after, f_after = decay * w[k] + gain * rate[k], decay * f[k] + gain * stress[k]
            changed += (w_after - w[k]) * (f_after - f[k])
            w[k], f[k] = w_after, f_after
        heat += numbers[VISCOUS, b] * viscous + numbers[NUMERICAL, b] * changed
    return heat


@jit_part
def growth(numbers: Array, branches: Array, gap: Array, stress: Array) -> tuple[float, float]:
    """a and b, J, of s a + ½ s² b that is stored more where all strains grow by s gap (size,), with its stress."""
    along, square, ratios = 0.0, dot(gap, stress), 0.0
    for b in range(len(branches)):
        ratios += numbers[RATIO, b]
        along += numbers[RATIO, b] * dot(branches[b, 1], gap)
    return along, ratios * square


@jit_part
def move(branches: Array, share: float, gap: Array, stress: Array) -> None:
    """Lets all strains, and their stresses, grow by a share of a gap (size,)."""
    for b in range(len(branches)):
        for k in range(len(gap)):
            branches[b, 0, k] += share * gap[k]
            branches[b, 1, k] += share * stress[k]


@jit_part
def stored_in(numbers: Array, branches: Array) -> float:
    """½ Σ g w·C₀ w, J."""
    stored = 0.0
    for b in range(len(branches)):
        stored += numbers[RATIO, b] / 2 * dot(branches[b, 0], branches[b, 1])
    return stored
