"""System to ROM: for each contact mode, Gramians, balancing, a basis; then one shared basis for all of them."""

import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from fenics_rom.errors import FenicsRomWarning, SceneError
from fenics_rom.reduction.balancing import Balanced, balance, balance_as_printed, order_of, orthonormal_span
from fenics_rom.reduction.gramians import controllability, observability, textbook_gramians
from fenics_rom.reduction.selection import EigenvectorSelection
from fenics_rom.reduction.subspace import (
    Subspace,
    all_eigenvectors,
    damping_in,
    diagonalized,
    krylov_spaces,
    orthonormal_rest,
)
from fenics_rom.rom import Mode, Rom, check_rom, diagonalized_span
from fenics_rom.scene import LYAPUNOV, SHARE, SWITCHINGS, TOLERANCE, WEIGHTINGS, Reduction, check_order
from fenics_rom.schema import unknown
from fenics_rom.system import Array, Factor, System

DENSE_LIMIT = 1000  # unknowns up to which all eigenvectors are cheaper than a Krylov space
DEFAULT_TOLERANCE = 1e-6  # share of the sum of σ that is left out where neither order nor tolerance is given
SETTLED = 1e-9  # relative change of σ between Krylov spaces that ends their growth
MOST_VECTORS = 400  # of a Krylov space: a body that needs more is not one for shifts at zero alone
NEGLIGIBLE = 1e-12  # share of σ_1 below which σ is not waited for

Report = Callable[[str, int, int], None]  # stage, done, of


@dataclass(frozen=True)
class _Reduced:
    """One contact mode before the shared basis is known."""

    W: Array  # (rows here, m)
    σ: Array  # (r,)
    T: Array  # (rows here, m) what spans W, by falling importance: the balanced basis, or eigenvectors
    left: Array  # (m, k) P T̄⁻¹ in the subspace
    space: Subspace


def reduce(
    system: System,
    *,
    order: int | Mapping[str, int] | None = None,
    tolerance: float | None = None,
    switching: str | None = None,
    weighting: str | None = None,
    lyapunov: str | None = None,
    share: float | None = None,
    report: Report = lambda stage, done, of: None,
) -> Rom:
    """Reduces a full-order model for each of its contact modes; every rank must call it, every rank gets the ROM.

    What is None is taken from the scene's [reduction].

    Args:
        system: the full-order model.
        order: number of balanced displacements, one for all contact modes or by name.
        tolerance: instead of an order: share of the sum of Hankel singular values that may be left out.
        switching: "energy": the balanced bases themselves, switched by energy-orthogonal projection (any order, no
            loss of accuracy); "modal": the paper's selection of eigenvectors; "oblique": standard balanced truncation
            as the paper's (5)-(8) stand, from dense Gramians with their round-off, switched by their oblique
            projections, which can create energy: for comparison only.
        weighting: what of the shape counts: "mass" (the L² norm), "nodal" (all nodes alike, the paper's) or
            "outputs" (the named outputs only).
        lyapunov: route to the Gramians: "closed-form" in all eigenvectors, "bartels-stewart" (dense), "krylov", or
            "auto" (closed form up to 1,000 unknowns).
        share: of the covariance's trace that the eigenvectors of "modal" hold.
        report: called with the stage, how much of it is done, and of how much.

    Raises:
        SceneError: a choice that does not exist or does not fit the system.
        SolverError: undamped motions, or a solver that did not deliver.
    """
    chosen = system.scene.reduction if system.scene else Reduction()
    if order is None and tolerance is None:
        order, tolerance = chosen.order, chosen.tolerance
    check_order(order, system.contacts, "order")
    tolerance = DEFAULT_TOLERANCE if tolerance is None else TOLERANCE.check(tolerance, "tolerance")
    share = SHARE.check(chosen.share if share is None else share, "share")
    switching = _choice("switching", switching or chosen.switching, SWITCHINGS)
    weighting = _choice("weighting", weighting or chosen.weighting, WEIGHTINGS)
    route = _choice("lyapunov", lyapunov or chosen.lyapunov, LYAPUNOV)
    if switching == "oblique":
        route = "as-printed"
    elif route == "auto":
        route = "closed-form" if system.size <= DENSE_LIMIT else "krylov"
    if weighting == "outputs" and not system.outputs:
        raise SceneError("reduction.weighting = 'outputs', but the scene names no outputs")

    messages = list(system.warnings)
    reduced = {}
    factor = system.algebra.factor((1.0, system.stiffness))
    whole = all_eigenvectors(system) if route != "krylov" else None
    selection = EigenvectorSelection(system, share, whole)
    for done, name in enumerate(system.contacts):
        report("contact modes", done, len(system.contacts))
        wanted = order[name] if isinstance(order, Mapping) else order
        space, balanced, unrest = _balanced(system, factor, system.input_matrix(name), weighting, route, whole, wanted)
        if unrest > SETTLED:
            messages.append(
                f"contact mode {name!r}: Hankel singular values still changed by {unrest:.0e} between the last Krylov "
                f"spaces, of {space.basis.shape[1]} vectors; ask for a lower order"
            )
        reduced[name] = _truncated(space, balanced, wanted, tolerance, name, messages)
        if switching == "modal":
            r = reduced[name]
            V = selection.select(r.T, r.σ[: r.T.shape[1]])
            reduced[name] = replace(r, W=V, T=V)
    report("contact modes", len(reduced), len(reduced))
    rom = replace(_in_shared_basis(system, factor, reduced, switching, messages), weighting=weighting)
    factor.close()
    for message in messages:
        warnings.warn(message, FenicsRomWarning, stacklevel=2)
    return check_rom(rom)


