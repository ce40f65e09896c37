"""From an input matrix to its balanced realization, by any of the routes to the Gramians."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from fenics_rom.reduction.balancing import Balanced, balance, balance_as_printed
from fenics_rom.reduction.gramians import controllability, observability, textbook_gramians
from fenics_rom.reduction.subspace import Subspace, krylov_spaces
from fenics_rom.system import Array, Factor, System

SETTLED = 1e-9  # relative change of σ between Krylov spaces that ends their growth
NEGLIGIBLE = 1e-12  # share of σ_1 below which σ is not waited for
MOST_VECTORS = 400  # of a Krylov space: a body that needs more is not one for shifts at zero alone


@dataclass(frozen=True)
class Realization:
    """A balanced realization of one input matrix.

    Attributes:
        space: the subspace that it is in.
        balanced: σ, T and its left inverse in the coordinates of that subspace.
        unrest: relative change of σ since the Krylov space before; 0 where nothing is left to come.
    """

    space: Subspace
    balanced: Balanced
    unrest: float


def realization(
    system: System,
    factor: Factor,
    B: Array,
    *,
    weighting: str,
    route: str,
    whole: Subspace | None,
    order: int | None,
) -> Realization:
    """Balances one input matrix.

    Args:
        system: the full-order model.
        factor: of K.
        B: (rows here, p) input matrix.
        weighting: what of the shape counts: "mass", "nodal" or "outputs".
        route: "closed-form", "bartels-stewart" or "as-printed" in `whole`, else "krylov".
        whole: all eigenvectors, for the routes that take them.
        order: number of σ that must have settled; all that matter where it is None.
    """

    def realize(space: Subspace) -> Balanced:
        weight = _weight(system, space.basis, weighting)
        if route in ("bartels-stewart", "as-printed"):
            return _textbook(system, space, B, weight, balance if route == "bartels-stewart" else balance_as_printed)
        G = system.algebra.inner(space.basis, B)
        γ, damping = space.eigenvalues, space.damping
        return balance(controllability(γ, damping, G), observability(γ, damping, weight))

    if whole is not None:
        return Realization(whole, realize(whole), 0.0)
    start = np.hstack([B, *system.outputs.values()]) if weighting == "outputs" else B
    return _settled(krylov_spaces(system, factor, start), realize, order)


def _textbook(
    system: System, whole: Subspace, B: Array, weight: Array, balanced: Callable[[Array, Array], Balanced]
) -> Balanced:
    """Balanced realization of the gathered matrices, brought to the coordinates of all eigenvectors."""
    identity = np.eye(system.size)[system.algebra.rows()]
    M, D, K, B, V = (
        system.algebra.gather(block)
        for block in (*(A @ identity for A in (system.mass, system.damping, system.stiffness)), B, whole.basis)
    )
    MV = M @ V  # the inverse of Vᵀ
    plain = balanced(*textbook_gramians(M, D, K, B, MV @ weight @ MV.T))
    return Balanced(plain.singular_values, MV.T @ plain.transformation, plain.left_inverse @ V)


def _settled(spaces: Iterator[Subspace], realize: Callable[[Subspace], Balanced], order: int | None) -> Realization:
    """In the first space whose σ are those of the space before it, or in the last one."""
    previous, change = np.empty(0), 1.0
    for space in spaces:
        balanced = realize(space)
        σ = balanced.singular_values
        waited_for = min(len(σ), order if order is not None else int(np.sum(σ > NEGLIGIBLE * σ[0])))
        known = min(waited_for, len(previous))
        unrest = np.abs(σ[:known] - previous[:known]) / (σ[:known] + NEGLIGIBLE / SETTLED * σ[0])
        change = float(unrest.max(initial=0.0)) if known == waited_for else 1.0
        if change <= SETTLED or len(space.eigenvalues) >= MOST_VECTORS:
            return Realization(space, balanced, change)
        previous = σ
    return Realization(space, balanced, 0.0)  # the space holds all that can be reached


def _weight(system: System, X: Array, weighting: str) -> Array:
    """Xᵀ Cᵀ C X of the output that counts."""
    if weighting == "mass":
        return np.eye(X.shape[1])
    if weighting == "nodal":
        return system.algebra.inner(X, X)
    seen = system.algebra.inner(X, np.hstack(list(system.outputs.values())))
    return seen @ seen.T
