"""How far a reduced model is from full-order runs that it has not seen."""

import numpy as np

from fenics_rom.errors import StepError
from fenics_rom.reduction.hyperreduction.training import Run
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.equilibrium import Equilibrium
from fenics_rom.runtime.steppers.newton import Newton
from fenics_rom.system.protocols import Array
from fenics_rom.system.system import System


def validation_error(rom: Rom, system: System, run: Run, shapes: Array) -> float:
    """Largest difference between shapes in a run, as a share of the largest, in the mass norm.

    It is infinite where the reduced model does not converge.

    Args:
        rom: the reduced model.
        system: the full one.
        run: its loads.
        shapes: (rows here, s) of the full model.
    """
    W, inner = rom.basis[system.algebra.rows()], system.algebra.inner
    Mx = system.mass @ shapes
    squares, projections = np.diag(inner(shapes, Mx)), inner(W, Mx)  # of |x - W q|² = |x|² - |WᵀMx|² + |WᵀMx - q|²
    try:
        reduced = _simulated(rom, run)
    except StepError:
        return float("inf")
    outside = np.maximum(squares - (projections**2).sum(axis=0), 0.0)
    errors = outside + ((projections - reduced) ** 2).sum(axis=0)
    return float(np.sqrt(errors.max() / squares.max()))


def _simulated(rom: Rom, run: Run) -> Array:
    """q (m, s) of the reduced model in a run."""
    kernel = (Equilibrium if run.dt is None else Newton)(rom, None, None)
    kernel.set_time_step(1.0 if run.dt is None else run.dt)
    snapshot_steps, states, m = set(run.snapshot_steps()), [], len(rom.stiffness)
    for step, (contact, u) in enumerate(run.steps):
        kernel.enter(rom.contact_models[contact])
        kernel.step(u)
        if step in snapshot_steps:
            states.append(kernel.state[:m] / np.sqrt(rom.stiffness))
    return np.column_stack(states)
