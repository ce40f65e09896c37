"""Method "modal+derivatives": how a body deforms at second order, without any full-order run.

The force of an elastic body is f(x) = K x + f₂(x, x) + ..., so that under a load which K x alone would balance the body
goes to x - K⁻¹ f₂(x, x) (Idelsohn & Cardona, 1985). Eigenvectors and static shapes of the loads, with all that they
make of each other (static modal derivatives) and what loads that follow the body do as it moves, span the basis. What
random combinations of them become is what points are chosen for (Jain & Tiso, 2018: a lifting to the quadratic
manifold).
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import combinations_with_replacement, islice

import numpy as np
from numpy import ndarray as Array

from fenics_rom.reduction.checkpoint import Checkpoint
from fenics_rom.reduction.common_basis import significant_eigenpairs
from fenics_rom.reduction.hyperreduction.training import TrainingData
from fenics_rom.reduction.hyperreduction.training_loads import (
    forces_at_rest,
    load_extremes,
    slowest_period,
    training_targets,
)
from fenics_rom.reduction.problem import ReductionProblem

DIFFERENCE_STRAIN = 1e-3  # of second differences: exact for St. Venant-Kirchhoff, whose force is a cubic
STATIC_SHAPES = 16  # of loads, at rest
EIGENVECTORS = 12
MAX_DERIVATIVES = 120  # those of the largest amplitudes
TRAINING_LEVELS = (0.3, 0.6, 1.0)  # of each shape
RANDOM_COMBINATIONS = 32
OVERSHOOT = 2.0  # where a load that comes at once brings a body, over where it comes to rest
NEW_SHAPE_SHARE = 1e-12  # of the squares of the static shapes, beyond the eigenvectors, that counts as a direction


def modal_derivatives(problem: ReductionProblem, checkpoint: Checkpoint) -> TrainingData:
    """Eigenvectors, static shapes and their derivatives, each weighted by its amplitude under the scene's loads."""
    system = problem.system
    inner, M = system.algebra.inner, system.mass
    moves = system.scene is None or system.scene.effects.inertia is not None
    loads = load_extremes(problem, slowest_period(problem) if moves else 0.0)
    targets = [(name, loads.whole(u)) for name, u in islice(training_targets(loads), STATIC_SHAPES)]
    at_rest = problem.factor.solve(forces_at_rest(problem, targets))
    with problem.stages("eigenvectors"):
        count = min(EIGENVECTORS, system.size)
        _, V = system.algebra.eigenpairs(M, system.stiffness, count, problem.factor)
    with problem.stages("modal derivatives"):
        modal = inner(V, M @ at_rest)
        others = at_rest - V @ modal
        floor = NEW_SHAPE_SHARE * np.trace(inner(at_rest, M @ at_rest))
        w, E = (x[..., ::-1] for x in significant_eigenpairs(inner(others, M @ others), floor))  # ascending
        shapes = np.hstack([V, others @ (E / np.sqrt(w))])
        shapes *= _definite_signs(inner(shapes, M @ at_rest))
        a = np.sqrt(np.concatenate([(modal**2).sum(axis=1), w]) / at_rest.shape[1])  # root mean squares
        pairs = sorted(combinations_with_replacement(range(len(a)), 2), key=lambda ij: -a[ij[0]] * a[ij[1]])
        pairs = pairs[:MAX_DERIVATIVES]
        weights = [a[i] * a[j] * (0.5 if i == j else 1.0) for i, j in pairs]
        columns = [shapes * a, static_derivatives(problem, shapes, pairs) * weights]
        at = np.cumsum([0, *system.widths.values()])
        largest = dict(zip(system.widths, np.abs(loads.extremes).max(axis=0)[at[:-1]], strict=True))
        largest |= forces_of_strokes(problem, largest)
        follower = [largest[name] * columns for name, columns in follower_changes(problem, shapes).items()]
        columns += [block * a for block in follower]
        random = np.random.default_rng(0).standard_normal((len(a), RANDOM_COMBINATIONS))
        first = np.hstack([at_rest, (shapes * a) @ random])
        second = second_order(problem, first)
        for block in follower:
            second += block @ inner(shapes, M @ first)
    loads = replace(loads, inputs=loads.inputs | forces_of_strokes(problem, loads.inputs))
    states = np.hstack([s * first + s**2 * second for s in TRAINING_LEVELS])
    return TrainingData(np.hstack(columns), states, loads, OVERSHOOT if moves else 1.0)


