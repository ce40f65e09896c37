"""Rigid motions: what a body that is not wholly held can do without straining, K R = 0.

They are kept exactly, split off M-orthogonally: with P = I - R RᵀM, whatever is said of stiffness and compliance is
said of the elastic rest, P x of displacements and Pᵀ f of loads (those that rigid motions do not feel).
"""

from typing import Any

import numpy as np
import scipy.linalg
from numpy import ndarray as Array

from fenics_rom.errors import SolverError, StructureError
from fenics_rom.system.body import Body
from fenics_rom.system.columns import probe_columns
from fenics_rom.system.protocols import Algebra, Factor, Operator

# Share of the mean eigenvalue, as energy of an M-orthonormal motion, that is round-off: assembled bodies are at 1e-16.
ENERGY_ROUND_OFF = 1e-13
LEAST_INDEPENDENCE = 1e-8  # smallest eigenvalue of the Gram matrix of columns of unit mass
CLEAR_OF_ROUND_OFF = 100  # times that energy, above which a motion strains the body without doubt
MOST_MOTIONS = 12  # that are looked for in a stiffness itself: of two pieces
SHIFT = 1e-8  # share of the mean eigenvalue that makes a singular stiffness definite meanwhile
# Share of wᵀ diag(K) w that wᵀKw of w = K⁻¹z is at most where K is singular: from motions that nothing holds round-off
# leaves 1e-16 to 1e-15, whatever a factor makes of them; K that holds all of them to 1e-12 still solves to 1e-4.
HELD_BY_ROUND_OFF = 1e-13


def mass_orthonormal(M: Operator, columns: Array, algebra: Algebra) -> Array:
    """R (rows here, ρ) of the same span as independent columns (rows here, ρ), with RᵀMR = I, kg^-1/2."""
    R = columns
    for _ in range(2 if columns.shape[1] else 0):  # once more for what a Gram matrix of columns far apart loses
        gram = algebra.inner(R, M @ R)
        sizes = np.sqrt(np.diag(gram))
        if not ((sizes > 0).all() and np.linalg.eigvalsh(gram / sizes[:, None] / sizes)[0] > LEAST_INDEPENDENCE):
            raise StructureError(f"rigid: its {len(sizes)} columns depend on each other")
        R = R @ np.linalg.inv(np.linalg.cholesky(gram)).T
    return R


def without_energy(M: Operator, K: Operator, motions: Array, algebra: Algebra) -> Array:
    """Those combinations of M-orthonormal motions (rows here, any) that K does not see, (rows here, ρ).

    Springs to the ground take some of the motions that the supports leave.
    """
    if not motions.shape[1]:
        return motions
    λ, U = np.linalg.eigh(algebra.inner(motions, K @ motions))
    free = λ <= ENERGY_ROUND_OFF * mean_eigenvalue(M, K, algebra)
    return motions if free.all() else motions @ U[:, free]


def checked_rigid_columns(M: Operator, K: Operator, columns: Array, algebra: Algebra) -> Array:
    """R of anyone's columns (rows here, ρ); refuses those that strain the body, with the measured number."""
    R = mass_orthonormal(M, columns, algebra)
    if R.shape[1]:
        energy = float(np.linalg.eigvalsh(algebra.inner(R, K @ R))[-1])
        scale = mean_eigenvalue(M, K, algebra)
        if not abs(energy) <= 1e3 * ENERGY_ROUND_OFF * scale:  # of anyone's columns, which may have fewer digits
            raise StructureError(
                f"rigid: stiffness sees these columns: RᵀKR is up to {energy:.1e} for RᵀMR = 1, of any columns about "
                f"{scale:.1e}; use columns that span its null space"
            )
    return R


def mean_eigenvalue(M: Operator, K: Operator, algebra: Algebra) -> float:
    """What zᵀKz / zᵀMz of any z is about, 1/s²."""
    z = probe_columns(algebra, 4)
    return float(np.trace(algebra.inner(z, K @ z)) / np.trace(algebra.inner(z, M @ z)))


