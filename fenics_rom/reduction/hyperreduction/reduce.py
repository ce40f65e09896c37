"""Reduction where the scene names large_deformation: a basis, few points, forces that follow, and what is wrong."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError, StepError
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.fibres import LARGEST_EXPONENT, Fibres, pushed_along
from fenics_rom.mechanics.hyperelastic import principal_stretches
from fenics_rom.mechanics.isochoric import LAST_SHARE, isochoric_terms
from fenics_rom.mechanics.rubber_tests import check_stable
from fenics_rom.mechanics.voigt import VOIGT_SHEAR
from fenics_rom.reduction.balancing import choose_order
from fenics_rom.reduction.checkpoint import Checkpoint
from fenics_rom.reduction.common_basis import significant_eigenpairs
from fenics_rom.reduction.hyperreduction.cubature import fit_cubature
from fenics_rom.reduction.hyperreduction.frame_loads import framed
from fenics_rom.reduction.hyperreduction.modal_derivatives import modal_derivatives
from fenics_rom.reduction.hyperreduction.training import Run, TrainingData, is_free, trained
from fenics_rom.reduction.hyperreduction.training_loads import step_input, training_environment, without_valves
from fenics_rom.reduction.moving_frame import with_moving_frame
from fenics_rom.reduction.problem import ReductionProblem
from fenics_rom.reduction.projection import RetainedBasis, assemble_rom
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.deformation import (
    ReducedBar,
    ReducedDeformation,
    ReducedRim,
    ReducedTendon,
    TrainingRange,
    monomials,
    resultant,
)
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.moving_frame import MovingFrameStepper
from fenics_rom.runtime.steppers.selection import make_stepper
from fenics_rom.scene.fibres import HOLZAPFEL, QUADRATIC
from fenics_rom.system.protocols import Algebra, Deformation, Operator
from fenics_rom.system.rigid_modes import mass_orthonormal
from fenics_rom.system.system import System

TOLD_ERROR = 0.05  # of shapes in runs that were held out

BASES: dict[str, Callable[[ReductionProblem, Checkpoint], TrainingData]] = {
    "trained": trained,
    "modal+derivatives": modal_derivatives,
}


def hyperreduce(problem: ReductionProblem, whole: System, method: str, tolerance: float, checkpoint: Checkpoint) -> Rom:
    """The ROM of a body that deforms largely; every rank must call it, every rank gets it.

    The problem is of the elastic part of the `whole` body. The tolerance is of the forces of the points that are kept,
    relative; the checkpoint keeps training runs.
    """
    scene, problem = problem.system.scene, without_valves(problem)
    given = problem.system
    problem = framed(problem, free_spins=method != "trained")
    system = problem.system
    training = BASES[method](problem, checkpoint)
    if training.loads.frame_loads is not None and (told := training.loads.frame_loads.message):
        problem.messages.append(told)
    with problem.stages("shared basis"):
        retained = retained_basis(problem, training.columns)
    rom = assemble_rom(problem, dict.fromkeys(problem.contacts, retained), method=method)
    models = {name: _in_shared_basis(problem, rom.stiffness, model) for name, model in rom.contact_models.items()}
    rom = replace(rom, contact_models=models)
    W = rom.basis[system.algebra.rows()]
    states, *held_out = (
        system.algebra.inner(W, system.mass @ shapes)
        for shapes in (training.shapes, *(shapes for _, shapes in training.held_out))
    )
    body = _deformation(problem, W, rom.stiffness, states, tolerance)
    check_law(body, np.hstack([states, *held_out]))
    rom = replace(rom, deformation=body)
    if training.held_out:
        with problem.stages("validation"):
            rom = with_moving_frame(problem, rom, whole) if is_free(system) else rom
            error = max(validation_error(rom, system, *run, problem.messages) for run in training.held_out)
        if error > TOLD_ERROR:
            problem.messages.append(
                f"shapes are off by up to {100 * error:.3g} % in runs that the reduced model was not trained with: a "
                "larger order or a smaller cubature tolerance may help"
            )
        body = replace(body, validation_error=error)
    body = replace(body, trained=_training_range(body, training, np.hstack([states, *held_out])))
    if system is not given:
        rom = _with_inputs(rom, given)
    environment = rom.environment if scene is None else scene.environment
    stages, warnings = problem.stages.done, tuple(problem.messages)
    return replace(rom, deformation=body, environment=environment, stages=stages, warnings=warnings)


def _with_inputs(rom: Rom, system: System) -> Rom:
    """The ROM with the inputs of a system."""
    W, inner = rom.basis[system.algebra.rows()], system.algebra.inner
    models = {
        name: replace(model, inputs=inner(W, system.input_matrix(name))) for name, model in rom.contact_models.items()
    }
    return replace(rom, contact_models=models, loads={name: B.shape[1] for name, B in system.loads.items()})


def check_law(body: ReducedDeformation, states: Array) -> None:
    """Refuses a law that gives way at stretches that the kept points have in states q (m, s), without change of volume.

    Raises:
        SceneError: with the stretch.
    """
    _check_fibres(body, states)
    if not isochoric_terms(body.law):
        return
    stretches = np.concatenate([principal_stretches(body.strains(q)) for q in states.T])
    shapes = stretches / np.cbrt(np.prod(stretches, axis=1))[:, None]
    x = (shapes**2).sum(axis=1) - 3
    for term in isochoric_terms(body.law):
        if x.max() > LAST_SHARE * term.largest:
            raise SceneError(
                f"effects.large_deformation.constants: {body.law}: in training chains are stretched out: at a stretch "
                f"of {shapes[x.argmax()].max():.3g} I1 - 3 is {x.max():.3g}; the most is {LAST_SHARE} of "
                f"{term.largest:g}, beyond which the energy goes on as a parabola; give a larger Jm or less load"
            )
    try:
        check_stable(body.law, min(float(shapes.min()), 1.0), max(float(shapes.max()), 1.0))
    except ValueError as error:
        raise SceneError(f"effects.large_deformation.constants: {body.law} {error}") from None


def _check_fibres(body: ReducedDeformation, states: Array) -> None:
    """Refuses fibres that push harder than the shear modulus of what is around them in states q (m, s).

    From there on rubber (neo-Hookean exactly, others nearly) loses ellipticity: fibres fold within it. And such as are
    stretched beyond what their exponential is computed for.
    """
    has_shape = body.shear > 0
    for E in map(body.strains, states.T if body.fibres else ()):
        push, stretch = (values[has_shape] for values in pushed_along(body.fibres, E))
        share = push / body.shear[has_shape]
        if share.max(initial=0.0) > 1:
            raise SceneError(
                f"materials: in training fibres with law = {QUADRATIC!r} are pressed to a stretch of "
                f"{stretch[share.argmax()]:.4g}: they push with {share.max():.3g} times the shear modulus around them, "
                f"and would fold above 1; use law = {HOLZAPFEL!r}, whose fibres only pull, softer "
                "fibres, or less load"
            )
        for family in body.fibres:
            exponent = family.exponent(E)
            if exponent.max(initial=0.0) > LARGEST_EXPONENT:
                longest = float(np.sqrt(1 + 2 * family.strains(E)[exponent.argmax()]))
                raise SceneError(
                    f"materials: in training fibres with law = {HOLZAPFEL!r} are pulled to a stretch of {longest:.4g}: "
                    f"their exponent is {exponent.max():.3g}; the most is {LARGEST_EXPONENT:g}, beyond which "
                    "their energy goes on as a parabola; give less stiffening or less load"
                )


def _training_range(body: ReducedDeformation, training: TrainingData, states: Array) -> TrainingRange:
    """What a run is to be compared with: the loads, and the strains of the kept points in all states q (m, s) seen."""
    loads, frame = training.loads, training.loads.frame
    squares = [(E * E / VOIGT_SHEAR).sum(axis=0) for E in map(body.strains, states.T)]
    return TrainingRange(
        inputs=loads.inputs,
        pushes={name: resultant(push) for name, push in loads.pushes.items()},
        strains=training.overshoot * np.sqrt(np.max(squares, axis=0)),
        smoothing_time=loads.smoothing_time,
        **({} if frame is None else vars(frame)),
    )


def retained_basis(problem: ReductionProblem, columns: Array) -> RetainedBasis:
    """The leading left singular vectors of weighted columns (rows here, c) in the mass norm, as many as are asked for.

    The order of several contact modes is the largest, as they have one basis; a tolerance is the share of the sum of
    singular values that may be left out. What bars do to the body at rest is kept first: without it surfaces that are
    rigid could not turn far, as a sum of turned ones is not of their size.

    Raises:
        SceneError: the order leaves nothing beside bars.
    """
    inner, M = problem.system.algebra.inner, problem.system.mass
    of_bars = _shapes_of_bars(problem)
    bars = of_bars.shape[1]
    rest = columns - of_bars @ inner(of_bars, M @ columns) if bars else columns
    w, E = significant_eigenpairs(inner(rest, M @ rest))
    order = max(problem.order.values()) if isinstance(problem.order, Mapping) else problem.order
    if order is not None and order <= bars:
        raise SceneError(f"order = {order}: supports.rigid take {bars} of it; use more")
    m = choose_order(np.sqrt(w), None if order is None else order - bars, problem.tolerance)
    if len(w) < m:
        problem.messages.append(f"order {m + bars} was asked for, {len(w) + bars} directions were seen and kept")
    coordinates = problem.space.add(np.hstack([of_bars, rest @ (E[:, :m] / np.sqrt(w[:m]))]))
    span = np.linalg.qr(coordinates)[0]
    return RetainedBasis(span, coordinates, np.empty(0))


def _shapes_of_bars(problem: ReductionProblem) -> Array:
    """What each bar does to the body at rest, (rows here, bars), M-orthonormal."""
    system = problem.system
    bars = () if system.scene is None else system.scene.bars
    forces = np.hstack([np.empty((system.local_size, 0)), *(system.loads[name] for name in bars)])
    return mass_orthonormal(system.mass, problem.factor.solve(forces), system.algebra) if bars else forces


def _in_shared_basis(problem: ReductionProblem, κ: Array, model: ContactModel) -> ContactModel:
    """A model that spans the shared basis, in it: contact modes differ by their inputs alone then."""
    C, D = model.coordinates, model.damping
    if D.ndim == 2:
        D = C @ D @ C.T
        D = (D + D.T) / 2
    else:
        assert problem.system.rayleigh is not None
        α, β = problem.system.rayleigh
        D = α + β * κ
    inputs, directions = C @ model.inputs, C @ model.directions
    return replace(model, eigenvalues=κ, damping=D, inputs=inputs, coordinates=np.eye(len(κ)), directions=directions)


def _deformation(problem: ReductionProblem, W: Array, γ: Array, states: Array, tolerance: float) -> ReducedDeformation:
    """What the ROM gets beside its linear model, on every rank."""
    system, body, algebra = problem.system, problem.deformation, problem.system.algebra
    assert system.scene is not None
    with problem.stages("cubature"):
        gradients = body.gradients(W)
        sampled = fit_cubature(body, algebra, gradients, γ, states, tolerance)
    with problem.stages("forces that follow"):
        effects = system.scene.effects
        pressures = project_pressures(body, algebra, W, [*effects.pressure, *effects.driven_support])
        tendons = project_tendons(body, algebra, W)
        bars = project_bars(body, algebra, W) if system.scene.bars else {}
        rims = {} if system.moving_frame is None else project_rims(body, algebra, W)

    def gathered(values: Array) -> Array:
        """Values (K here, ...) of the kept points of all ranks."""
        return algebra.gather(np.ascontiguousarray(values))

    def projected(operator: Operator | None) -> Array:
        if operator is None:
            return np.zeros((len(γ), len(γ)))
        matrix = algebra.inner(W, operator @ W)
        return (matrix + matrix.T) / 2

    here = sampled.points
    first = algebra.row_offset(len(here))
    fibres = [
        Fibres(
            family.law,
            gathered(first + family.points),
            gathered(family.structure.T).T,
            gathered(family.modulus),
            gathered(family.stiffening),
        )
        for family in body.material.at(here).fibres
    ]
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
        bars=bars,
        rims=rims,
        fibres=tuple(family for family in fibres if len(family.points)),
    )


def project_pressures(body: Deformation, algebra: Algebra, W: Array, names: Iterable[str]) -> dict[str, Array]:
    """Forces of 1 Pa as polynomials of q, (m, 1 + m + m (m+1)/2) for `monomials(q)`.

    ∫ cof(F) N · δ dS is of second degree in the displacement. So values at rest, at plus and minus each basis vector
    and at each sum of two are all there is to know (polarisation). W is the basis (rows here, m).
    """
    names, m = list(names), W.shape[1]
    if not names:
        return {}
    length = float(algebra.inner(np.ones((len(body.weights), 1)), body.weights[:, None])[0, 0]) ** (1 / 3)
    unit = length / algebra.maximum(np.abs(W).max(axis=0, initial=0.0))  # of q, for entries of all degrees alike

    def forces(q: Array) -> Array:
        """Of all pressures, (pressures, m)."""
        columns = body.follower(W @ (unit * q))
        return algebra.inner(np.hstack([columns[name] for name in names]), W)

    e = np.eye(m)
    at_rest = forces(np.zeros(m))
    plus, minus = (np.array([forces(sign * e[i]) for i in range(m)]) for sign in (1.0, -1.0))
    linear, quadratic = (plus - minus) / 2, (plus + minus) / 2 - at_rest
    mixed = [
        quadratic[i] if i == j else forces(e[i] + e[j]) - at_rest - linear[i] - linear[j] - quadratic[i] - quadratic[j]
        for i, j in zip(*np.triu_indices(m), strict=True)
    ]
    coefficients = np.stack([at_rest, *linear, *mixed], axis=-1) / monomials(unit)
    return dict(zip(names, coefficients, strict=True))


def project_tendons(body: Deformation, algebra: Algebra, W: Array) -> dict[str, ReducedTendon]:
    """Tendons through points of the body, whose displacements are shapesᵀW q."""
    return {name: ReducedTendon(points, algebra.inner(shapes, W)) for name, (points, shapes) in body.tendons.items()}


def project_bars(body: Deformation, algebra: Algebra, W: Array) -> dict[str, ReducedBar]:
    """The same of rigid bars."""
    return {name: ReducedBar(points, algebra.inner(shapes, W)) for name, (points, shapes) in body.bars.items()}


def project_rims(body: Deformation, algebra: Algebra, W: Array) -> dict[str, ReducedRim]:
    """Edges of surfaces under pressure, of those that can move; the others keep the wrench that they have at rest."""
    found = {}
    for name, (points, pieces, *shapes) in body.rims.items():
        moving = [algebra.inner(of, W) for of in shapes]
        if any(of.any() for of in moving):
            found[name] = ReducedRim(points, pieces, *moving)
    return found


def validation_error(rom: Rom, system: System, run: Run, shapes: Array, messages: list[str]) -> float:
    """Largest difference to the full model's shapes (rows here, s) in a run, as a share of the largest, in mass norm.

    Where the reduced model does not converge it stays where it is, and that is said in the messages.
    """
    W, inner = rom.basis[system.algebra.rows()], system.algebra.inner
    Mx = system.mass @ shapes
    squares, projections = np.diag(inner(shapes, Mx)), inner(W, Mx)  # of |x - W q|² = |x|² - |WᵀMx|² + |WᵀMx - q|²
    assert rom.deformation is not None
    unwatched = replace(rom, deformation=replace(rom.deformation, trained=None))  # it is for the caller to judge
    reduced = _reduced_states(unwatched, run, messages)
    if not squares.max():
        return 0.0  # nothing moves
    outside = np.maximum(squares - (projections**2).sum(axis=0), 0.0)
    errors = outside + ((projections - reduced) ** 2).sum(axis=0)
    return float(np.sqrt(errors.max() / squares.max()))


def _reduced_states(rom: Rom, run: Run, messages: list[str]) -> Array:
    """q (m, s) of the reduced model in a run, as far as it goes and from there on the last."""
    stepper = make_stepper(rom, run.dt or 1.0, _acting(rom, run), None, None if run.dt is None else "newton")
    if isinstance(stepper, MovingFrameStepper) and run.start is not None:
        stepper.place(run.start)
    snapshot_steps, states, m = set(run.snapshot_steps()), [], len(rom.stiffness)
    q, stuck = np.zeros(m), False
    for step, (contact, u) in enumerate(run.steps):
        try:
            if not stuck:
                stepper.switch(contact)
                stepper.step(step_input(rom.environment, u))
                q = stepper.state[:m] / np.sqrt(rom.stiffness)
        except StepError as error:
            stuck = True
            messages.append(f"the reduced model stops at step {step + 1} of {len(run.steps)} of {run.title}: {error}")
        if step in snapshot_steps:
            states.append(q)
    return np.column_stack(states)


def _acting(rom: Rom, run: Run) -> ActiveEnvironment:
    """What acts in a run beside its inputs: on a free body in its frame, on others where they are held."""
    frame = "fixed" if run.start is None else "moving"
    return ActiveEnvironment(replace(training_environment(rom.environment), frame=frame, base_path=None))
