"""From the shared space to the ROM: one basis Q of what the contact modes keep, and each mode diagonal in its own."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.environment import Environment
from fenics_rom.mechanics.readings import projected
from fenics_rom.reduction.common_basis import orthogonal_complement, pad_rows, split_like
from fenics_rom.reduction.problem import ReductionProblem
from fenics_rom.reduction.validation import validated
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.rom import Rom, diagonalized_span


@dataclass(frozen=True)
class RetainedBasis:
    """What one contact mode keeps, in the coordinates of the shared space."""

    span: Array  # (k, m) orthonormal
    directions: Array  # (k, m) what spans the same, by falling importance
    hankel_singular_values: Array  # σ (r,), r >= m; none where the method has none
    left_inverse: Array | None = None  # (m, k) oblique projection; only for switching = "oblique"


def joint_span(problem: ReductionProblem, retained: Mapping[str, RetainedBasis]) -> Array:
    """Orthonormal coordinates (k, r) of what the contact modes keep together, in the shared space."""
    size = problem.space.size
    joint = np.empty((size, 0))
    for basis in retained.values():
        if joint.shape[1] < size:
            joint = np.hstack([joint, orthogonal_complement(pad_rows(basis.span, size), joint)])
    return joint


def assemble_rom(
    problem: ReductionProblem, retained: Mapping[str, RetainedBasis], beyond: Array | None = None, *, method: str
) -> Rom:
    """Puts all contact modes into one M-orthonormal Q that diagonalizes K, with a validation for each.

    Args:
        problem: what is reduced.
        retained: of each contact mode.
        beyond: coordinates (k, s) of what Q is to hold besides, if there is something.
        method: its name.
    """
    system, space = problem.system, problem.space
    algebra, scene = system.algebra, system.scene
    with problem.stages("shared basis"):
        joint = joint_span(problem, retained)
        if beyond is not None and joint.shape[1] < space.size:
            joint = np.hstack([joint, orthogonal_complement(beyond, joint)])
        whole = space.subspace(np.eye(space.size))
        common = whole if joint.shape[1] == space.size else space.subspace(joint)
        U, κ = common.coordinates, common.eigenvalues
        Q = space.basis @ U
        inputs = [system.input_matrix(name) for name in retained]
        projected_inputs = split_like(algebra.inner(Q, np.hstack(inputs)), inputs)
        models, bases = {}, {}
        for (name, basis), QᵀB in zip(retained.items(), projected_inputs, strict=True):
            γ, C = diagonalized_span(κ, np.linalg.qr(U.T @ pad_rows(basis.span, space.size))[0])
            W = U @ C
            T = W.T @ pad_rows(basis.directions, space.size)
            bases[name] = W
            models[name] = ContactModel(
                eigenvalues=γ,
                damping=space.damping_in(W, γ),
                inputs=C.T @ QᵀB,
                contact_points=system.contact_points.get(name, np.empty(0, dtype=int)),
                coordinates=C,
                directions=np.linalg.qr(T / np.linalg.norm(T, axis=0))[0],
                hankel_singular_values=basis.hankel_singular_values,
                left_inverse=None if basis.left_inverse is None else T @ basis.left_inverse @ U,
            )
    with problem.stages("validation"):
        models = validated(problem, whole, models, bases)
    gathered, springs = algebra.gather(Q), None if system.springs is None else algebra.inner(Q, system.springs @ Q)
    return Rom(
        name=scene.name if scene else "system",
        method=method,
        switching=problem.switching,
        contact_models=models,
        actuators={name: columns.shape[1] for name, columns in system.actuators.items()},
        basis=gathered,
        readings={name: projected(reading, gathered) for name, reading in system.readings.items()},
        stiffness=κ,
        springs=None if springs is None else (springs + springs.T) / 2,
        loads={name: columns.shape[1] for name, columns in system.loads.items()},
        outputs={name: algebra.inner(C, Q) for name, C in system.outputs.items()},
        free=system.body.free,
        nodes=system.body.nodes,
        triangles=system.body.triangles,
        node_mass=system.body.node_mass,
        cells=system.body.cells,
        environment=scene.environment if scene else Environment(frame="moving" if system.moving_frame else "fixed"),
        contact_surfaces=system.body.contact_surfaces,
        surfaces=system.body.surfaces,
        points_between=system.body.points_between,
        scene_text=scene.text if scene else "",
        warnings=tuple(problem.messages),
        weighting=problem.weighting,
        stages=problem.stages.done,
    )
