"""What strains of volume that are averaged at the nodes would do for elements of degree 1 near ν = 0.5.

python tests/hard/unlocked.py

Node-based uniform dilatation (Bonet & Burton 1998): K = K_μ + λ Dᵀ V⁻¹ D with D_a = ∫ φ_a div and V_a = ∫ φ_a, which
is definite as K_μ is. Printed are the error of a thick beam's tip and the numbers in a row of K, beside those of
elements of degree 2 on as many nodes.
"""

import sys
from pathlib import Path

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg

sys.path.append(str(Path(__file__).parents[2] / "demos" / "hard_cases"))
from boxes import box, brick_cells
from cases_material import PUSH, THICK
from measures import at_rest

YOUNG = 1e6  # Pa


def averaged(bricks: tuple[int, int, int], ν: float) -> tuple[float, float]:
    """Displacement of the tip at rest, m, and numbers in a row of K."""
    μ = YOUNG / 2 / (1 + ν)
    λ = 2 * μ * ν / (1 - 2 * ν)
    system = box(THICK, bricks, young=2 * μ, poisson=0.0)  # of which λ is 0
    rows, columns, values = system.stiffness.mat.getValuesCSR()
    Kμ = sp.csr_matrix((values, columns, rows))
    points, cells = brick_cells(bricks)
    corners = (points * THICK)[cells]
    edges = corners[:, 1:] - corners[:, :1]
    volume = np.abs(np.linalg.det(edges)) / 6
    gradients = np.linalg.inv(edges).transpose(0, 2, 1)
    gradients = np.concatenate([-gradients.sum(axis=1, keepdims=True), gradients], axis=1)  # (C, 4, 3)
    div = (volume[:, None, None] / 4 * gradients).reshape(-1, 12)
    freedoms = (3 * cells[:, :, None] + np.arange(3)).reshape(-1, 12)
    where = np.repeat(cells, 12, axis=1).ravel(), np.tile(freedoms, 4).ravel()
    D = sp.csr_matrix((np.tile(div, 4).ravel(), where), shape=(len(points), 3 * len(points)))[:, system.body.free]
    V = np.bincount(cells.ravel(), np.repeat(volume / 4, 4))
    K = (Kμ + λ * D.T @ sp.diags(1 / V) @ D).tocsc()
    f = system.input_matrix("right") @ PUSH
    return float(f @ scipy.sparse.linalg.spsolve(K, f)) / PUSH[2], K.nnz / K.shape[0]


def main() -> None:
    """See above."""
    for ν in (0.3, 0.49, 0.4999):
        reference = at_rest(box(THICK, (12, 4, 4), degree=2, poisson=ν), "right", PUSH)[2]
        quadratic = box(THICK, (9, 3, 3), degree=2, poisson=ν)
        tip, numbers = averaged((18, 6, 6), ν)
        others = quadratic.stiffness.mat.getInfo()["nz_used"] / quadratic.size
        gap = at_rest(quadratic, "right", PUSH)[2] / reference - 1
        print(f"ν = {ν}: degree 1, averaged: {tip / reference - 1:.1%}, {numbers:.0f} numbers in a row of K;", end=" ")
        print(f"degree 2: {gap:.1%}, {others:.0f}")


if __name__ == "__main__":
    main()
