"""System to ROM: for each contact mode, Gramians, balancing, a basis; then one shared basis for all of them."""

import warnings
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import replace

from fenics_rom.errors import FenicsRomWarning, SceneError
from fenics_rom.reduction.balancing import order_of, orthonormal_span
from fenics_rom.reduction.realization import SETTLED, Realization, realization
from fenics_rom.reduction.selection import EigenvectorSelection
from fenics_rom.reduction.shared_basis import Reduced, in_shared_basis
from fenics_rom.reduction.subspace import all_eigenvectors
from fenics_rom.rom import Rom, check_rom
from fenics_rom.scene import LYAPUNOV, SHARE, SWITCHINGS, TOLERANCE, WEIGHTINGS, Reduction, check_order
from fenics_rom.schema import unknown
from fenics_rom.system import System

DENSE_LIMIT = 1000  # unknowns up to which all eigenvectors are cheaper than a Krylov space
DEFAULT_TOLERANCE = 1e-6  # share of the sum of σ that is left out where neither order nor tolerance is given

Report = Callable[[str, int, int], None]  # stage, done, of


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
    with closing(system.algebra.factor((1.0, system.stiffness))) as factor:
        whole = all_eigenvectors(system) if route != "krylov" else None
        selection = EigenvectorSelection(system, share, whole)
        for done, name in enumerate(system.contacts):
            report("contact modes", done, len(system.contacts))
            wanted = order[name] if isinstance(order, Mapping) else order
            B = system.input_matrix(name)
            found = realization(system, factor, B, weighting=weighting, route=route, whole=whole, order=wanted)
            reduced[name] = _truncated(found, wanted, tolerance, name, messages)
            if switching == "modal":
                r = reduced[name]
                V = selection.select(r.T, r.σ[: r.T.shape[1]])
                reduced[name] = replace(r, W=V, T=V)
        report("contact modes", len(reduced), len(reduced))
        rom = in_shared_basis(system, factor, reduced, switching=switching, weighting=weighting, messages=messages)
    for message in messages:
        warnings.warn(message, FenicsRomWarning, stacklevel=2)
    return check_rom(rom)


def _choice(key: str, value: str, choices: tuple[str, ...]) -> str:
    if value not in choices:
        raise SceneError(f"{key}: {unknown('choice', value, list(choices))}")
    return value


def _truncated(found: Realization, order: int | None, tolerance: float, name: str, messages: list[str]) -> Reduced:
    """The leading balanced directions, and what the user should know about them."""
    space, balanced = found.space, found.balanced
    σ, T = balanced.singular_values, balanced.transformation
    m = order_of(σ, order, tolerance)
    span = orthonormal_span(T, m)
    kept = span.shape[1]
    if found.unrest > SETTLED:
        messages.append(
            f"contact mode {name!r}: Hankel singular values still changed by {found.unrest:.0e} between the last "
            f"Krylov spaces, of {space.basis.shape[1]} vectors; ask for a lower order"
        )
    if kept < m:
        messages.append(f"contact mode {name!r}: order {m} was asked for, {kept} are numerically there and were kept")
    return Reduced(space.basis @ span, σ, space.basis @ T[:, :kept], balanced.left_inverse[:kept], space)
