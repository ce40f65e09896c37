"""The rope of scipy_rope.py as PETSc matrices, each rank with rows of its own.

    python demos/own_matrices/petsc_rope.py
    mpirun -n 2 python demos/own_matrices/petsc_rope.py

Any PETSc matrices with the same rows on the same ranks will do, whoever assembled them. Columns are PETSc vectors as
here, PETSc matrices, or NumPy blocks of the rows of this rank.
"""

import numpy as np
from checks import energy_gap, round_off, transfer_error
from petsc4py import PETSc

import fenics_rom as fr

n = 120
M, D, K = (PETSc.Mat().createAIJ((n, n), nnz=3) for _ in range(3))
for row in range(*K.getOwnershipRange()):
    M.setValue(row, row, 0.01)  # kg
    K.setValue(row, row, 2000.0)  # N/m
    for other in {max(row - 1, 0), min(row + 1, n - 1)} - {row}:
        K.setValue(row, other, -1000.0)
    D.setValue(row, row, 0.3 if row == n // 2 else 0.0)  # N s/m
for matrix in (M, D, K):
    matrix.assemble()
D.axpy(0.5, M, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
D.axpy(1e-4, K, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)


def hand(at: int) -> PETSc.Vec:
    """A force of 1 N, over some masses to both sides."""
    force = K.createVecRight()
    mine = np.arange(*force.getOwnershipRange())
    force.array[:] = np.exp(-(((mine - at) / 6) ** 2) / 2)
    force.scale(1 / force.sum())
    return force


middle = K.createVecRight()
middle.setValue(n // 2, 1.0)
middle.assemble()
contacts = {"pull": [hand(n // 4)], "shake": [hand(n - 20)]}
system = fr.System(mass=M, damping=D, stiffness=K, contacts=contacts, outputs={"middle": [middle]})
rom = fr.reduce(system, order=30)

body = fr.Simulator(rom, dt=1e-3)  # every rank has the whole reduced model
for _ in range(1000):
    body.step([1.0])

error = max(transfer_error(system, rom, name, [0.0, 2.0, 5.0, 10.0, 20.0]) for name in contacts)
if K.comm.rank == 0:
    print(f"{system.size} masses on {K.comm.size} ranks, middle at {body.displacement('middle')[0]:+.4f} m")
    print(f"energy account closes to {energy_gap(body):.1e}, transfer functions to {error:.1e}")
assert energy_gap(body) <= round_off(body)
assert error <= 1e-4