def rigid_fields(points: Array, mass: Array) -> Array:
    """Translations by 1 and rotations of which the farthest of points (N, 3) feels 1, (3 N, 6); `mass` (N,), kg."""
    arms = points - mass @ points / mass.sum()
    arms /= np.linalg.norm(arms, axis=1).max()
    translations = np.broadcast_to(np.eye(3), (len(points), 3, 3))
    rotations = np.stack([np.cross(axis, arms) for axis in np.eye(3)], axis=2)
    return np.concatenate([translations, rotations], axis=2).reshape(-1, 6)


def motions_of_nodes(M: Operator, K: Operator, body: Body, algebra: Algebra) -> Array:
    """R (rows here, ρ), RᵀMR = I: those motions of a body's nodes as a whole that the stiffness does not see."""
    fields = rigid_fields(body.nodes, body.node_mass)[algebra.rows()]
    return without_energy(M, K, mass_orthonormal(M, fields, algebra), algebra)


def found_motions(M: Any, K: Any, shifted: Any, algebra: Algebra) -> Array:
    """R (rows here, ρ), RᵀMR = I, from the stiffness; no columns where it sees all motions, or is indefinite.

    `shifted(s)` is K + s M.

    Raises:
        StructureError: it cannot be told what strains the body and what is round-off.
    """
    rows, scale = algebra.rows(), mean_eigenvalue(M, K, algebra)
    count = min(MOST_MOTIONS + 1, int(algebra.total(rows.stop - rows.start)))
    try:
        _, V = algebra.eigenpairs(M, shifted(SHIFT * scale), count)
    except SolverError:  # not definite
        return np.empty((rows.stop - rows.start, 0))
    γ, U = np.linalg.eigh(algebra.inner(V, K @ V))
    is_zero = np.abs(γ) <= ENERGY_ROUND_OFF * scale
    if (~is_zero & (np.abs(γ) <= CLEAR_OF_ROUND_OFF * ENERGY_ROUND_OFF * scale)).any() or is_zero.sum() > MOST_MOTIONS:
        shares = ", ".join(f"{share:.0e}" for share in γ / scale)
        raise StructureError(
            "stiffness is not positive definite, and nobody can tell which motions it does not see: its lowest "
            f"eigenvalues are, as shares of the mean, {shares}; at most {MOST_MOTIONS} may be within "
            f"{ENERGY_ROUND_OFF:g}, the others above {CLEAR_OF_ROUND_OFF * ENERGY_ROUND_OFF:g}; give nodes, or rigid"
        )
    return mass_orthonormal(M, V @ U[:, is_zero], algebra)


def is_singular(K: Operator, diagonal: Array, factor: Factor, algebra: Algebra, fixed: Array) -> bool:
    """Whether K of this diagonal (rows here,), `fixed` as in its factor, is singular to round-off, the pivots positive.

    One step of inverse iteration finds what K holds least; the share of its energy changes with no units of rows.
    """
    free = free_rows(algebra, fixed)
    w = factor.solve(free * probe_columns(algebra, 1))
    held, scale = (algebra.inner(w, product)[0, 0] for product in (K @ w, diagonal[:, None] * w))
    return not held > HELD_BY_ROUND_OFF * scale  # nor where that is not finite


def free_rows(algebra: Algebra, fixed: Array) -> Array:
    """Which rows of this rank are not fixed, (rows here, 1)."""
    rows = algebra.rows()
    return ~np.isin(np.arange(rows.start, rows.stop), fixed)[:, None]


def null_space_hint(R: Array, nodes: bool = False) -> str:
    """What to say where K is not definite beside R, which may be of node positions."""
    if nodes:
        return (
            f"; beside {R.shape[1]} motions of its nodes as a whole it must be: do they stand in the order of its "
            "rows, three for each?"
        )
    if R.shape[1]:
        return f"; beside the {R.shape[1]} columns of rigid it must be"
    return "; of a body that moves freely give rigid, columns that span the null space"


def choose_fixed_dofs(R: Array, algebra: Algebra) -> Array:
    """ρ degrees of freedom, whose being held takes the rigid motions R (rows here, ρ), where R is best conditioned.

    Loads that are in balance do not feel them: K⁻¹f is exact up to a rigid motion. The same on every rank.
    """
    if not R.shape[1]:
        return np.empty(0, dtype=int)
    _, order = scipy.linalg.qr(algebra.gather(np.ascontiguousarray(R)).T, mode="r", pivoting=True)
    return np.sort(order[: R.shape[1]])
