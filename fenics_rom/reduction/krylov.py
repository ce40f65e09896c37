"""Rational block Krylov spaces of the second-order system, for several contact modes at a time.

The first shift is zero: blocks of K⁻¹M from K⁻¹B, with the one factor of K that all contact modes share. For
D = α M + β K + F Fᵀ the space started from [B, F] holds every resolvent of B there is, and no other shift is needed.
Any other D asks for shifts s > 0: where the residual r of the frequency response is largest, ω = s, blocks of
(s²M + sD + K)⁻¹ r are added. All matrices are real, symmetric and definite.
"""

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass

import numpy as np
from numpy import ndarray as Array

from fenics_rom.reduction.balancing import Balanced, balanced_in, choose_order, ranked_basis
from fenics_rom.reduction.common_basis import Subspace, orthogonal_complement, pad_rows, split_like
from fenics_rom.reduction.frequency_response import dynamic_product, mass_norms, response
from fenics_rom.reduction.krylov_augmentation import KrylovAugmentation
from fenics_rom.reduction.leading_inputs import leading_inputs
from fenics_rom.reduction.problem import RankedBasis, ReductionProblem
from fenics_rom.system.columns import apply_to_complex

CONVERGENCE_TOLERANCE = 1e-7  # relative change of σ and of frequency responses that ends the growth of a space
# Of solves by iteration. What block k leaves, of relative size η_k in energy, leaves Σ η_k |y_k| of the residuals of
# responses. There the shares |y_k| of blocks in them shrink as the responses converge (Simoncini & Szyld 2003). So
# η_k |y_k| is kept at SPACE_ACCURACY, |y_k| taken as the last change of responses and σ. The projection on the space is
# exact all the same: by Galerkin's orthogonality BᵀH B and σ are off by the square of that, about 1e-12.
SPACE_ACCURACY = 1e-6
LEAST_ACCURACY = 1e-2  # of any block
MEASURE_ACCURACY = 1e-2  # of residuals, whose size is asked for
NEGLIGIBLE_SHARE = 1e-9  # of σ_1, below which σ need not converge in all their digits
GROWTH_FACTORS = {1: 1.1, 2: 1.5}  # of a space between two iterates, for diagonal and dense damping: those take longer
MAX_VECTORS = 400  # of a contact mode's space, shared eigenvectors not counted; of those of some together twice as many
ZERO_SHIFT_BLOCKS = 15  # before the first positive shift
POSITIVE_SHIFT_BLOCKS = 3  # at each of them
MAX_SHIFTS = 20
WARNING_CHANGE = (
    1e-3  # beyond which the user is told: less changes no choice of order; the validation measures the model
)
SAMPLE_COUNT = 12  # frequencies at which spaces are compared
HIGHEST_SAMPLE = 1  # the highest frequency alone: with eigenvectors in the space, where it is worst


class Chain:
    """The part of the shared space that belongs to one contact mode, or some, and its latest directions."""

    def __init__(self, shared: Array):  # (k, r) coordinates that it starts with, the first unit vectors
        self.span = shared
        self.latest = shared[:, :0]
        self.shared_size = shared.shape[1]

    @property
    def grown_size(self) -> int:
        """Number of directions beyond those it started with."""
        return self.span.shape[1] - self.shared_size

    def extend(self, coordinates: Array) -> Array:
        """Takes coordinates (k, any) in, and returns the directions (k, new) that they add."""
        span = pad_rows(self.span, len(coordinates))
        new = orthogonal_complement(coordinates, span)
        self.span = np.hstack([span, new])
        return new


@dataclass(frozen=True)
class ProjectedModel:
    """A contact mode projected onto its space of the moment."""

    grown_size: int  # number of directions of that space that are not shared eigenvectors
    space: Subspace
    inputs: Array  # B in it, (r, p)

    def response(self, ω: float) -> Array:
        """Amplitudes at ω in rad/s, (k, p) in the shared space."""
        return self.space.coordinates @ response(self.space.eigenvalues, self.space.damping, self.inputs, ω)


