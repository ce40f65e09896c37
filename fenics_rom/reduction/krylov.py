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

from fenics_rom.reduction.balancing import Balanced, order_of
from fenics_rom.reduction.common_basis import Subspace, orthogonal_complement, padded
from fenics_rom.reduction.frequency_response import dynamic_product, mass_norms, response
from fenics_rom.reduction.krylov_augmentation import Company
from fenics_rom.reduction.problem import RankedBasis, ReductionProblem
from fenics_rom.reduction.realization import balanced_in, directions_of
from fenics_rom.system.complex_columns import apply_to_complex
from fenics_rom.system.protocols import Array

SETTLED = 1e-7  # relative change of σ, and of frequency responses, between two looks that ends the growth of a space
NEGLIGIBLE = 1e-9  # share of σ_1 below which σ need not settle in all their digits
GROWTH = {1: 1.1, 2: 1.5}  # of a space between two looks at it, for diagonal and dense damping: those take longer
MOST_VECTORS = 400  # of a contact mode's space, shared eigenvectors not counted
ZERO_BLOCKS = 15  # before the first positive shift
SHIFT_BLOCKS = 3  # at each positive shift
MOST_SHIFTS = 20
UNREST = 1e-6  # a change that is told
SAMPLES = 12  # frequencies at which spaces are compared
TOP = 1  # sample, of the highest frequency: with eigenvectors in the space, where it is worst


class Chain:
    """The part of the shared space that belongs to one contact mode, and its latest directions.

    Args:
        shared: (k, r) coordinates that it starts with, the first unit vectors.
    """

    def __init__(self, shared: Array):
        self.span = shared
        self.latest = shared[:, :0]
        self.shared = shared.shape[1]

    @property
    def own(self) -> int:
        """Number of directions beyond those it started with."""
        return self.span.shape[1] - self.shared

    def extend(self, coordinates: Array) -> Array:
        """Takes coordinates (k, any) in, and returns the directions (k, new) that they add."""
        span = padded(self.span, len(coordinates))
        new = orthogonal_complement(coordinates, span)
        self.span = np.hstack([span, new])
        return new


@dataclass(frozen=True)
class Projection:
    """A contact mode projected onto its space of the moment.

    Attributes:
        own: number of directions of that space that are not shared eigenvectors.
        space: that space.
        inputs: B in it, (r, p).
    """

    own: int
    space: Subspace
    inputs: Array

    def response(self, ω: float) -> Array:
        """Amplitudes at ω in rad/s, (k, p) in the shared space."""
        return self.space.coordinates @ response(self.space.eigenvalues, self.space.damping, self.inputs, ω)


@dataclass(frozen=True)
class KrylovIterate:
    """A projection and its balanced realization."""

    projection: Projection
    balanced: Balanced

    def change_since(self, last: "KrylovIterate", order: int | None, tolerance: float) -> float:
        """Largest relative change of the σ that count and of sampled frequency responses; 1 where too few are there."""
        σ = self.balanced.singular_values
        m = min(order_of(σ, order, tolerance), len(σ))
        gaps, sizes = [], []
        for ω in sample_frequencies(self.projection.space.eigenvalues, m):
            y = self.projection.response(ω)
            gaps.append(np.linalg.norm(y - padded(last.projection.response(ω), len(y))))
            sizes.append(np.linalg.norm(y))
        return max(change_of(σ, last.balanced.singular_values, order, tolerance), float(max(gaps) / max(sizes)))


def change_of(σ: Array, before: Array, order: int | None, tolerance: float) -> float:
    """Largest relative change of the σ that an order or a tolerance makes count; 1 where there were too few before."""
    m = order_of(σ, order, tolerance)
    if len(before) < min(m, int(np.sum(σ > NEGLIGIBLE * σ[0]))):
        return 1.0
    m = min(m, len(before), len(σ))
    return float((np.abs(σ[:m] - before[:m]) / (σ[:m] + NEGLIGIBLE * σ[0])).max())


def sample_frequencies(γ: Array, order: int | None, count: int = SAMPLES) -> Array:
    """Frequencies in rad/s between resonances, from below the first to the last that the reduced model is for."""
    ω = np.sqrt(γ[: order or len(γ)])
    between = np.sqrt(ω * np.concatenate([ω[:1] / 4, ω[:-1]]))
    return between[np.unique(np.geomspace(len(ω), 1, count).astype(int)) - 1]


