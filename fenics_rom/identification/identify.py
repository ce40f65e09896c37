"""`identify`: from a scene and marker data to the scene that fits them best, and how well its numbers are known."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from fenics_rom.errors import DataError, FenicsRomWarning, SceneError, SolverError
from fenics_rom.fem.assemble import assemble
from fenics_rom.identification.affine import AffineSystem
from fenics_rom.identification.basis import basis_for
from fenics_rom.identification.experiment import Experiment, experiment_of
from fenics_rom.identification.fit import MOST_BASES, Fit, Search, fitted
from fenics_rom.identification.full_order import full_answer
from fenics_rom.identification.identifiability import Untold, untold
from fenics_rom.identification.marker_data import Data, Equilibria, Motion, read_markers
from fenics_rom.identification.parameters import Parameter, chosen, scene_with, values_of
from fenics_rom.identification.reduced_model import ReducedModel
from fenics_rom.identification.result import Estimate, Identification, doubts
from fenics_rom.identification.uncertainty import correlations, half_widths, noise, t_quantile
from fenics_rom.io.progress import Report, silent
from fenics_rom.scene.scene import Scene
from fenics_rom.system.system import System

Array = np.ndarray


def identify(
    scene: Scene,
    data: Sequence[str | Path | Data],
    *,
    parameters: Sequence[str] | None = None,
    report: Report = silent,
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
    _check_linear(scene)
    read = [read_markers(one, scene) if isinstance(one, str | Path) else one for one in data]
    if not read:
        raise DataError("no data were given; allowed is at least one file")
    moving = any(isinstance(one, Motion) for one in read)
    if moving and scene.effects.inertia is None:
        raise SceneError(f"{scene.source}: data with times need effects.inertia; without it give equilibria")
    sought = chosen(scene, parameters, moving=moving)

    report("assembly", 0, 1)
    affine = AffineSystem(scene)
    report("assembly", 1, 1)
    plain = affine.plain
    if plain.rigid.shape[1] and not scene.effects.springs and any(isinstance(one, Equilibria) for one in read):
        raise SceneError(f"{scene.source}: is not wholly held, so it has no equilibria; allowed are data with times")
    experiment = experiment_of(scene, read, plain)
    if len(experiment.measured) <= len(sought):
        raise DataError(
            f"{len(experiment.measured)} values were measured; to find {len(sought)} parameters, allowed are more"
        )

    def model_at(θ: Array) -> ReducedModel:
        return ReducedModel(affine.parts(basis_for(assemble(scene_with(scene, θ)), experiment)))

    search = Search(values_of(scene), sought, experiment, model_at, lambda values: _of_rank_0(plain, values))
    search, fit, held = _told(search, lambda done, of: report("time spans", done, of))
    found = scene_with(scene, search.values(fit.q))
    full, messages = _full(found, experiment, report)
    finer = experiment_of(_with_half_steps(scene), read, plain) if moving else experiment
    result = Identification(
        scene=found,
        estimates=_estimates(search, fit, held, sought),
        correlations=correlations(fit.jacobian),
        noise=noise(experiment.measured - fit.predicted, len(search.parameters)),
        experiment=experiment,
        predicted=fit.predicted,
        full=full,
        finer=fit.model.answer(finer, search.values(fit.q)),
        jacobian=fit.jacobian,
        order=fit.model.order,
        bases=fit.bases,
    )
    result = replace(result, warnings=(*messages, *doubts(result), *(one.because for one in held)))
    for message in result.warnings:
        warnings.warn(message, FenicsRomWarning, stacklevel=2)
    return result


def _check_linear(scene: Scene) -> None:
    if scene.effects.contact is not None:
        raise SceneError(
            f"{scene.source}: effects.contact: with obstacles displacements are not linear in the forces; allowed is a "
            "scene without them, with the measured contact forces in its [[run.load]]"
        )


def _of_rank_0(system: System, values: Array) -> Array:
    """Numbers (p,) of the rank that has the first row, on every rank."""
    rows = system.algebra.rows()
    first = np.zeros((rows.stop - rows.start, 1))
    mine = np.zeros((rows.stop - rows.start, len(values)))
    if rows.start == 0 and rows.stop > 0:
        first[0], mine[0] = 1.0, values
    return system.algebra.inner(first, mine)[0]


def _told(search: Search, report: Callable[[int, int], None]) -> tuple[Search, Fit, list[Untold]]:
    """The fit of those parameters that the data tell; the others are held at their start values, one after the other.

    Raises:
        DataError: they tell none.
        SolverError: the fit does not settle.
    """
    held: list[Untold] = []
    model = search.model_at(search.start)
    q = np.zeros(len(search.parameters))
    while blind := untold(search.parameters, search.derivatives(model, search.experiment, q)[1], 0.0):
        search, q = _without(search, q, blind, held)
    while True:
        fit = fitted(search, q, model, report)
        residual = search.experiment.measured - fit.predicted
        p = len(search.parameters)
        uncertainty = t_quantile(len(residual) - p) * noise(residual, p)
        vague = untold(search.parameters, fit.jacobian, uncertainty)
        if vague is None:
            break
        search, q = _without(search, fit.q, vague, held)
        model = search.model_at(search.values(q))
    if not fit.settled:
        raise SolverError(_reached(search, fit))
    return search, fit, held


def _without(search: Search, q: Array, one: Untold, held: list[Untold]) -> tuple[Search, Array]:
    """The search without a parameter, which goes back to where it started."""
    held.append(one)
    left = [k for k, parameter in enumerate(search.parameters) if parameter != one.held]
    if not left:
        raise DataError(f"the data tell none of the parameters: {'; '.join(untold.because for untold in held)}")
    return replace(search, parameters=tuple(search.parameters[k] for k in left)), q[left]


def _reached(search: Search, fit: Fit) -> str:
    values = ", ".join(f"{p.name} = {p.value(at):.4g} {p.unit}" for p, at in zip(search.parameters, fit.q, strict=True))
    residual = np.sqrt(np.mean((search.experiment.measured - fit.predicted) ** 2))
    return (
        f"the fit did not settle on {MOST_BASES} bases; it reached {values}, with a residual of {residual:.3g} m (root "
        "mean square). Allowed are start values that are closer, or fewer parameters"
    )


def _full(scene: Scene, experiment: Experiment, report: Report) -> tuple[Array, tuple[str, ...]]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FenicsRomWarning)  # they are among the messages
        return full_answer(assemble(scene), experiment, report)


def _with_half_steps(scene: Scene) -> Scene:
    assert scene.run is not None
    return replace(scene, run=replace(scene.run, dt=scene.run.dt / 2))


def _estimates(search: Search, fit: Fit, held: Sequence[Untold], sought: Sequence[Parameter]) -> tuple[Estimate, ...]:
    """Values and intervals, in the order in which they were sought."""
    widths = half_widths(search.experiment.measured - fit.predicted, fit.jacobian)
    of = {one.held.name: Estimate(one.held, one.held.start, None, None, one.because) for one in held}
    for parameter, q, width in zip(search.parameters, fit.q, widths, strict=True):
        low, high = max(q - width, parameter.lowest), q + width
        of[parameter.name] = Estimate(parameter, parameter.value(q), parameter.value(low), parameter.value(high))
    return tuple(of[parameter.name] for parameter in sought)
