"""Reduction where the scene names large_deformation: a basis, few points, forces that follow, and what is wrong."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from fenics_rom.reduction.checkpoint import Checkpoint
from fenics_rom.reduction.hyperreduction.basis import kept_of
from fenics_rom.reduction.hyperreduction.cubature import cubature
from fenics_rom.reduction.hyperreduction.follower_loads import pressures_of, tendons_of
from fenics_rom.reduction.hyperreduction.modal_derivatives import modal_derivatives
from fenics_rom.reduction.hyperreduction.training import TrainingData, trained
from fenics_rom.reduction.hyperreduction.validation import validation_error
from fenics_rom.reduction.problem import ReductionProblem
from fenics_rom.reduction.projection import rom_of
from fenics_rom.rom.deformation import ReducedDeformation
from fenics_rom.rom.rom import ContactModel, Rom
from fenics_rom.system.protocols import Array, Operator

BASES: dict[str, Callable[[ReductionProblem, Checkpoint], TrainingData]] = {
    "trained": trained,
    "modal+derivatives": modal_derivatives,
}


def reduced(problem: ReductionProblem, method: str, tolerance: float, checkpoint: Checkpoint) -> Rom:
    """The ROM of a body that deforms largely; every rank must call it, every rank gets it.

    Args:
        problem: whose system has a deformation.
        method: one of BASES.
        tolerance: of the forces of the points that are kept, relative.
        checkpoint: keeps training runs.

    Raises:
        SceneError, SolverError, FileError: as the methods.
    """
    system = problem.system
    seen = BASES[method](problem, checkpoint)
    with problem.stages("shared basis"):
        kept = kept_of(problem, seen.columns)
    rom = _in_one_basis(problem, rom_of(problem, dict.fromkeys(problem.contacts, kept), method=method))
    W = rom.basis[system.algebra.rows()]
    states = system.algebra.inner(W, system.mass @ seen.shapes)
    body = _deformation(problem, W, rom.stiffness, states, tolerance)
    rom = replace(rom, deformation=body)
    if seen.held_out:
        with problem.stages("validation"):
            error = max(validation_error(rom, system, run, shapes) for run, shapes in seen.held_out)
        rom = replace(rom, deformation=replace(body, validation_error=error))
    return replace(rom, stages=problem.stages.done)


def _in_one_basis(problem: ReductionProblem, rom: Rom) -> Rom:
    """Contact modes that span the shared basis, in it: they differ by their inputs alone."""
    unit = np.eye(len(rom.stiffness))
    modes = {name: _in_basis(problem, rom.stiffness, mode, unit) for name, mode in rom.contact_models.items()}
    return replace(rom, contact_models=modes)


def _in_basis(problem: ReductionProblem, κ: Array, mode: ContactModel, unit: Array) -> ContactModel:
    """A mode whose coordinates are orthogonal, in the shared basis itself."""
    C, D = mode.coordinates, mode.damping
    if D.ndim == 2:
        D = C @ D @ C.T
        D = (D + D.T) / 2
    else:
        assert problem.system.rayleigh is not None
        α, β = problem.system.rayleigh
        D = α + β * κ
    return replace(
        mode, eigenvalues=κ, damping=D, inputs=C @ mode.inputs, coordinates=unit, directions=C @ mode.directions
    )


def _deformation(problem: ReductionProblem, W: Array, γ: Array, states: Array, tolerance: float) -> ReducedDeformation:
    """What the ROM gets beside its linear model, on every rank."""
    system = problem.system
    body, algebra = system.deformation, system.algebra
    assert body is not None
    assert system.scene is not None
    with problem.stages("cubature"):
        gradients = body.gradients(W)
        chosen = cubature(body, algebra, gradients, γ, states, tolerance)
    with problem.stages("forces that follow"):
        pressures = pressures_of(body, algebra, W, system.scene.effects.get("pressure", {}))
        tendons = tendons_of(body, algebra, W)

    def everywhere(values: Array) -> Array:
        """Values (K here, ...) of the kept points of all ranks."""
        return algebra.gather(np.ascontiguousarray(values))

    def projected(operator: Operator | None) -> Array:
        if operator is None:
            return np.zeros((len(γ), len(γ)))
        matrix = algebra.inner(W, operator @ W)
        return (matrix + matrix.T) / 2

    here = chosen.points
    return ReducedDeformation(
        law=body.law,
        gradients=everywhere(gradients[:, :, here].transpose(2, 0, 1, 3)).transpose(1, 2, 0, 3),
        weights=everywhere(chosen.weights * body.weights[here]),
        first_lame=everywhere(body.first_lame[here]),
        shear=everywhere(body.shear[here]),
        viscosity=everywhere(body.viscosity[here]),
        external_damping=projected(body.external_damping),
        springs=projected(body.spring),
        training_radius=float(np.linalg.norm(states, axis=0).max()),
        points_of=int(algebra.total(len(body.weights))),
        cubature_error=chosen.error,
        pressures=pressures,
        tendons=tendons,
    )