class KrylovSpaces:
    """Krylov spaces of some contact modes, all in the problem's shared space.

    Args:
        problem: what is reduced.
        names: of the contact modes.
        krylov_augmentation: columns that belong to the space of every contact mode.
    """

    def __init__(self, problem: ReductionProblem, names: Sequence[str], krylov_augmentation: Company):
        system, shared = problem.system, problem.space
        self._problem = problem
        self.inputs = {name: system.forces(name) for name in names}
        V = np.eye(shared.size)[:, : shared.eigenvectors]
        self.chains = {name: Chain(V) for name in names}
        self._company = Chain(V)
        self._orders = {name: problem.order_of(name) for name in names}  # where a tolerance decides, of the last look
        self._seen: tuple[int, dict[str, Array]] = (-1, {})
        self._projections: dict[str, Projection] = {}
        self._shifts = 0
        self._blocks = 0
        self._zero_suffices = krylov_augmentation.complete
        self._add([*self.inputs.values(), krylov_augmentation.columns])

    def grow(self, names: Sequence[str]) -> None:
        """Adds a block, or blocks at a positive shift, for those contact modes that still need it."""
        if self._zero_suffices or self._blocks < ZERO_BLOCKS:
            chains = [*(self.chains[name] for name in names), self._company]
            latest = [padded(chain.latest, self._problem.space.size) for chain in chains]
            columns = self._problem.space.mass_times_basis @ np.hstack(latest)
            self._add(_split(columns, latest), names)
        else:
            self._add_shift(names)

    def complete(self, name: str) -> bool:
        """Whether the space of a contact mode holds all there is."""
        chain = self.chains[name]
        ended = self._zero_suffices and chain.latest.shape[1] + self._company.latest.shape[1] == 0
        return ended or chain.span.shape[1] == self._problem.system.elastic_size

    def at_limit(self, name: str) -> bool:
        """Whether no more is to be tried for a contact mode."""
        return self.chains[name].own >= MOST_VECTORS or self._shifts >= MOST_SHIFTS

    def worth_a_look(self, name: str, last: KrylovIterate | None) -> bool:
        """Whether the space of a contact mode has grown enough since the last look, or at all for a first one."""
        chain = self.chains[name]
        if last is None:
            return self._blocks > 1 and chain.span.shape[1] >= (self._problem.order_of(name) or 0)
        return chain.own >= GROWTH[last.projection.space.damping.ndim] * last.projection.own

    def look(self, name: str) -> KrylovIterate:
        """A contact mode balanced in its space."""
        problem, found = self._problem, self._projection(name)
        balanced = balanced_in(problem, found.space, found.inputs)
        self._orders[name] = order_of(balanced.singular_values, problem.order_of(name), problem.tolerance)
        return KrylovIterate(found, balanced)

    def _projection(self, name: str) -> Projection:
        chain, last = self.chains[name], self._projections.get(name)
        if last is None or last.own != chain.own or len(last.space.coordinates) != self._problem.space.size:
            space = self._problem.space.subspace(chain.span, chain.shared)
            last = Projection(chain.own, space, space.coordinates.T @ self._seen_inputs()[name])
            self._projections[name] = last
        return last

    def _seen_inputs(self) -> dict[str, Array]:
        """XᵀB of all contact modes, (k, p) each, computed together whenever the shared space has grown."""
        X = self._problem.space.basis
        if self._seen[0] != X.shape[1]:
            seen = self._problem.system.algebra.inner(X, np.hstack(list(self.inputs.values())))
            self._seen = X.shape[1], dict(zip(self.inputs, _split(seen, list(self.inputs.values())), strict=True))
        return self._seen[1]

    def _add(self, blocks: list[Array], names: Sequence[str] | None = None) -> None:
        """One more block of K⁻¹M, all contact modes in one solve: M times the latest directions."""
        names = list(self.inputs) if names is None else names
        with self._problem.stages("solves with K"):
            solved = self._problem.factor.solve(np.hstack(blocks))
        parts = self._coordinates(solved, blocks)
        self._company.latest = self._company.extend(parts[-1])
        for name, part in zip(names, parts, strict=False):
            chain = self.chains[name]
            chain.latest = chain.extend(part)
            chain.extend(parts[-1])
        self._blocks += 1

    def _add_shift(self, names: Sequence[str]) -> None:
        """Blocks of (s²M + sD + K)⁻¹ r at the worst frequency s, r what the space leaves of the response there."""
        system = self._problem.system
        with self._problem.stages("residuals"):
            gaps = self.gaps(names, SAMPLES)
        _, s = max((gap, ω) for of_mode in gaps.values() for ω, gap in of_mode.items())
        with self._problem.stages("factorisations at positive shifts"):
            factor = system.algebra.factor((s**2, system.mass), (s, system.damping), (1.0, system.stiffness))
        with closing(factor):
            for _ in range(SHIFT_BLOCKS):
                residuals = [self._residual(name, s) for name in names]
                parts = [np.hstack([r.real, r.imag]) for r in residuals]
                for name, part in zip(names, self._coordinates(factor.solve(np.hstack(parts)), parts), strict=True):
                    self.chains[name].extend(part)
        self._shifts += 1

    def _coordinates(self, columns: Array, like: list[Array]) -> list[Array]:
        """Coordinates of columns that the shared space takes in, in parts as wide as those."""
        with self._problem.stages("orthonormal basis"):
            coordinates = self._problem.space.add(columns)
        return _split(coordinates, like)

    def gaps(self, names: Sequence[str], count: int) -> dict[str, dict[float, float]]:
        """K⁻¹ times the residual of each contact mode's frequency response beside it, by frequency in rad/s.

        For all inputs acting together, at so many frequencies; one block of solves.
        """
        where, responses, residuals = [], [], []
        for name in names:
            found, B = self._projection(name), self.inputs[name]
            all_inputs = np.full((B.shape[1], 1), B.shape[1] ** -0.5)
            for ω in sample_frequencies(found.space.eigenvalues, self._orders[name], count):
                where.append((name, float(ω)))
                responses.append(found.response(ω) @ all_inputs)
                residuals.append(B @ all_inputs)
        system, X = self._problem.system, self._problem.space.basis
        y = np.hstack(responses)
        left = np.hstack(residuals) - dynamic_product(
            system, apply_to_complex(X.__matmul__, y), np.array([ω for _, ω in where])
        )
        left = self._problem.factor.solve(left)
        gaps: dict[str, dict[float, float]] = {name: {} for name in names}
        for (name, ω), gap in zip(where, mass_norms(system, left) / np.linalg.norm(y, axis=0), strict=True):
            gaps[name][ω] = float(gap)
        return gaps

    def _residual(self, name: str, ω: float) -> Array:
        """B - (K + iωD - ω²M) x of the response x of a contact mode in its space, (rows here, p)."""
        x = apply_to_complex(self._problem.space.basis.__matmul__, self._projection(name).response(ω))
        return self.inputs[name] - dynamic_product(self._problem.system, x, np.full(x.shape[1], ω))


