"""Loads that follow the body, in reduced coordinates: exactly what they are at full order."""

from collections.abc import Iterable

import numpy as np

from fenics_rom.rom.deformation import ReducedTendon, monomials
from fenics_rom.system.protocols import Algebra, Array, Deformation


def project_pressures(body: Deformation, algebra: Algebra, W: Array, names: Iterable[str]) -> dict[str, Array]:
    """Forces of 1 Pa as polynomials of q, (m, 1 + m + m (m+1)/2) for `monomials(q)`.

    ∫ cof(F) N · δ dS is of second degree in the displacement. So values at rest, at plus and minus each basis vector
    and at each sum of two are all there is to know (polarisation).

    Args:
        body: at full order.
        algebra: what sums over the ranks.
        W: basis (rows here, m).
        names: of the pressures.
    """
    names, m = list(names), W.shape[1]
    if not names:
        return {}
    length = float(algebra.inner(np.ones((len(body.weights), 1)), body.weights[:, None])[0, 0]) ** (1 / 3)
    unit = length / algebra.maximum(np.abs(W).max(axis=0, initial=0.0))  # of q, for entries of all degrees alike

    def forces(q: Array) -> Array:
        """Of all pressures, (pressures, m)."""
        columns = body.follower(W @ (unit * q))
        return algebra.inner(np.hstack([columns[name] for name in names]), W)

    e = np.eye(m)
    at_rest = forces(np.zeros(m))
    plus, minus = (np.array([forces(sign * e[i]) for i in range(m)]) for sign in (1.0, -1.0))
    linear, quadratic = (plus - minus) / 2, (plus + minus) / 2 - at_rest
    mixed = [
        quadratic[i] if i == j else forces(e[i] + e[j]) - at_rest - linear[i] - linear[j] - quadratic[i] - quadratic[j]
        for i, j in zip(*np.triu_indices(m), strict=True)
    ]
    coefficients = np.stack([at_rest, *linear, *mixed], axis=-1) / monomials(unit)
    return dict(zip(names, coefficients, strict=True))


def project_tendons(body: Deformation, algebra: Algebra, W: Array) -> dict[str, ReducedTendon]:
    """Tendons through points of the body, whose displacements are shapesᵀW q."""
    return {name: ReducedTendon(points, algebra.inner(shapes, W)) for name, (points, shapes) in body.tendons.items()}
