"""The high-fidelity solver: the only folder that imports dolfinx, PETSc and SLEPc."""

import petsc4py

petsc4py.init(["fenics-rom", "-no_signal_handler"])  # PETSc would answer a closed pipe or Ctrl-C with a crash report