@dataclass(frozen=True)
class KrylovIterate:
    """A contact mode in its space of the moment, and its balanced realization."""

    model: ProjectedModel
    balanced: Balanced

    def change_since(self, last: "KrylovIterate", order: int | None, tolerance: float) -> float:
        """Largest relative change of the σ that count and of sampled frequency responses; 1 where too few are there."""
        σ = self.balanced.singular_values
        m = min(choose_order(σ, order, tolerance), len(σ))
        changes, sizes = [], []
        for ω in sample_frequencies(self.model.space.eigenvalues, m):
            y = self.model.response(ω)
            changes.append(np.linalg.norm(y - pad_rows(last.model.response(ω), len(y))))
            sizes.append(np.linalg.norm(y))
        change = relative_change(σ, last.balanced.singular_values, order, tolerance)
        return max(change, float(max(changes) / max(sizes)))


def relative_change(σ: Array, before: Array, order: int | None, tolerance: float) -> float:
    """Largest relative change of the σ that an order or a tolerance makes count; 1 where there were too few before."""
    m = choose_order(σ, order, tolerance)
    if len(before) < min(m, int(np.sum(σ > NEGLIGIBLE_SHARE * σ[0]))):
        return 1.0
    m = min(m, len(before), len(σ))
    return float((np.abs(σ[:m] - before[:m]) / (σ[:m] + NEGLIGIBLE_SHARE * σ[0])).max())


def sample_frequencies(γ: Array, order: int | None, count: int = SAMPLE_COUNT) -> Array:
    """Frequencies in rad/s between resonances, from below the first to the last that the reduced model is for."""
    ω = np.sqrt(γ[: order or len(γ)])
    between = np.sqrt(ω * np.concatenate([ω[:1] / 4, ω[:-1]]))
    return between[np.unique(np.geomspace(len(ω), 1, count).astype(int)) - 1]


