"""`identify`: from a scene and marker data to the scene that fits them best, and how well its numbers are known."""

import warnings
from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import DataError, FenicsRomWarning, SceneError, SolverError
from fenics_rom.fem.assemble import assemble
from fenics_rom.fem.simulate import simulate
from fenics_rom.identification.affine import AffineSystem
from fenics_rom.identification.experiment import Experiment, make_experiment
from fenics_rom.identification.fit import MAX_BASES, Fit, FitProblem, fit_parameters
from fenics_rom.identification.marker_data import Data, Equilibria, Motion, read_markers
from fenics_rom.identification.parameters import (
    Parameter,
    directions_at,
    parameters_of,
    scene_with,
    select_parameters,
    values_of,
)
from fenics_rom.identification.reduced_model import ReducedModel, make_basis
from fenics_rom.identification.result import MAX_SHIFT, NEGLIGIBLE_SHARE, Estimate, Given, Identification, list_doubts
from fenics_rom.identification.uncertainty import (
    Unidentifiable,
    correlations,
    find_unidentifiable,
    interval_half_widths,
    noise_deviation,
    t_quantile,
)
from fenics_rom.io.progress import Report, silent
from fenics_rom.scene.scene import Scene
from fenics_rom.system.system import System


def identify(
    scene: Scene, data: Sequence[str | Path | Data], *, parameters: Sequence[str] | None = None, report: Report = silent
) -> Identification:
    """Finds the material and damping with which a scene fits measured marker displacements best.

    Least squares of all measured values alike, on reduced models that are refreshed as the parameters move; the
    derivatives are exact. Every rank must call it, and every rank gets the result.

    Args:
        scene: linear: without obstacles. Its values are the start.
        data: CSV files (see `marker_data`), or what was read from them, of motions and of equilibria.
        parameters: which; None: E, ν, ρ of every material and the damping, as far as data of that kind know them.
        report: called with the stage, how much of it is done, and of how much.

    Warns of what the result says in `warnings`.

    Raises:
        DataError: data that cannot be used, or that tell nothing.
        SceneError: a scene or a parameter that cannot be identified.
        SolverError: the fit does not settle; with what it reached.

    Example:
        >>> result = fr.identify(scene, ["markers.csv"], parameters=["young"])
        >>> f"{result.estimates[0].value:.2e}"  # Pa
        '1.00e+06'
    """
    if scene.effects.contact is not None:
        raise SceneError(
            f"{scene.source}: effects.contact: with obstacles displacements are not linear in the forces; allowed is a "
            "scene without them, with the measured contact forces in its [[run.load]]"
        )
    read = [read_markers(part, scene) if isinstance(part, str | Path) else part for part in data]
    if not read:
        raise DataError("no data were given; allowed is at least one file")
    moving = any(isinstance(part, Motion) for part in read)
    if moving and scene.effects.inertia is None:
        raise SceneError(f"{scene.source}: data with times need effects.inertia; without it give equilibria")
    for name in ("point_masses", "rigid_parts"):
        if getattr(scene.effects, name):
            raise SceneError(
                f"{scene.source}: effects.{name}: allowed are bodies without; their share of M is not sought"
            )
    sought = select_parameters(scene, parameters, moving=moving)

    report("assembly", 0, 1)
    affine = AffineSystem(scene)
    report("assembly", 1, 1)
    plain = affine.plain
    if plain.rigid.shape[1] and not scene.effects.springs and any(isinstance(part, Equilibria) for part in read):
        raise SceneError(f"{scene.source}: is not wholly held, so it has no equilibria; allowed are data with times")
    experiment = make_experiment(scene, read, plain)
    if len(experiment.measured) <= len(sought):
        raise DataError(
            f"{len(experiment.measured)} values were measured; to find {len(sought)} parameters, allowed are more"
        )

    def model_at(θ: Array) -> ReducedModel:
        return ReducedModel(affine.parts(make_basis(assemble(scene_with(scene, θ)), experiment)))

    comm = plain.algebra.comm  # type: ignore[attr-defined]
    problem = FitProblem(values_of(scene), sought, experiment, model_at, comm)
    problem, fit, unidentifiable = _fit_determined(problem, lambda done, of: report("time spans", done, of))
    identified = scene_with(scene, problem.values(fit.q))
    with warnings.catch_warnings(action="ignore", category=FenicsRomWarning):  # they are among the messages
        full, messages = predict_full_order(assemble(identified), experiment, report)
    finer = experiment
    if moving and scene.run is not None:
        half = replace(scene.run, dt=scene.run.dt / 2)
        finer = make_experiment(replace(scene, run=half), read, plain)
    result = Identification(
        scene=identified,
        estimates=_estimates(problem, fit, unidentifiable, sought, parameters_of(scene).values()),
        correlations=correlations(fit.jacobian),
        noise=noise_deviation(experiment.measured - fit.predicted, len(problem.parameters)),
        experiment=experiment,
        predicted=fit.predicted,
        full=full,
        finer=fit.model.predict(finer, problem.values(fit.q)),
        jacobian=fit.jacobian,
        order=fit.model.order,
        bases=fit.bases,
    )
    reasons = [combination.reason for combination in unidentifiable]
    result = replace(result, warnings=(*messages, *list_doubts(result), *reasons))
    for message in result.warnings:
        warnings.warn(message, FenicsRomWarning, stacklevel=2)
    return result


