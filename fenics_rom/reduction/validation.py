"""The validation: what the reduced models get wrong, measured by full solves at frequencies no basis was made from.

The full response is the one in the shared space plus the solution for its residual, found by generalized minimal
residuals (GMRES) preconditioned with the one factor of K, for many frequencies, inputs and contact modes side by side.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from fenics_rom.reduction.common_basis import Subspace
from fenics_rom.reduction.frequency_response import dynamic_product, inner_products, response
from fenics_rom.reduction.problem import ReductionProblem
from fenics_rom.rom.rom import ContactModel
from fenics_rom.system.complex_columns import apply_to_complex
from fenics_rom.system.protocols import Array

MOST_INPUTS = 6  # of a contact mode at a frequency; where it has more columns, random combinations of them
MOST_COLUMNS = 300  # of all contact modes at all frequencies, unless that is less than one
GROUP = 48  # complex columns that are solved for together
MODES_AT_ONCE = 16  # contact modes whose static shapes are solved for together
ACCURACY = 0.1  # of the error that is measured
MOST_STEPS = 15  # of GMRES
LIGHT = 3.0  # times the static error by mass: an error by nodes beyond that is one of a part that weighs little
MUCH = 0.05  # of the static shapes, by nodes, that the user should know is missing
UNDAMPED = 1e-9  # share of critical damping that is none: at such a resonance round-off is all that is seen


@dataclass(frozen=True)
class Sample:
    """One contact mode at one frequency.

    Attributes:
        name: of the contact mode.
        frequency: ω, rad/s.
        inputs: (rows here, c) columns of B, or combinations of them.
        reduced: (k, c) the reduced model's amplitudes in the shared space.
    """

    name: str
    frequency: float
    inputs: Array
    reduced: Array


@dataclass(frozen=True)
class StaticError:
    """|K⁻¹B - W diag(1/γ) G| / |K⁻¹B| of one contact mode, in two norms.

    Attributes:
        by_mass: in the mass norm.
        by_node: in the norm that counts all nodes alike.
    """

    by_mass: float
    by_node: float


def certified(
    problem: ReductionProblem, whole: Subspace, modes: Mapping[str, ContactModel], bases: Mapping[str, Array]
) -> dict[str, ContactModel]:
    """The same modes with their static and frequency response errors.

    Args:
        problem: what was reduced.
        whole: all of the shared space.
        modes: by contact mode.
        bases: W_i in the shared space, (k, m) each.
    """
    static = _static_errors(problem, modes, bases)
    modes = {name: replace(mode, static_error=static[name].by_mass) for name, mode in modes.items()}
    problem.messages.extend(_light_parts(problem, modes, static))
    scene = problem.system.scene
    if scene is not None and "inertia" not in scene.effects:  # runs are equilibria, and know no frequencies
        return modes
    count = sum(len(sample_frequencies(mode)) for mode in modes.values())
    width = max(1, min(MOST_INPUTS, MOST_COLUMNS // count))
    samples = [s for name, mode in modes.items() for s in _samples(problem, name, mode, bases[name], width)]
    errors: dict[str, list[float]] = {name: [] for name in modes}
    sizes: dict[str, list[float]] = {name: [] for name in modes}
    for done, group in enumerate(groups := _groups(samples)):
        problem.stages.report("validation", done, len(groups))
        error, full = (np.sqrt(norms) for norms in _squared_norms(problem, whole, group))
        for sample, e, x in zip(group, error, full, strict=True):
            errors[sample.name].append(e)
            sizes[sample.name].append(x)
    problem.stages.report("validation", len(groups), len(groups))
    return {
        name: replace(
            mode,
            frequencies=sample_frequencies(mode),
            transfer_errors=np.array(errors[name]) / max(sizes[name]),
        )
        for name, mode in modes.items()
    }


def sample_frequencies(mode: ContactModel) -> Array:
    """The first resonance, where most is at stake, and up to the middle of those that the model has, rad/s.

    Undamped resonances are infinite: where there are some, the middle of the widest gaps between them instead.
    """
    ω = np.sqrt(mode.eigenvalues)
    first, middle, last = 0, len(ω) // 4, len(ω) // 2
    damping = mode.damping if mode.damping.ndim == 1 else np.diag(mode.damping)
    if (damping > UNDAMPED * ω).all():
        return np.unique(ω[[first, middle, last]])
    gaps = np.diff(ω, prepend=0.0)
    widest = {int(at[gaps[at].argmax()]) for at in np.split(np.arange(last + 1), [1, middle + 1]) if len(at)}
    return np.array([ω[k] - gaps[k] / 2 for k in sorted(widest)])


def _samples(problem: ReductionProblem, name: str, mode: ContactModel, W: Array, width: int) -> list[Sample]:
    B, samples = problem.system.forces(name), []
    G = W.T @ problem.system.algebra.inner(problem.space.basis, B)
    random = np.random.default_rng(0)
    for ω in sample_frequencies(mode):
        mixed = np.eye(B.shape[1])
        if B.shape[1] > width:
            mixed = np.linalg.qr(random.standard_normal((B.shape[1], width)))[0]
        samples.append(Sample(name, ω, B @ mixed, W @ response(mode.eigenvalues, mode.damping, G @ mixed, ω)))
    return samples


def _groups(samples: list[Sample]) -> list[list[Sample]]:
    groups: list[list[Sample]] = []
    width = GROUP
    for sample in samples:
        width += sample.inputs.shape[1]
        if width > GROUP:
            groups.append([])
            width = sample.inputs.shape[1]
        groups[-1].append(sample)
    return groups


def _squared_norms(problem: ReductionProblem, whole: Subspace, group: list[Sample]) -> tuple[Array, Array]:
    """Of the error and of the full response, in the mass norm, for each sample."""
    system, X = problem.system, problem.space.basis
    widths = [sample.inputs.shape[1] for sample in group]
    ω = np.repeat([sample.frequency for sample in group], widths)
    inputs = np.hstack([sample.inputs for sample in group])
    seen = np.split(whole.coordinates.T @ system.algebra.inner(X, inputs), np.cumsum(widths)[:-1], axis=1)
    within = whole.coordinates @ np.hstack(
        [response(whole.eigenvalues, whole.damping, g, s.frequency) for g, s in zip(seen, group, strict=True)]
    )
    error = within - np.hstack([sample.reduced for sample in group])
    preconditioned = problem.factor.solve
    rest = minimal_residuals(
        lambda columns: preconditioned(dynamic_product(system, columns, ω)),
        preconditioned(inputs - dynamic_product(system, apply_to_complex(X.__matmul__, within), ω)),
        lambda left, right: np.diag(inner_products(system, left, system.mass @ right)),
        ACCURACY * _largest_of_mode(np.linalg.norm(error, axis=0), [s.name for s in group], widths),
    )
    Mrest = system.mass @ rest
    shared = apply_to_complex(lambda block: system.algebra.inner(X, block), Mrest)
    outside = np.diag(inner_products(system, rest, Mrest)).real - np.sum(np.abs(shared) ** 2, axis=0)
    starts = np.cumsum([0, *widths[:-1]])
    size, full = (
        np.add.reduceat(np.sum(np.abs(y + shared) ** 2, axis=0) + np.maximum(outside, 0.0), starts)
        for y in (error, within)
    )
    return size, full


def _largest_of_mode(sizes: Array, names: list[str], widths: list[int]) -> Array:
    """The largest size (c,) among the columns of the same contact mode: smaller errors matter no more than that."""
    of = np.repeat(names, widths)
    return np.array([sizes[of == name].max() for name in of])


def minimal_residuals(
    operator: Callable[[Array], Array], right: Array, dot: Callable[[Array, Array], Array], enough: Array
) -> Array:
    """Solves for all columns side by side by GMRES (Saad & Schultz 1986), each with a Krylov space of its own.

    Args:
        operator: acts on columns (n, c).
        right: (n, c) right-hand sides.
        dot: leftᴴ right of each pair of columns in the inner product, (c,).
        enough: (c,) norms that residuals may keep, beside ACCURACY of the right-hand sides'.
    """
    size = np.sqrt(dot(right, right).real)
    if (size <= enough).all():
        return right
    enough = np.maximum(enough, ACCURACY * size)
    basis = [right / np.where(size > 0, size, 1.0)]
    H = np.zeros((right.shape[1], MOST_STEPS + 1, MOST_STEPS), dtype=complex)
    for step in range(1, MOST_STEPS + 1):
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
        if (residual <= enough).all():
            break
        basis.append(new / np.where(length > 0, length, 1.0))
    return np.sum([w * old for w, old in zip(weights[:, :, 0].T, basis, strict=False)], axis=0)


def _ends(blocks: list[Array]) -> Array:
    """Where the columns of each block but the last end, side by side."""
    return np.cumsum([block.shape[1] for block in blocks[:-1]], dtype=int)


def _static_errors(
    problem: ReductionProblem, modes: Mapping[str, ContactModel], bases: Mapping[str, Array]
) -> dict[str, StaticError]:
    """What the models miss at rest."""
    system, names = problem.system, list(modes)
    errors: dict[str, StaticError] = {}
    for first in range(0, len(names), MODES_AT_ONCE):
        group = names[first : first + MODES_AT_ONCE]
        inputs = [system.forces(name) for name in group]
        statics = problem.factor.solve(np.hstack(inputs))
        seen = np.split(system.algebra.inner(problem.space.basis, np.hstack(inputs)), _ends(inputs), axis=1)
        reduced = [
            bases[name] @ (bases[name].T @ XᵀB / modes[name].eigenvalues[:, None])
            for name, XᵀB in zip(group, seen, strict=True)
        ]
        error = statics - problem.space.basis @ np.hstack(reduced)
        starts = [0, *_ends(inputs)]
        by_mass, by_node = (
            np.sqrt(np.divide(*(np.add.reduceat(np.diag(system.algebra.inner(x, y)), starts) for x, y in pairs)))
            for pairs in (
                ((error, system.mass @ error), (statics, system.mass @ statics)),
                ((error, error), (statics, statics)),
            )
        )
        errors |= zip(group, map(StaticError, by_mass.tolist(), by_node.tolist()), strict=True)
    return errors


def _light_parts(
    problem: ReductionProblem, modes: Mapping[str, ContactModel], static: Mapping[str, StaticError]
) -> Iterator[str]:
    """What to say where directions that were chosen by mass pass over a part that has next to none."""
    if problem.weighting != "mass" or not len(problem.system.body.nodes):
        return
    told = {
        name: static[name]
        for name, mode in modes.items()
        if len(mode.hankel_singular_values)  # else nothing was weighted
        and static[name].by_node > max(MUCH, LIGHT * static[name].by_mass)
    }
    if told:
        worst = max(told, key=lambda name: told[name].by_node)
        others = f" (and {len(told) - 1} more)" if len(told) > 1 else ""
        yield (
            f"contact mode {worst!r}{others} misses {told[worst].by_mass:.2g} of its static shapes by mass, but "
            f"{told[worst].by_node:.2g} with all nodes counted alike: a part that weighs little is followed badly; "
            "a higher order, or weighting = 'nodal' or 'outputs', follows it"
        )
