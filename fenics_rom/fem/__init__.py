"""The high-fidelity solver: the only folder that imports dolfinx, PETSc and SLEPc."""

from contextlib import suppress

with suppress(ModuleNotFoundError):
    import dolfinx_solver  # noqa: F401 - FEniCSx as a wheel: loads MPI before all that is linked to it
import petsc4py

from fenics_rom.fem.jit_cache import provide_jit_cache

provide_jit_cache()  # before dolfinx is imported

# PETSc would answer a closed pipe or Ctrl-C with a crash report, and later releases than 3.18 would name options that
# nothing has read among the results
petsc4py.init(["fenics-rom", "-no_signal_handler", "-options_left", "no"])