def _split(columns: Array, like: Sequence[Array]) -> list[Array]:
    """Columns in parts as wide as those."""
    return np.split(columns, np.cumsum([block.shape[1] for block in like])[:-1], axis=1)


def directions_by_residual(
    problem: ReductionProblem, names: Sequence[str], krylov_augmentation: Company
) -> Iterator[tuple[str, RankedBasis]]:
    """Each contact mode balanced in the first space that leaves next to nothing of its frequency response.

    For contact modes that share eigenvectors: two or three blocks do, and one balancing each.
    """
    krylov = KrylovSpaces(problem, names, krylov_augmentation)
    count = TOP if problem.system.rayleigh is not None else SAMPLES
    waiting = list(names)
    while waiting:
        krylov.grow(waiting)
        for name in waiting:
            if problem.order_of(name) is None:
                krylov.look(name)
        with problem.stages("residuals"):
            gaps = krylov.gaps(waiting, count)
        for name in list(waiting):
            gap = 0.0 if krylov.complete(name) else max(gaps[name].values())
            if gap <= SETTLED or krylov.at_limit(name):
                waiting.remove(name)
                with problem.stages("balancing"):
                    look = krylov.look(name)
                yield name, _told(problem, name, look, gap)


def directions_by_change(
    problem: ReductionProblem, names: Sequence[str], krylov_augmentation: Company
) -> Iterator[tuple[str, RankedBasis]]:
    """Each contact mode balanced in the first space whose σ and frequency responses are those of the one before."""
    krylov = KrylovSpaces(problem, names, krylov_augmentation)
    looks: dict[str, KrylovIterate | None] = dict.fromkeys(names)
    while looks:
        for name, last in list(looks.items()):
            ended = krylov.complete(name) or krylov.at_limit(name)
            if not ended and not krylov.worth_a_look(name, last):
                continue
            with problem.stages("balancing"):
                look = krylov.look(name)
                change = 1.0 if last is None else look.change_since(last, problem.order_of(name), problem.tolerance)
            if change > SETTLED and not ended:
                looks[name] = look
                continue
            del looks[name]
            yield name, _told(problem, name, look, change if not krylov.complete(name) else 0.0)
        if looks:
            krylov.grow(list(looks))


def _told(problem: ReductionProblem, name: str, look: KrylovIterate, change: float) -> RankedBasis:
    """The directions, and a message where they have not settled."""
    space = look.projection.space
    if change > UNREST:
        problem.messages.append(
            f"contact mode {name!r}: Hankel singular values or frequency responses still changed by {change:.0e} in "
            f"the last Krylov space, of {space.size} vectors; ask for a lower order"
        )
    return directions_of(space, look.balanced)
