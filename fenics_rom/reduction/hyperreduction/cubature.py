"""Which points of the body a reduced model keeps, and with what weights: energy-conserving sampling and weighting.

ECSW (Farhat, Avery, Chapman & Cortial, 2014; Farhat, Chapman & Avery, 2015) looks for few weights ω >= 0 with
G ω ≈ G 1, where a column of G holds what one point contributes to the reduced forces of states that were seen. As the
kept points have an energy, with positive weights, the reduced model is as passive as the whole one.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy import ndarray as Array

from fenics_rom.errors import SolverError
from fenics_rom.mechanics.hyperelastic import small_strain, strain
from fenics_rom.mechanics.voigt import VOIGT_INDEX
from fenics_rom.system.protocols import Algebra, Deformation

POINTS_AT_ONCE = 4096  # whose contributions are worked on together
MIN_STATES, MAX_STATES = 8, 64  # that the weights are fitted to
STATE_ROWS = 2560  # of all states together, or more for MIN_STATES
STIFFNESS_SHARE = 0.3  # that the stiffness at rest counts beside all states together
STIFFNESS_PROBES = 800  # of the stiffness at rest, where it has more entries
SMALLEST_STATE = 1e-3  # share of the largest: smaller ones are served by the stiffness at rest
COMPRESSION_TOLERANCE = 0.01  # share of the tolerance that compressed rows may leave out
TOLERANCE_FACTORS = (1.0, 0.7, 0.4, 0.1)  # tried one after the other, while what they left out is too much
WEIGHT_ROUND_OFF = 1e-13  # share of the largest product with the right-hand side below which no weight helps any more


@dataclass(frozen=True)
class Cubature:
    """The points of this rank that have a weight."""

    points: Array  # (K here,) which of this rank's
    weights: Array  # ω (K here,), > 0
    error: float  # |G ω - G 1| / |G 1|


def fit_cubature(
    body: Deformation, algebra: Algebra, gradients: Array, γ: Array, states: Array, tolerance: float
) -> Cubature:
    """Points and weights for the forces of states and for the stiffness at rest.

    Rows of G are a force f as K^-½ f, K the stiffness of the strains (AᵀC₀A) in its state, so that errors count by the
    energy of the motion they cause there: in a bent body what is stiff has turned. Each state q (m, s) counts alike,
    whatever its size, beside the stiffness at rest. `gradients` (3, 3, P here, m) and γ (m,) are of the basis.

    Raises:
        SolverError: no weights reach the tolerance.
    """
    sizes = np.linalg.norm(states, axis=0)
    count = max(MIN_STATES, min(MAX_STATES, STATE_ROWS // len(γ)))
    fitted = spread_states(states[:, sizes > SMALLEST_STATE * sizes.max()], count)
    rows = _ForceRows(body, algebra, gradients, γ, fitted)
    U = rows.left_singular_vectors(COMPRESSION_TOLERANCE * tolerance)
    first = algebra.row_offset(gradients.shape[2])
    here = slice(first, first + gradients.shape[2])
    compressed = algebra.gather(np.hstack([U.T @ block for _, block in rows]).T).T
    for factor in TOLERANCE_FACTORS:
        ω = sparse_weights(compressed, U.T @ rows.whole, factor * tolerance)[here]
        points, error = np.flatnonzero(ω), rows.error(ω)
        if error <= tolerance:
            return Cubature(points, ω[points], error)
    raise SolverError(
        f"cubature: no positive weights of fewer points than all reach the tolerance {tolerance:g}, only {error:.1e}; "
        "a larger reduction.cubature, a lower order or a finer mesh may help"
    )


def spread_states(states: Array, count: int) -> Array:
    """That many of some states (m, s), the largest and then always the farthest from those selected."""
    if states.shape[1] <= count:
        return states
    squares = (states**2).sum(axis=0)
    selected = [int(squares.argmax())]
    distance = np.full(states.shape[1], np.inf)
    while len(selected) < count:
        new = states[:, selected[-1]]
        distance = np.minimum(distance, squares - 2 * new @ states + new @ new)
        selected.append(int(distance.argmax()))
    return states[:, selected]


class _ForceRows:
    """G, block of points by block: too large to be kept."""

    def __init__(self, body: Deformation, algebra: Algebra, gradients: Array, γ: Array, states: Array):
        self._body, self._algebra, self._gradients, self._γ, self._states = body, algebra, gradients, γ, states
        self._left, self._right = _stiffness_probes(len(γ))
        self._roots = [self._inverse_root(q) for q in states.T]
        self._scales = np.ones(states.shape[1] + 1)
        forces = self._weighted_sum(np.ones(1))
        m, count = states.shape
        sizes = np.linalg.norm(forces[: count * m].reshape(count, m), axis=1)
        self._scales = np.append(1 / sizes, STIFFNESS_SHARE * np.sqrt(count) / np.linalg.norm(forces[count * m :]))
        self.whole = self._weighted_sum(np.ones(1))

    def __iter__(self) -> Iterator[tuple[slice, Array]]:
        return ((here, self._block(here)) for here in self._blocks())

    def _blocks(self) -> Iterator[slice]:
        """As many on every rank, as all of them add what they have of each."""
        most = int(self._algebra.maximum(float(self._gradients.shape[2])))
        return (slice(k, k + POINTS_AT_ONCE) for k in range(0, most, POINTS_AT_ONCE))

    def _block(self, here: slice) -> Array:
        """Columns of G (rows, points)."""
        body, G = self._body, self._gradients[:, :, here]
        material, w = body.material.at(here), body.weights[here]
        root = 1 / np.sqrt(self._γ)
        blocks = []
        for q, scale, inverse_root in zip(self._states.T, self._scales, self._roots, strict=False):
            H = G @ q
            S = material.stress(strain(H))
            P = np.einsum("ikp,kjp->ijp", H + np.eye(3)[:, :, None], S[VOIGT_INDEX])
            blocks.append(scale * inverse_root @ (w * np.einsum("ijp,ijpm->mp", P, G, optimize=True)))
        left, right = (small_strain(G @ (root[:, None] * probes)) for probes in (self._left, self._right))
        stiffness = np.einsum("cpk,cpk->kp", material.linear_stress(left), right) * w
        return np.vstack([*blocks, self._scales[-1] * stiffness])

    def _inverse_root(self, q: Array) -> Array:
        """(AᵀC₀A)^-½ (m, m), A the rates of the strains at q; what strains nothing has no forces, and counts for 0."""
        body, m, K = self._body, len(q), np.zeros((len(q), len(q)))
        for here in self._blocks():
            G, w = self._gradients[:, :, here], body.weights[here]
            F = G @ q + np.eye(3)[:, :, None]
            A = small_strain(np.einsum("kip,kjpm->ijpm", F, G, optimize=True))
            stressed = w[:, None] * body.material.at(here).linear_stress(A)
            K += self._algebra.inner(*(of.reshape(-1, m) for of in (A, stressed)))
        λ, E = np.linalg.eigh((K + K.T) / 2)
        some = λ > len(λ) * np.finfo(float).eps * λ[-1]
        root: Array = E[:, some] / np.sqrt(λ[some]) @ E[:, some].T
        return root

    def _weighted_sum(self, ω: Array) -> Array:
        """G ω (rows,), of all ranks; ω (1,) or (P here,)."""
        ω = np.broadcast_to(ω, self._gradients.shape[2])
        total = sum(self._algebra.inner(block.T, ω[here, None])[:, 0] for here, block in self)
        return np.asarray(total)

    def error(self, ω: Array) -> float:
        """|G ω - G 1| / |G 1|."""
        return float(np.linalg.norm(self._weighted_sum(ω) - self.whole) / np.linalg.norm(self.whole))

    def left_singular_vectors(self, share: float) -> Array:
        """Left singular vectors of G, all but what is less than a share of |G 1| together."""
        gram = np.asarray(sum(self._algebra.inner(block.T, block.T) for _, block in self))
        λ, U = np.linalg.eigh(gram)
        neglected = np.sqrt(np.cumsum(np.maximum(λ, 0.0)))
        return U[:, neglected > share * np.linalg.norm(self.whole)]


def _stiffness_probes(m: int) -> tuple[Array, Array]:
    """Vectors (m, k), whose products zᵀ A y with a symmetric A have its Frobenius norm: all its entries, or random."""
    i, j = np.triu_indices(m)
    if len(i) <= STIFFNESS_PROBES:
        return np.eye(m)[:, i], np.eye(m)[:, j] * np.where(i == j, 1.0, np.sqrt(2.0))
    z, y = np.random.default_rng(0).standard_normal((2, m, STIFFNESS_PROBES))
    return z, y / np.sqrt(STIFFNESS_PROBES)


def sparse_weights(A: Array, b: Array, tolerance: float) -> Array:
    """Weights x >= 0, few of them positive, with |A x - b| <= tolerance |b| where there are any.

    Lawson & Hanson (1974, algorithm 23.10) with the QR factors of the active columns updated, as ECSW uses it (Farhat,
    Avery, Chapman & Cortial, 2014): columns enter one by one, the one that points most along the residual first.
    The best there is where the tolerance cannot be met; a tolerance of 0 solves min |A x - b|, x >= 0.
    """
    active: list[int] = []
    x = np.empty(0)
    Q, R = np.eye(len(b)), np.empty((len(b), 0))
    residual, helpless = b, np.zeros(A.shape[1], dtype=bool)
    smallest_gain = WEIGHT_ROUND_OFF * np.abs(A.T @ b).max(initial=0.0)
    while np.linalg.norm(residual) > tolerance * np.linalg.norm(b) and len(active) < len(b):
        gain = A.T @ residual
        gain[active] = 0.0
        gain[helpless] = 0.0
        entering = int(gain.argmax())
        if gain[entering] <= smallest_gain:
            break
        Q, R = scipy.linalg.qr_insert(Q, R, A[:, entering], len(active), which="col")
        active, x = [*active, entering], np.append(x, 0.0)
        while active:
            best = scipy.linalg.solve_triangular(R[: len(active)], (b @ Q)[: len(active)])
            if (best > 0).all():
                x = best
                break
            falling = np.flatnonzero(best <= 0)
            x = x + (x[falling] / (x[falling] - best[falling])).min(initial=1.0) * (best - x)
            for k in reversed(falling[x[falling] <= WEIGHT_ROUND_OFF * x.max()]):
                Q, R = scipy.linalg.qr_delete(Q, R, k, which="col")
                x = np.delete(x, k)
                del active[k]
        if entering in active:
            residual, helpless[:] = b - A[:, active] @ x, False
        else:  # by round-off alone, and it would be again
            helpless[entering] = True
    weights = np.zeros(A.shape[1])
    weights[active] = x
    return weights
