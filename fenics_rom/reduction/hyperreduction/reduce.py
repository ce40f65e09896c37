"""Reduction where the scene names large_deformation: a basis, few points, forces that follow, and what is wrong."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from fenics_rom.reduction.checkpoint import Checkpoint
from fenics_rom.reduction.hyperreduction.basis import retained_basis
from fenics_rom.reduction.hyperreduction.cubature import fit_cubature
from fenics_rom.reduction.hyperreduction.follower_loads import project_pressures, project_tendons
from fenics_rom.reduction.hyperreduction.modal_derivatives import modal_derivatives
from fenics_rom.reduction.hyperreduction.training import TrainingData, trained
from fenics_rom.reduction.hyperreduction.validation import validation_error
from fenics_rom.reduction.problem import ReductionProblem
from fenics_rom.reduction.projection import assemble_rom
from fenics_rom.rom.deformation import ReducedDeformation
from fenics_rom.rom.rom import ContactModel, Rom
from fenics_rom.system.protocols import Array, Operator

BASES: dict[str, Callable[[ReductionProblem, Checkpoint], TrainingData]] = {
    "trained": trained,
    "modal+derivatives": modal_derivatives,
}


def hyperreduce(problem: ReductionProblem, method: str, tolerance: float, checkpoint: Checkpoint) -> Rom:
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
    training = BASES[method](problem, checkpoint)
    with problem.stages("shared basis"):
        retained = retained_basis(problem, training.columns)
    rom = _in_one_basis(problem, assemble_rom(problem, dict.fromkeys(problem.contacts, retained), method=method))
    W = rom.basis[system.algebra.rows()]
    states = system.algebra.inner(W, system.mass @ training.shapes)
    body = _deformation(problem, W, rom.stiffness, states, tolerance)
    rom = replace(rom, deformation=body)
    if training.held_out:
        with problem.stages("validation"):
            error = max(validation_error(rom, system, run, shapes) for run, shapes in training.held_out)
        rom = replace(rom, deformation=replace(body, validation_error=error))
    return replace(rom, stages=problem.stages.done)


def _in_one_basis(problem: ReductionProblem, rom: Rom) -> Rom:
    """Contact modes that span the shared basis, in it: they differ by their inputs alone."""
    unit = np.eye(len(rom.stiffness))
    models = {name: _in_basis(problem, rom.stiffness, model, unit) for name, model in rom.contact_models.items()}
    return replace(rom, contact_models=models)


def _in_basis(problem: ReductionProblem, κ: Array, model: ContactModel, unit: Array) -> ContactModel:
    """A model whose coordinates are orthogonal, in the shared basis itself."""
    C, D = model.coordinates, model.damping
    if D.ndim == 2:
        D = C @ D @ C.T
        D = (D + D.T) / 2
    else:
        assert problem.system.rayleigh is not None
        α, β = problem.system.rayleigh
        D = α + β * κ
    return replace(
        model, eigenvalues=κ, damping=D, inputs=C @ model.inputs, coordinates=unit, directions=C @ model.directions
    )


def _deformation(problem: ReductionProblem, W: Array, γ: Array, states: Array, tolerance: float) -> ReducedDeformation:
    """What the ROM gets beside its linear model, on every rank."""
    system = problem.system
    body, algebra = system.deformation, system.algebra
    assert body is not None
    assert system.scene is not None
    with problem.stages("cubature"):
        gradients = body.gradients(W)
        sampled = fit_cubature(body, algebra, gradients, γ, states, tolerance)
    with problem.stages("forces that follow"):
        pressures = project_pressures(body, algebra, W, system.scene.effects.pressure)
        tendons = project_tendons(body, algebra, W)

    def gathered(values: Array) -> Array:
        """Values (K here, ...) of the kept points of all ranks."""
        return algebra.gather(np.ascontiguousarray(values))

    def projected(operator: Operator | None) -> Array:
        if operator is None:
            return np.zeros((len(γ), len(γ)))
        matrix = algebra.inner(W, operator @ W)
        return (matrix + matrix.T) / 2

    here = sampled.points
    return ReducedDeformation(
        law=body.law,
        gradients=gathered(gradients[:, :, here].transpose(2, 0, 1, 3)).transpose(1, 2, 0, 3),
        weights=gathered(sampled.weights * body.weights[here]),
        first_lame=gathered(body.first_lame[here]),
        shear=gathered(body.shear[here]),
        viscosity=gathered(body.viscosity[here]),
        external_damping=projected(body.external_damping),
        springs=projected(body.spring),
        training_radius=float(np.linalg.norm(states, axis=0).max()),
        points_of=int(algebra.total(len(body.weights))),
        cubature_error=sampled.error,
        pressures=pressures,
        tendons=tendons,
    )
