"""Contact points that are held back by forces found in the same step, compiled: `actuator_forces.PointsHeldBack`."""

from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.mechanics.compiled.copying import copy, fill
from fenics_rom.runtime.compiled.small_matrices import factor, solve_rows


@jit_part
def hold_back(free: Array, X: Array, W: Array, holds: Array, held: Array) -> bool:
    """Sets the Delassus operator of points that are held back, free - X W⁻¹ Xᵀ; whether there is one.

    Args:
        free: that of points that are not, (3P, 3P).
        X: what forces do to them, Xᵀ (n, 3P).
        W: of the forces (n, n).
        holds: 1 of those that hold them (n,).
        held: set, (3P, 3P).
    """
    U, rows = W.copy(), X.copy()
    for k in range(len(holds)):
        for j in range(len(holds)):
            if not (holds[k] and holds[j]):
                U[k, j] = 1.0 if k == j else 0.0
        if not holds[k]:
            fill(rows[k], 0.0)
    if not factor(U):
        return False
    solve_rows(U, rows)
    copy(free, held)
    for k in range(len(rows)):
        row = rows[k]
        for i in range(len(held) if holds[k] else 0):
            share, into = row[i], held[i]
            for j in range(len(into)):
                into[j] -= share * row[j]
    return True
