"""The high-fidelity solver: the only folder that imports dolfinx, PETSc and SLEPc."""