def _definite_signs(responses: Array) -> Array:
    """Signs (k,) for shapes of these parts in the responses to loads (k, any), by which random combinations are the
    same whichever sign an eigensolver gave.
    """
    mixed = responses @ np.random.default_rng(1).standard_normal(responses.shape[1])
    return np.where(mixed < 0, -1.0, 1.0)


def forces_of_strokes(problem: ReductionProblem, largest: Mapping[str, float]) -> dict[str, float]:
    """Forces of strokes as large as given by name, each alone, on the body at rest, N or Pa."""
    system, forces = problem.system, dict[str, float]()
    scene = system.scene
    for name in () if scene is None else filter(system.actuators.__contains__, scene.environment.controls):
        C = system.unit_forces(name)
        forces[name] = largest[name] / float(system.algebra.inner(C, problem.factor.solve(C))[0, 0])
    return forces


def static_derivatives(problem: ReductionProblem, shapes: Array, pairs: Iterable[tuple[int, int]]) -> Array:
    """θ_ij = -K⁻¹ (∂K_t/∂q_j) φ_i = -2 K⁻¹ f₂(φ_i, φ_j) of pairs of shapes (rows here, k), (rows here, pairs)."""
    pairs = list(pairs)
    squares = second_order(problem, shapes)
    mixed = [(i, j) for i, j in pairs if i != j]
    sums = second_order(problem, shapes[:, [i for i, _ in mixed]] + shapes[:, [j for _, j in mixed]])
    of_sum = dict(zip(mixed, sums.T, strict=True))
    columns = [2 * squares[:, i] if i == j else of_sum[i, j] - squares[:, i] - squares[:, j] for i, j in pairs]
    return np.column_stack(columns)


def second_order(problem: ReductionProblem, shapes: Array) -> Array:
    """-K⁻¹ f₂(x, x) of each shape x, (rows here, k): quadratic in x."""
    body = problem.deformation
    forces = np.empty_like(shapes)
    for k, x in enumerate(shapes.T):
        ε = _difference_scale(problem, x)
        forces[:, k] = (body.force(ε * x) + body.force(-ε * x)) / (2 * ε**2)
    return -problem.factor.solve(forces)


def follower_changes(problem: ReductionProblem, shapes: Array) -> dict[str, Array]:
    """K⁻¹ ∂f/∂x x of each load that follows the body, at 1 Pa or 1 N, and each shape x, (rows here, k)."""
    body = problem.deformation
    changes: dict[str, list[Array]] = {
        name: [] for name in problem.system.actuators if name in body.follower(shapes[:, 0] * 0)
    }
    for x in shapes.T:
        ε = _difference_scale(problem, x)
        plus, minus = body.follower(ε * x), body.follower(-ε * x)
        for name, columns in changes.items():
            columns.append((plus[name] - minus[name])[:, 0] / (2 * ε))
    return {name: problem.factor.solve(np.column_stack(columns)) for name, columns in changes.items()}


def _difference_scale(problem: ReductionProblem, x: Array) -> float:
    """What a shape is to be multiplied by for a strain of DIFFERENCE_STRAIN."""
    steepest = np.abs(problem.deformation.gradients(x[:, None])).max(initial=0.0)
    steepest = float(problem.system.algebra.maximum(steepest))
    return DIFFERENCE_STRAIN / steepest if steepest else 1.0  # what strains nothing changes nothing
