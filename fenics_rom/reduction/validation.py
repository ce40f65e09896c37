"""The validation: what the reduced models get wrong, measured by full solves at frequencies no basis was made from.

The full response is the one in the shared space plus the solution for its residual, found by generalized minimal
residuals (GMRES) preconditioned with the one factor of K, for many frequencies, inputs and contact modes side by side.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.reduction.common_basis import Subspace, block_starts, split_like
from fenics_rom.reduction.frequency_response import dynamic_product, inner_products, relative_modulus, response
from fenics_rom.reduction.problem import ReductionProblem
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.system.columns import apply_to_complex, column_dots, sum_of
from fenics_rom.system.system import MOST_FORCES

MAX_INPUTS = 6  # of a contact mode at a frequency; where it has more columns, random combinations of them
MAX_COLUMNS = 300  # of all contact modes at all frequencies, unless that is less than one
COLUMNS_AT_ONCE = 48  # complex columns that are solved for together
STATICS_AT_ONCE = 96  # columns whose static shapes are solved for together
BLOCK_BYTES, FEWEST_AT_ONCE = 1e8, 16  # of so many numbers side by side, unless that is fewer: a dozen blocks are there
MODES_AT_ONCE = 16  # contact modes whose static shapes are solved for together
RELATIVE_ACCURACY = 0.1  # of the error that is measured
# Of solves by iteration with K in GMRES: what they leave adds up to no more than η Σ |y_k| |A v_k| in the residual, of
# its weights y and basis v (Simoncini & Szyld 2003), which is to be far below RELATIVE_ACCURACY.
SOLVE_ACCURACY = 1e-2
MAX_GMRES_STEPS = 15
LIGHT_PART_RATIO = 3.0  # of static errors by nodes and by mass, beyond which a part that weighs little is wrong
WARNING_ERROR = 0.05  # of the static shapes, by nodes, beyond which the user is told
UNDAMPED_RATIO = 1e-9  # of critical damping: at a resonance with less round-off is all that is left


@dataclass(frozen=True)
class Sample:
    """One contact mode at one frequency."""

    name: str
    frequency: float  # ω, rad/s
    inputs: Array  # (rows here, c) columns of B, or combinations of them
    reduced: Array  # (k, c) the reduced model's amplitudes in the shared space


class StaticError(NamedTuple):
    """|K⁻¹B - W diag(1/γ) G| / |K⁻¹B| of one contact mode, in two norms."""

    by_mass: float
    by_node: float  # all nodes alike


def validated(
    problem: ReductionProblem, whole: Subspace, models: Mapping[str, ContactModel], bases: Mapping[str, Array]
) -> dict[str, ContactModel]:
    """The same models with their static and frequency response errors; `bases` are W_i in the shared space, (k, m)."""
    static = _static_errors(problem, models, bases)
    models = {name: replace(model, static_error=static[name].by_mass) for name, model in models.items()}
    problem.messages.extend(_light_part_warnings(problem, models, static))
    scene = problem.system.scene
    if scene is not None and scene.effects.inertia is None:  # runs are equilibria, and know no frequencies
        return models
    count = sum(len(sample_frequencies(model)) for model in models.values())
    width = max(1, min(MAX_INPUTS, MAX_COLUMNS // count))
    samples = [s for name, model in models.items() for s in _samples(problem, name, model, bases[name], width)]
    norms: dict[str, list[Array]] = {name: [] for name in models}  # of the error and of the full response
    for done, group in enumerate(groups := _groups(samples, _real_columns(problem, 2 * COLUMNS_AT_ONCE) // 2)):
        problem.stages.report("validation", done, len(groups))
        for sample, of_sample in zip(group, np.sqrt(_squared_norms(problem, whole, group)).T, strict=True):
            norms[sample.name].append(of_sample)
    problem.stages.report("validation", len(groups), len(groups))
    for name, model in models.items():
        errors, sizes = np.transpose(norms[name])
        models[name] = replace(model, frequencies=sample_frequencies(model), transfer_errors=errors / sizes.max())
    return models


def sample_frequencies(model: ContactModel) -> Array:
    """The first resonance, where most is at stake, and up to the middle of those that the model has, rad/s.

    Undamped resonances are infinite: where there are some, the middle of the widest gaps between them instead.
    """
    ω = np.sqrt(model.eigenvalues)
    first, middle, last = 0, len(ω) // 4, len(ω) // 2
    damping = model.damping if model.damping.ndim == 1 else np.diag(model.damping)
    if (damping > UNDAMPED_RATIO * ω).all():
        return np.unique(ω[[first, middle, last]])
    gaps = np.diff(ω, prepend=0.0)
    widest = {int(at[gaps[at].argmax()]) for at in np.split(np.arange(last + 1), [1, middle + 1]) if len(at)}
    return np.array([ω[k] - gaps[k] / 2 for k in sorted(widest)])


def _samples(problem: ReductionProblem, name: str, model: ContactModel, W: Array, width: int) -> list[Sample]:
    system, samples, count = problem.system, list[Sample](), problem.system.count_forces(name)
    blocks = list(system.force_blocks(name))
    inner = [system.algebra.inner(problem.space.basis, system.forces(name, some)) for some in blocks]
    G = W.T @ np.hstack(inner)
    random = np.random.default_rng(0)
    for ω in sample_frequencies(model):
        mixed, modulus = np.eye(min(count, width)), relative_modulus(system.scene, ω)
        if count > width:
            mixed = np.linalg.qr(random.standard_normal((count, width)))[0]
        reduced = response(modulus * model.eigenvalues, model.damping, G @ mixed, ω)
        inputs = sum_of(system.forces(name, some) @ mixed[some] for some in blocks)
        samples.append(Sample(name, ω, inputs, W @ reduced))
    return samples


def _real_columns(problem: ReductionProblem, most: int) -> int:
    """How many columns are worked on together: as many as wanted, or as there is room for."""
    return min(most, max(FEWEST_AT_ONCE, int(BLOCK_BYTES / (8 * problem.system.size))))


def _groups(samples: list[Sample], columns: int) -> list[list[Sample]]:
    """Samples that follow one another, of no more than so many columns together."""
    groups: list[list[Sample]] = [[]]
    for sample in samples:
        if groups[-1] and sum(s.inputs.shape[1] for s in [*groups[-1], sample]) > columns:
            groups.append([])
        groups[-1].append(sample)
    return groups


def _squared_norms(problem: ReductionProblem, whole: Subspace, group: list[Sample]) -> tuple[Array, Array]:
    """Of the error and of the full response, in the mass norm, for each sample."""
    system, X = problem.system, problem.space.basis
    blocks = [sample.inputs for sample in group]
    starts, inputs = block_starts(blocks), np.hstack(blocks)
    widths = np.diff(starts)
    ω = np.repeat([sample.frequency for sample in group], widths)
    projected = split_like(whole.coordinates.T @ system.algebra.inner(X, inputs), blocks)
    within = whole.coordinates @ np.hstack(
        [
            response(relative_modulus(system.scene, s.frequency) * whole.eigenvalues, whole.damping, G, s.frequency)
            for G, s in zip(projected, group, strict=True)
        ]
    )
    error = within - np.hstack([sample.reduced for sample in group])
    solve = problem.factor.solve
    correction = minimal_residuals(
        lambda columns: solve(dynamic_product(system, columns, ω), SOLVE_ACCURACY),
        solve(inputs - dynamic_product(system, apply_to_complex(X.__matmul__, within), ω), SOLVE_ACCURACY),
        lambda left, right: np.diag(inner_products(system, left, system.mass @ right)),
        RELATIVE_ACCURACY * _largest_of_mode(np.linalg.norm(error, axis=0), [s.name for s in group], widths),
    )
    M_correction = system.mass @ correction
    shared = apply_to_complex(lambda block: system.algebra.inner(X, block), M_correction)
    outside = np.diag(inner_products(system, correction, M_correction)).real - np.sum(np.abs(shared) ** 2, axis=0)
    squared_errors, squared_responses = (
        np.add.reduceat(np.sum(np.abs(y + shared) ** 2, axis=0) + np.maximum(outside, 0.0), starts[:-1])
        for y in (error, within)
    )
    return squared_errors, squared_responses


def _largest_of_mode(sizes: Array, names: list[str], widths: Array) -> Array:
    """The largest size (c,) among the columns of the same contact mode: smaller errors matter no more than that."""
    name_of_column = np.repeat(names, widths)
    return np.array([sizes[name_of_column == name].max() for name in name_of_column])


def minimal_residuals(
    operator: Callable[[Array], Array], right: Array, dot: Callable[[Array, Array], Array], targets: Array
) -> Array:
    """Solves for all columns (n, c) side by side by GMRES (Saad & Schultz 1986), each with a Krylov space of its own.

    `dot` is leftᴴ right of each pair of columns, (c,); residuals may keep the norms `targets` (c,), or
    RELATIVE_ACCURACY of the right-hand sides'.
    """
    size = np.sqrt(dot(right, right).real)
    if (size <= targets).all():
        return right
    targets = np.maximum(targets, RELATIVE_ACCURACY * size)
    basis = [right / np.where(size > 0, size, 1.0)]
    H = np.zeros((right.shape[1], MAX_GMRES_STEPS + 1, MAX_GMRES_STEPS), dtype=complex)
    for step in range(1, MAX_GMRES_STEPS + 1):
        new = operator(basis[-1])
        for row, old in enumerate(basis):
            H[:, row, step - 1] = dot(old, new)
            new = new - old * H[:, row, step - 1]
        length = np.sqrt(dot(new, new).real)
        H[:, step, step - 1] = length
        first = np.zeros((right.shape[1], step + 1, 1))
        first[:, 0, 0] = size
        small = H[:, : step + 1, :step]
        weights = np.linalg.pinv(small) @ first
        residual = np.linalg.norm(small @ weights - first, axis=1)[:, 0]
        if (residual <= targets).all():
            break
        basis.append(new / np.where(length > 0, length, 1.0))
    return np.sum([w * old for w, old in zip(weights[:, :, 0].T, basis, strict=False)], axis=0)


def _static_errors(
    problem: ReductionProblem, models: Mapping[str, ContactModel], bases: Mapping[str, Array]
) -> dict[str, StaticError]:
    """What the models miss at rest."""
    system, errors = problem.system, dict[str, StaticError]()
    many = [name for name in models if system.count_forces(name) > MOST_FORCES]
    for name in many:
        sums, γ = np.zeros(4), models[name].eigenvalues[:, None]
        for some in system.force_blocks(name):
            B = system.forces(name, some)
            reduced = bases[name] @ (bases[name].T @ system.algebra.inner(problem.space.basis, B) / γ)
            sums += _static_squares(problem, B, reduced).sum(axis=1)
        errors[name] = StaticError(*np.sqrt(sums[[0, 2]] / sums[[1, 3]]).tolist())
    names = [name for name in models if name not in many]
    for first in range(0, len(names), MODES_AT_ONCE):
        group = names[first : first + MODES_AT_ONCE]
        inputs = [system.forces(name) for name in group]
        projected = split_like(system.algebra.inner(problem.space.basis, np.hstack(inputs)), inputs)
        reduced = [
            bases[name] @ (bases[name].T @ XᵀB / models[name].eigenvalues[:, None])
            for name, XᵀB in zip(group, projected, strict=True)
        ]
        squares = _static_squares(problem, np.hstack(inputs), np.hstack(reduced))
        error_by_mass, by_mass, error_by_node, by_node = np.add.reduceat(squares, block_starts(inputs)[:-1], axis=1)
        shares = np.sqrt(error_by_mass / by_mass), np.sqrt(error_by_node / by_node)
        errors |= zip(group, map(StaticError, *(share.tolist() for share in shares)), strict=True)
    return errors


def _static_squares(problem: ReductionProblem, inputs: Array, reduced: Array) -> Array:
    """Of columns (rows here, p) at rest |error|² and |x|² by mass, then by nodes, (4, p); `reduced` is (k, p)."""
    system, squares = problem.system, np.empty((4, inputs.shape[1]))
    step = _real_columns(problem, STATICS_AT_ONCE)
    for first in range(0, inputs.shape[1], step):
        columns = slice(first, first + step)
        within = problem.space.basis @ reduced[:, columns]
        error = problem.factor.solve(inputs[:, columns] - system.stiffness @ within, SOLVE_ACCURACY)
        statics = within + error
        pairs = (error, system.mass @ error), (statics, system.mass @ statics), (error, error), (statics, statics)
        squares[:, columns] = [column_dots(system.algebra, *pair) for pair in pairs]
    return squares


def _light_part_warnings(
    problem: ReductionProblem, models: Mapping[str, ContactModel], static: Mapping[str, StaticError]
) -> Iterator[str]:
    """Messages where directions that were ranked by mass neglect a part that has next to none."""
    if problem.weighting != "mass" or not len(problem.system.body.nodes):
        return
    neglected = {
        name: static[name]
        for name, model in models.items()
        if len(model.hankel_singular_values)  # else nothing was weighted
        and static[name].by_node > max(WARNING_ERROR, LIGHT_PART_RATIO * static[name].by_mass)
    }
    if neglected:
        worst = max(neglected, key=lambda name: neglected[name].by_node)
        others = f" (and {len(neglected) - 1} more)" if len(neglected) > 1 else ""
        yield (
            f"contact mode {worst!r}{others} misses {neglected[worst].by_mass:.2g} of its static shapes by mass, but "
            f"{neglected[worst].by_node:.2g} with all nodes counted alike: a part that weighs little is followed "
            "badly; a higher order, or weighting = 'nodal' or 'outputs', follows it"
        )
