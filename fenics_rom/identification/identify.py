"""`identify`: from a scene and marker data to the scene that fits them best, and how well its numbers are known."""

import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import DataError, FenicsRomWarning, SolverError, check_type, shown
from fenics_rom.identification.agreement import check_agreement
from fenics_rom.identification.experiment import Experiments
from fenics_rom.identification.fit import MAX_BASES, Fit, FitProblem, finish_at_full_order, fit_parameters
from fenics_rom.identification.marker_data import Data, Motion, clocks_of, read_markers
from fenics_rom.identification.parameters import (
    Parameter,
    directions_at,
    is_tilting,
    parameters_of,
    scene_with,
    select_parameters,
    values_of,
)
from fenics_rom.identification.recording import JointModel, Recording, check_identifiable, check_same_values
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


def identify(
    scene: Scene, data: Sequence[str | Path | Data], *, parameters: Sequence[str] | None = None, report: Report = silent
) -> Identification:
    """Finds the material and damping with which a scene fits measured marker displacements best.

    Least squares of all measured values alike, on reduced models that are refreshed as the parameters move. Every rank
    must call it, and every rank gets the result.

    Args:
        scene: without obstacles. Its values are the start.
        data: CSV files (see `marker_data`) of motions and of equilibria, or what `read_markers` read from them: so they
            may be of other scenes, with other loads, whose materials and damping are the same.
        parameters: which; None: E, ν, ρ of every material and the damping, as far as data of that kind know them;
            "clock" stands for how late the clock of each file of a motion is, "tilt" for two angles by which gravity is
            turned, about the axes of the scene that it is not along ("tilt.x" for one of them).
        report: called with the stage, how much of it is done, and of how much.

    Warns of what the result says in `warnings`.

    Raises:
        DataError: data that cannot be used, that tell nothing, or of another unit, axis or sign than the scene.
        SceneError: a scene or a parameter that cannot be identified.
        SolverError: the fit does not settle; with what it reached.

    Example:
        >>> result = fr.identify(scene, ["markers.csv"], parameters=["young"])
        >>> f"{result.estimates[0].value:.2e}"  # Pa
        '1.00e+06'
    """
    check_type("identify", scene, Scene, "fr.read_scene(file)")
    check_identifiable(scene, ())
    if not isinstance(data, list | tuple):
        raise DataError(f"data = {shown(data)}: use a list of files, or of what fr.read_markers gave")
    read = [part if isinstance(part, Data) else read_markers(part, scene) for part in data]
    if not read:
        raise DataError("no data were given; use at least one file")
    scenes = {id(part.scene): part.scene for part in read}
    read.sort(key=lambda part: list(scenes).index(id(part.scene)))
    motions = [part for part in read if isinstance(part, Motion)]
    sought = select_parameters(scene, parameters, moving=bool(motions), clocks=clocks_of(motions))
    recordings = _record(scene, list(scenes.values()), read, is_tilting(sought), report)
    experiment = Experiments(tuple(recording.experiment for recording in recordings))
    if len(experiment.measured) <= len(sought):
        raise DataError(f"{len(experiment.measured)} values were measured; to find {len(sought)} parameters, use more")

    def model_at(θ: Array) -> JointModel:
        return JointModel(tuple(recording.model_at(θ, report) for recording in recordings))

    def derivatives_at(model: JointModel, θ: Array, directions: Sequence[Array]) -> Array:
        pairs = zip(recordings, model.models, strict=True)
        return experiment.joined([one.derivatives_at(θ, directions, own, report) for one, own in pairs])

    comm = recordings[0].system.algebra.comm  # type: ignore[attr-defined]
    deforms_largely = any(recording.deforms_largely for recording in recordings)
    at_full_order = derivatives_at if deforms_largely else None
    problem = FitProblem(values_of(scene, len(motions)), sought, experiment, model_at, comm, at_full_order)
    problem, fit, unidentifiable = _fit_determined(problem, lambda done, of: report("time spans", done, of))
    θ = problem.values(fit.q)
    answers = [recording.answer_at(θ, report) for recording in recordings]
    full = [answer.predictions(part, θ) for answer, part in zip(answers, experiment.parts, strict=True)]
    finer = Experiments(tuple(recording.finer for recording in recordings))
    result = Identification(
        scene=scene_with(scene, θ),
        estimates=_estimates(problem, fit, unidentifiable, sought, parameters_of(scene).values()),
        correlations=correlations(fit.jacobian),
        noise=noise_deviation(experiment.measured - fit.predicted, len(problem.parameters)),
        experiment=experiment,
        predicted=fit.predicted,
        full=experiment.joined(full),
        finer=fit.model.predict(finer, θ),
        jacobian=fit.jacobian,
        full_order_jacobian=deforms_largely,
        order=fit.model.order,
        bases=fit.bases,
        read_files=(*scene.files, *(file for part in read for file in (*part.scene.files, Path(part.file)))),
    )
    messages = dict.fromkeys(message for answer in answers for message in answer.warnings)
    reasons = [combination.reason for combination in unidentifiable]
    result = replace(result, warnings=(*messages, *list_doubts(result), *reasons))
    for message in result.warnings:
        warnings.warn(message, FenicsRomWarning, stacklevel=2)
    return result


def _record(
    scene: Scene, scenes: Sequence[Scene], read: Sequence[Data], tilting: bool, report: Report
) -> list[Recording]:
    """What was measured on each of some scenes, which begin with the values of one."""
    recordings, motions = list[Recording](), 0
    for number, other in enumerate(scenes):
        report("assembly", number, len(scenes))
        check_same_values(scene, other, tilting=tilting)
        own = [part for part in read if part.scene is other]
        recordings.append(Recording(other, own, motions, tilting=tilting))
        motions += sum(isinstance(part, Motion) for part in own)
    report("assembly", len(scenes), len(scenes))
    return recordings


def _fit_determined(
    problem: FitProblem, report: Callable[[int, int], None]
) -> tuple[FitProblem, Fit, list[Unidentifiable]]:
    """The fit of those parameters that the data tell; the others are held at their start values, one after the other.

    Raises:
        DataError: they tell none, or are of another unit, axis or sign than the scene predicts.
        SolverError: the fit does not settle.
    """
    unidentifiable: list[Unidentifiable] = []
    model = problem.model_at(problem.start)
    check_agreement(problem, model)
    q = np.zeros(len(problem.parameters))
    while blind := find_unidentifiable(problem.parameters, problem.linearize(model, problem.experiment, q)[1], 0.0):
        problem, q = _fix(problem, q, blind, unidentifiable)
    while True:
        fit = fit_parameters(problem, q, model, report)
        if fit.converged and problem.derivatives_at is not None:
            fit = finish_at_full_order(problem, fit, problem.derivatives_at)
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
        "mean square). Use start values that are closer, or fewer parameters"
    )


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