def _choice(key: str, value: str, choices: tuple[str, ...]) -> str:
    if value not in choices:
        raise SceneError(f"{key}: {unknown('choice', value, list(choices))}")
    return value


def _balanced(
    system: System, factor: Factor, B: Array, weighting: str, route: str, whole: Subspace | None, order: int | None
) -> tuple[Subspace, Balanced, float]:
    """Balanced realization of one input matrix, the subspace that holds it, and by how much σ still changed there."""

    def realize(space: Subspace) -> Balanced:
        weight = _weight(system, space.basis, weighting)
        if route in ("bartels-stewart", "as-printed"):
            return _textbook(system, space, B, weight, balance if route == "bartels-stewart" else balance_as_printed)
        G = system.algebra.inner(space.basis, B)
        γ, damping = space.eigenvalues, space.damping
        return balance(controllability(γ, damping, G), observability(γ, damping, weight))

    if whole is not None:
        return whole, realize(whole), 0.0
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


def _settled(
    spaces: Iterator[Subspace], realize: Callable[[Subspace], Balanced], order: int | None
) -> tuple[Subspace, Balanced, float]:
    """The first space whose σ are those of the space before it, or the last one, and the relative change of σ there."""
    previous, change = np.empty(0), 1.0
    for space in spaces:
        balanced = realize(space)
        σ = balanced.singular_values
        waited_for = min(len(σ), order if order is not None else int(np.sum(σ > NEGLIGIBLE * σ[0])))
        known = min(waited_for, len(previous))
        unrest = np.abs(σ[:known] - previous[:known]) / (σ[:known] + NEGLIGIBLE / SETTLED * σ[0])
        change = float(unrest.max(initial=0.0)) if known == waited_for else 1.0
        if change <= SETTLED or len(space.eigenvalues) >= MOST_VECTORS:
            return space, balanced, change
        previous = σ
    return space, balanced, 0.0  # the space holds all that can be reached


def _weight(system: System, X: Array, weighting: str) -> Array:
    """Xᵀ Cᵀ C X of the output that counts."""
    if weighting == "mass":
        return np.eye(X.shape[1])
    if weighting == "nodal":
        return system.algebra.inner(X, X)
    seen = system.algebra.inner(X, np.hstack(list(system.outputs.values())))
    return seen @ seen.T


def _truncated(
    space: Subspace, balanced: Balanced, order: int | None, tolerance: float, name: str, messages: list[str]
) -> _Reduced:
    σ, T = balanced.singular_values, balanced.transformation
    m = order_of(σ, order, tolerance)
    span = orthonormal_span(T, m)
    kept = span.shape[1]
    if kept < m:
        messages.append(f"contact mode {name!r}: order {m} was asked for, {kept} are numerically there and were kept")
    return _Reduced(space.basis @ span, σ, space.basis @ T[:, :kept], balanced.left_inverse[:kept], space)


def _in_shared_basis(
    system: System, factor: Factor, reduced: Mapping[str, _Reduced], switching: str, messages: list[str]
) -> Rom:
    """All bases in one M-orthonormal Q that diagonalizes K; each mode then diagonalized in its own span."""
    algebra, scene = system.algebra, system.scene
    Q = np.empty((len(next(iter(reduced.values())).W), 0))
    for r in reduced.values():
        Q = np.hstack([Q, orthonormal_rest(system, r.W, Q)])
    joint = diagonalized(system, Q)
    Q, κ = joint.basis, joint.eigenvalues
    MQ = system.mass @ Q

    modes = {}
    for name, r in reduced.items():
        B = system.input_matrix(name)
        span, _ = np.linalg.qr(algebra.inner(MQ, r.W))
        γ, C = diagonalized_span(κ, span)
        W = Q @ C
        G = algebra.inner(W, B)
        T = algebra.inner(MQ @ C, r.T)  # in this mode's coordinates
        left = T @ r.left @ algebra.inner(r.space.basis, MQ) if switching == "oblique" else None
        statics = factor.solve(B)
        error = statics - W @ (G / γ[:, None])
        modes[name] = Mode(
            eigenvalues=γ,
            damping=damping_in(system, W, γ),
            inputs=G,
            coordinates=C,
            directions=np.linalg.qr(T / np.linalg.norm(T, axis=0))[0],
            hankel_singular_values=r.σ,
            left_inverse=left,
            static_error=_norm(system, error) / _norm(system, statics),
        )
    return Rom(
        name=scene.name if scene else "system",
        switching=switching,
        modes=modes,
        actuators={name: columns.shape[1] for name, columns in system.actuators.items()},
        basis=algebra.gather(Q),
        stiffness=κ,
        outputs={name: algebra.inner(C, Q) for name, C in system.outputs.items()},
        free=system.body.free,
        nodes=system.body.nodes,
        triangles=system.body.triangles,
        node_mass=system.body.node_mass,
        effects=scene.effects if scene else {},
        scene_text=scene.text if scene else "",
        tables=scene.tables if scene else {},
        warnings=tuple(messages),
    )


def _norm(system: System, block: Array) -> float:
    return float(np.sqrt(np.trace(system.algebra.inner(block, system.mass @ block))))