def _fit_determined(
    problem: FitProblem, report: Callable[[int, int], None]
) -> tuple[FitProblem, Fit, list[Unidentifiable]]:
    """The fit of those parameters that the data tell; the others are held at their start values, one after the other.

    Raises:
        DataError: they tell none.
        SolverError: the fit does not settle.
    """
    unidentifiable: list[Unidentifiable] = []
    model = problem.model_at(problem.start)
    q = np.zeros(len(problem.parameters))
    while blind := find_unidentifiable(problem.parameters, problem.linearize(model, problem.experiment, q)[1], 0.0):
        problem, q = _fix(problem, q, blind, unidentifiable)
    while True:
        fit = fit_parameters(problem, q, model, report)
        residual = problem.experiment.measured - fit.predicted
        p = len(problem.parameters)
        uncertainty = t_quantile(len(residual) - p) * noise_deviation(residual, p)
        vague = find_unidentifiable(problem.parameters, fit.jacobian, uncertainty)
        if vague is None:
            break
        problem, q = _fix(problem, fit.q, vague, unidentifiable)
        model = problem.model_at(problem.values(q))
    if not fit.converged:
        raise SolverError(_describe_attempt(problem, fit))
    return problem, fit, unidentifiable


def _fix(
    problem: FitProblem, q: Array, combination: Unidentifiable, unidentifiable: list[Unidentifiable]
) -> tuple[FitProblem, Array]:
    """The problem without a parameter, which goes back to where it started."""
    unidentifiable.append(combination)
    others = [k for k, parameter in enumerate(problem.parameters) if parameter != combination.fixed]
    if not others:
        raise DataError(f"the data tell none of the parameters: {'; '.join(each.reason for each in unidentifiable)}")
    return replace(problem, parameters=tuple(problem.parameters[k] for k in others)), q[others]


def _describe_attempt(problem: FitProblem, fit: Fit) -> str:
    values = ", ".join(
        f"{p.name} = {p.value(at):.4g} {p.unit}" for p, at in zip(problem.parameters, fit.q, strict=True)
    )
    residual = np.sqrt(np.mean((problem.experiment.measured - fit.predicted) ** 2))
    return (
        f"the fit did not settle on {MAX_BASES} bases; it reached {values}, with a residual of {residual:.3g} m (root "
        "mean square). Allowed are start values that are closer, or fewer parameters"
    )


def predict_full_order(system: System, experiment: Experiment, report: Report) -> tuple[Array, tuple[str, ...]]:
    """What the full order says of all values, (N,), m, and what the user should know; every rank must call it."""
    count = len(experiment.markers)
    run, rest, messages = np.zeros((1, count)), np.zeros((0, count)), system.warnings
    if experiment.steps:
        record = simulate(system, report=report)
        run = np.stack([record.outputs[m.output][:, m.point, m.axis] for m in experiment.markers], axis=1)
        messages = record.warnings
    if experiment.equilibria:
        forces = sum(system.input_matrix(name) @ u.T for name, u in experiment.rest_inputs.items())
        with closing(system.algebra.factor((1.0, system.stiffness))) as factor:
            rest = system.algebra.inner(factor.solve(forces), experiment.marker_columns(system))
    return experiment.predictions(run, rest), messages


def _estimates(
    problem: FitProblem,
    fit: Fit,
    unidentifiable: Sequence[Unidentifiable],
    sought: Sequence[Parameter],
    available: Iterable[Parameter],
) -> tuple[Estimate, ...]:
    """Values and intervals, in the order in which they were sought, and on which values that were held they rest."""
    widths = interval_half_widths(problem.experiment.measured - fit.predicted, fit.jacobian)
    held = [parameter for parameter in available if parameter not in problem.parameters]
    moves = _moves(problem, fit, held)
    estimates = {c.fixed.name: Estimate(c.fixed, c.fixed.start, None, None, c.reason) for c in unidentifiable}
    for parameter, q, width, moved in zip(problem.parameters, fit.q, widths, moves, strict=True):
        low, high = max(q - width, parameter.lowest), q + width
        estimates[parameter.name] = Estimate(
            parameter,
            parameter.value(q),
            parameter.value(low),
            parameter.value(high),
            given=tuple(
                Given(other, other.step, parameter.slope(q) * move * other.step / other.slope(0.0))
                for other, move in zip(held, moved, strict=True)
                if abs(move) > max(MAX_SHIFT * width, NEGLIGIBLE_SHARE)
            ),
        )
    return tuple(estimates[parameter.name] for parameter in sought)


def _moves(problem: FitProblem, fit: Fit, held: Sequence[Parameter]) -> Array:
    """How q of what was found changes with that of what was held, (p, held), were it fitted again."""
    directions = directions_at(problem.start, held, np.zeros(len(held)))
    changes = fit.model.linearize(problem.experiment, problem.values(fit.q), directions)[1]
    return -np.linalg.lstsq(fit.jacobian, changes, rcond=None)[0]