class KrylovSpaces:
    """Krylov spaces of some contact modes, all in the problem's shared space.

    Where they are `together` each contact mode is balanced in what all of them add, and needs fewer blocks.
    """

    def __init__(
        self, problem: ReductionProblem, names: Sequence[str], augmentation: KrylovAugmentation, together: bool
    ):
        shared = problem.space
        self._problem = problem
        self.inputs = {name: leading_inputs(problem, name) for name in names}
        V = np.eye(shared.size)[:, : shared.eigenvectors]
        self.chains = dict.fromkeys(names, Chain(V)) if together else {name: Chain(V) for name in names}
        self._augmentation = Chain(V)
        self._orders = {name: problem.order_of(name) for name in names}  # or the last iterate's
        self._projected_inputs: tuple[int, dict[str, Array]] = (-1, {})
        self._models: dict[str, ProjectedModel] = {}
        self.changes = dict.fromkeys(names, 1.0)  # of each contact mode by its last block, or more
        self._shifts = 0
        self._blocks = 0
        self._zero_suffices = augmentation.complete
        inputs = list(self.inputs.values())
        self._add([*([np.hstack(inputs)] if together else inputs), augmentation.columns], names)

    def grow(self, names: Sequence[str]) -> None:
        """Adds a block, or blocks at a positive shift, for those contact modes that still need it."""
        if self._zero_suffices or self._blocks < ZERO_SHIFT_BLOCKS:
            chains = [*self._chains_of(names), self._augmentation]
            latest = [pad_rows(chain.latest, self._problem.space.size) for chain in chains]
            columns = self._problem.system.mass @ (self._problem.space.basis @ np.hstack(latest))
            self._add(split_like(columns, latest), names)
        else:
            self._add_shift(names)

    def _chains_of(self, names: Sequence[str]) -> list[Chain]:
        """Each once."""
        return list(dict.fromkeys(self.chains[name] for name in names))

    def is_complete(self, name: str) -> bool:
        """Whether the space of a contact mode holds all there is."""
        chain = self.chains[name]
        exhausted = self._zero_suffices and chain.latest.shape[1] + self._augmentation.latest.shape[1] == 0
        return exhausted or chain.span.shape[1] == self._problem.system.elastic_size

    def is_at_limit(self, name: str) -> bool:
        """Whether no more is to be tried for a contact mode."""
        chain = self.chains[name]
        most = MAX_VECTORS * min(2, sum(other is chain for other in self.chains.values()))
        return chain.grown_size >= most or self._shifts >= MAX_SHIFTS

    def has_grown(self, name: str, last: KrylovIterate | None) -> bool:
        """Whether the space of a contact mode has grown enough since the last iterate, or at all for a first one."""
        chain = self.chains[name]
        if last is None:
            return self._blocks > 1 and chain.span.shape[1] >= (self._problem.order_of(name) or 0)
        return chain.grown_size >= GROWTH_FACTORS[last.model.space.damping.ndim] * last.model.grown_size

    def iterate(self, name: str) -> KrylovIterate:
        """A contact mode balanced in its space."""
        problem, model = self._problem, self._projected(name)
        balanced = balanced_in(problem, model.space, model.inputs)
        self._orders[name] = choose_order(balanced.singular_values, problem.order_of(name), problem.tolerance)
        return KrylovIterate(model, balanced)

    def _projected(self, name: str) -> ProjectedModel:
        chain, last = self.chains[name], self._models.get(name)
        if (
            last is None
            or last.grown_size != chain.grown_size
            or len(last.space.coordinates) != self._problem.space.size
        ):
            space = self._problem.space.subspace(chain.span, chain.shared_size)
            last = ProjectedModel(chain.grown_size, space, space.coordinates.T @ self._project_inputs()[name])
            self._models[name] = last
        return last

    def _project_inputs(self) -> dict[str, Array]:
        """XᵀB of all contact modes, (k, p) each, computed together whenever the shared space has grown."""
        X = self._problem.space.basis
        if self._projected_inputs[0] != X.shape[1]:
            blocks = list(self.inputs.values())
            projected = split_like(self._problem.system.algebra.inner(X, np.hstack(blocks)), blocks)
            self._projected_inputs = X.shape[1], dict(zip(self.inputs, projected, strict=True))
        return self._projected_inputs[1]

    def _add(self, blocks: list[Array], names: Sequence[str]) -> None:
        """One more block of K⁻¹M, all contact modes in one solve: M times the latest directions."""
        with self._problem.stages("solves with K"):
            remaining = max(self.changes[name] for name in names)
            accuracy = min(SPACE_ACCURACY / max(remaining, SPACE_ACCURACY), LEAST_ACCURACY)
            solved = self._problem.factor.solve(np.hstack(blocks), accuracy)
        parts = self._coordinates(solved, blocks)
        self._augmentation.latest = self._augmentation.extend(parts[-1])
        for chain, part in zip(self._chains_of(names), parts, strict=False):
            chain.latest = chain.extend(part)
            chain.extend(parts[-1])
        self._blocks += 1

    def _add_shift(self, names: Sequence[str]) -> None:
        """Blocks of (s²M + sD + K)⁻¹ r at the worst frequency s, r what the space leaves of the response there."""
        system = self._problem.system
        with self._problem.stages("residuals"):
            residuals = self.relative_residuals(names, SAMPLE_COUNT)
        _, s = max((residual, ω) for of_mode in residuals.values() for ω, residual in of_mode.items())
        with self._problem.stages("factorisations at positive shifts"):
            factor = system.algebra.factor((s**2, system.mass), (s, system.damping), (1.0, system.stiffness))
        with closing(factor):
            for _ in range(POSITIVE_SHIFT_BLOCKS):
                parts = [np.hstack([r.real, r.imag]) for r in (self._residual(name, s) for name in names)]
                for name, part in zip(
                    names, self._coordinates(factor.solve(np.hstack(parts), SPACE_ACCURACY), parts), strict=True
                ):
                    self.chains[name].extend(part)
        self._shifts += 1

    def _coordinates(self, columns: Array, blocks: list[Array]) -> list[Array]:
        """Coordinates of columns that the shared space takes in, in parts as wide as the blocks."""
        with self._problem.stages("orthonormal basis"):
            coordinates = self._problem.space.add(columns)
        return split_like(coordinates, blocks)

    def relative_residuals(self, names: Sequence[str], count: int) -> dict[str, dict[float, float]]:
        """K⁻¹ times the residual of each contact mode's frequency response beside it, by frequency in rad/s.

        For all inputs acting together, at so many frequencies; one block of solves.
        """
        samples, responses, forces = [], [], []
        for name in names:
            model, B = self._projected(name), self.inputs[name]
            all_inputs = np.full((B.shape[1], 1), B.shape[1] ** -0.5)
            for ω in sample_frequencies(model.space.eigenvalues, self._orders[name], count):
                samples.append((name, float(ω)))
                responses.append(model.response(ω) @ all_inputs)
                forces.append(B @ all_inputs)
        system, X = self._problem.system, self._problem.space.basis
        y = np.hstack(responses)
        frequencies = np.array([ω for _, ω in samples])
        remaining = np.hstack(forces) - dynamic_product(system, apply_to_complex(X.__matmul__, y), frequencies)
        solved = self._problem.factor.solve(remaining, MEASURE_ACCURACY)
        ratios = mass_norms(system, solved) / np.linalg.norm(y, axis=0)
        residuals: dict[str, dict[float, float]] = {name: {} for name in names}
        for (name, ω), ratio in zip(samples, ratios, strict=True):
            residuals[name][ω] = float(ratio)
        return residuals

    def _residual(self, name: str, ω: float) -> Array:
        """B - (K + iωD - ω²M) x of the response x of a contact mode in its space, (rows here, p)."""
        x = apply_to_complex(self._problem.space.basis.__matmul__, self._projected(name).response(ω))
        return self.inputs[name] - dynamic_product(self._problem.system, x, np.full(x.shape[1], ω))


