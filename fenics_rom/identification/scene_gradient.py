"""How a number that comes of a scene's run changes with material and damping, by the adjoint of the run's steps.

The run is that of `fr.simulate(scene)`, on a basis Q of what pushes and what is read (`make_basis`), with M, D and K
affine in the values θ. With A = 2/h M + D + h/2 K a step is A v̂ = f + 2/h M v - K x, x⁺ = x + h v̂, v⁺ = 2 v̂ - v, and
backwards

    y = A⁻¹ (h μ_x + 2 μ_v),    μ_x - K y and 2/h M y - μ_v before it,    ∂J/∂θ = Σ y·(∂f - ∂A v̂ + 2/h ∂M v - ∂K x),

to which comes what energies ½ vᵀMv + ½ xᵀKx owe to θ themselves.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError, StepError, check_known, check_type
from fenics_rom.fem.assemble import assemble
from fenics_rom.fem.fibres import has_fibres
from fenics_rom.identification.affine import AffineSystem, Matrices
from fenics_rom.identification.experiment import Experiment, run_experiment
from fenics_rom.identification.marker_data import Marker
from fenics_rom.identification.parameters import is_tilting, select_parameters, values_of
from fenics_rom.identification.reduced_model import ReducedModel, make_basis, step_operator
from fenics_rom.runtime.differentiation.gradient import Objective, checked_slopes
from fenics_rom.scene.scene import Scene

NOT_LINEAR = ("contact", "large_deformation", "viscoelasticity", "point_masses", "rigid_parts")


@dataclass(frozen=True, eq=False)
class SceneGradient:
    """What an objective J of a scene's run is, and how it changes.

    Attributes:
        value: J.
        derivatives: with each parameter, by its name, per unit of it.
        order: of the reduced model that was gone through.

    Example:
        >>> slow = lambda outputs, energies: (energies[-1], {}, np.eye(len(energies))[-1])
        >>> gradient = fr.differentiate_scene(scene, slow, parameters=["young", "beta"])
        >>> list(gradient.derivatives)
        ['young', 'beta']
    """

    value: float
    derivatives: Mapping[str, float]
    order: int


def differentiate_scene(
    scene: Scene, objective: Objective, *, parameters: Sequence[str] | None = None, outputs: Sequence[str] | None = None
) -> SceneGradient:
    """Value and gradient of an objective of `fr.simulate(scene)` with material and damping.

    Costs one run of a reduced model and one back, however many parameters there are, besides the reduction. Every rank
    must call it.

    Args:
        scene: linear, with a run that begins at rest.
        objective: as in `differentiate`, of what is there after each step.
        parameters: names as in `identify`: "young", "rubber.beta", "tilt", ...; None: all that a motion depends on.
        outputs: names of those that the objective gets; None: all.

    Raises:
        SceneError: the scene is not linear, or has no such parameter.
        StepError: no such output, or derivatives of another shape, or that are not finite.

    Example:
        >>> swing = lambda outputs, energies: (outputs["tip"][-1, 0, 2], {}, None)
        >>> fr.differentiate_scene(scene, swing, parameters=["density"]).order > 0
        True
    """
    check_type("differentiate_scene", scene, Scene, "fr.read_scene(file)")
    for effect in NOT_LINEAR:
        if getattr(scene.effects, effect):
            raise SceneError(f"{scene.source}: effects.{effect}: use linear bodies without")
    if has_fibres(scene):
        raise SceneError(f"{scene.source}: use bodies without fibres, membranes and cables")
    if scene.effects.temperature:
        raise SceneError(
            f"{scene.source}: effects.temperature: what it does grows with the stiffness; use a scene without"
        )
    if scene.frame == "moving":
        raise SceneError(f"{scene.source}: frame = 'moving': use linear bodies, with frame = 'fixed'")
    if scene.effects.inertia is None or scene.run is None or scene.run.initial is not None:
        raise SceneError(f"{scene.source}: use a scene with inertia and a run that begins at rest")
    scene.environment.check_forces_given("a gradient")
    names = tuple(scene.outputs if outputs is None else outputs)
    for name in names:
        check_known("output", name, scene.outputs, StepError)
    sought, θ = select_parameters(scene, parameters, moving=True), values_of(scene)
    affine = AffineSystem(scene)
    rows = {name: affine.plain.outputs[name].shape[1] for name in names}
    markers = [Marker(name, row // 3, row % 3) for name, count in rows.items() for row in range(count)]
    experiment = run_experiment(scene, affine.plain, markers)
    model = ReducedModel(affine.parts(make_basis(assemble(scene), experiment, tilting=is_tilting(sought))))
    directions = []
    for parameter in sought:
        dθ = np.zeros_like(θ)
        dθ[list(parameter.rows), parameter.column] = 1.0
        directions.append(dθ)
    value, slopes = gradient_of(model, experiment, θ, directions, objective, rows)
    derivatives = {parameter.name: slope for parameter, slope in zip(sought, slopes.tolist(), strict=True)}
    return SceneGradient(value, derivatives, model.order)


def gradient_of(
    model: ReducedModel,
    experiment: Experiment,
    θ: Array,
    directions: Sequence[Array],
    objective: Objective,
    rows: Mapping[str, int],
) -> tuple[float, Array]:
    """J of a model's run, and its derivatives in directions of θ, (directions,).

    `rows`: number of rows of each output that the objective gets, by name.
    """
    states, k, h = model.states(experiment, θ), model.order, experiment.dt
    x, v = states[1:, :k], states[1:, k:]
    at = model.parts.at(θ)
    C = np.concatenate([np.empty((0, k)), *(model.parts.outputs[name] for name in rows)])
    energies = _energies(at, x, v)
    parts = np.split(x @ C.T, np.cumsum(list(rows.values()))[:-1], axis=1) if rows else []
    given = {name: part.reshape(len(x), -1, 3) for name, part in zip(rows, parts, strict=True)}
    value, slopes, energy_slopes = checked_slopes(objective, given, energies)

    read = slopes @ C + energy_slopes[:, None] * (x @ at.stiffness)
    read_v = energy_slopes[:, None] * (v @ at.mass)
    M, K, inverse = at.mass, at.stiffness, np.linalg.inv(step_operator(at, h))
    μ_x, μ_v, y = np.zeros(k), np.zeros(k), np.empty((len(x), k))
    for step in reversed(range(len(x))):
        μ_x, μ_v = μ_x + read[step], μ_v + read_v[step]
        y[step] = inverse @ (h * μ_x + 2 * μ_v)
        μ_x, μ_v = μ_x - K @ y[step], 2 / h * M @ y[step] - μ_v
    along = np.empty(len(directions))
    for place, dθ in enumerate(directions):
        pushed = float((y * model.pushes(experiment, θ, dθ, states)).sum())
        along[place] = pushed + energy_slopes @ _energies(model.parts.along(θ, dθ), x, v)
    return value, along


def _energies(matrices: Matrices, x: Array, v: Array) -> Array:
    """½ vᵀMv + ½ xᵀKx after each step, (steps,), J; of derivatives, theirs."""
    kinetic = np.einsum("nk,nk->n", v @ matrices.mass, v)
    energies: Array = (kinetic + np.einsum("nk,nk->n", x @ matrices.stiffness, x)) / 2
    return energies