def directions_by_residual(
    problem: ReductionProblem, names: Sequence[str], augmentation: KrylovAugmentation
) -> Iterator[tuple[str, RankedBasis]]:
    """Each contact mode balanced in the first space that leaves next to nothing of its frequency response.

    For contact modes that share eigenvectors: two or three blocks do, and one balancing each.
    """
    krylov = KrylovSpaces(problem, names, augmentation, together=False)
    count = HIGHEST_SAMPLE if problem.system.rayleigh is not None else SAMPLE_COUNT
    waiting = list(names)
    while waiting:
        krylov.grow(waiting)
        for name in waiting:
            if problem.order_of(name) is None:
                krylov.iterate(name)
        with problem.stages("residuals"):
            residuals = krylov.relative_residuals(waiting, count)
        for name in list(waiting):
            largest = 0.0 if krylov.is_complete(name) else max(residuals[name].values())
            krylov.changes[name] = min(largest, 1.0)
            if largest <= CONVERGENCE_TOLERANCE or krylov.is_at_limit(name):
                waiting.remove(name)
                with problem.stages("balancing"):
                    iterate = krylov.iterate(name)
                yield name, _ranked_with_warning(problem, name, iterate, largest)


def directions_by_change(
    problem: ReductionProblem, names: Sequence[str], augmentation: KrylovAugmentation
) -> Iterator[tuple[str, RankedBasis]]:
    """Each contact mode balanced in the first space whose σ and frequency responses are those of the one before.

    Names that the problem does not ask for were finished before: the space is what it was with them.
    """
    krylov = KrylovSpaces(problem, names, augmentation, together=True)
    iterates: dict[str, KrylovIterate | None] = dict.fromkeys(name for name in names if name in problem.contacts)
    while iterates:
        for name, last in list(iterates.items()):
            ended = krylov.is_complete(name) or krylov.is_at_limit(name)
            if not ended and not krylov.has_grown(name, last):
                continue
            with problem.stages("balancing"):
                iterate = krylov.iterate(name)
                change = 1.0 if last is None else iterate.change_since(last, problem.order_of(name), problem.tolerance)
            if change > CONVERGENCE_TOLERANCE and not ended:
                iterates[name], krylov.changes[name] = iterate, min(change, 1.0)
                continue
            del iterates[name]
            yield name, _ranked_with_warning(problem, name, iterate, change if not krylov.is_complete(name) else 0.0)
        if iterates:
            krylov.grow(list(iterates))


def _ranked_with_warning(problem: ReductionProblem, name: str, iterate: KrylovIterate, change: float) -> RankedBasis:
    """The directions, and a message where they have not converged."""
    space = iterate.model.space
    if change > WARNING_CHANGE:
        problem.messages.append(
            f"contact mode {name!r}: its Hankel singular values or frequency responses are known to {change:.0e} only, "
            f"as the largest Krylov space, of {len(space.eigenvalues)} vectors, did not settle them: the model may "
            "lack directions; its validation says how good it is, and a lower order is surer"
        )
    return ranked_basis(space, iterate.balanced)
