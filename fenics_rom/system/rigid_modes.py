"""Rigid motions: what a body that is not wholly held can do without straining, K R = 0.

They are kept exactly, split off M-orthogonally: with P = I - R RᵀM, whatever is said of stiffness and compliance is
said of the elastic rest, P x of displacements and Pᵀ f of loads (those that rigid motions do not feel).
"""

from typing import Any

import numpy as np

from fenics_rom.errors import StructureError

Array = np.ndarray

# Share of the mean eigenvalue, as energy of an M-orthonormal motion, that is round-off: assembled bodies are at 1e-16.
NO_ENERGY = 1e-13
SAME = 1e-8  # share of a column of unit mass that must be its own
TELLABLE = 1e-2  # largest error of a solution with K that is not singular for all that can be told


def mass_orthonormal(M: Any, columns: Array, algebra: Any) -> Array:
    """R (rows here, ρ) of the same span with RᵀMR = I, kg^-1/2.

    Args:
        M: mass matrix.
        columns: (rows here, ρ), independent.
        algebra: of M.

    Raises:
        StructureError: the columns depend on each other.
    """
    R = columns
    for _ in range(2 if columns.shape[1] else 0):  # once more for what a Gram matrix of columns far apart loses
        gram = algebra.inner(R, M @ R)
        sizes = np.sqrt(np.diag(gram))
        if not ((sizes > 0).all() and np.linalg.eigvalsh(gram / sizes[:, None] / sizes)[0] > SAME):
            raise StructureError(f"rigid: its {len(sizes)} columns depend on each other")
        R = R @ np.linalg.inv(np.linalg.cholesky(gram)).T
    return R


def without_energy(M: Any, K: Any, motions: Array, algebra: Any) -> Array:
    """Those combinations of M-orthonormal motions (rows here, any) that K does not see, (rows here, ρ).

    Springs to the ground take some of the motions that the supports leave.
    """
    if not motions.shape[1]:
        return motions
    λ, U = np.linalg.eigh(algebra.inner(motions, K @ motions))
    free = λ <= NO_ENERGY * mean_eigenvalue(M, K, algebra)
    return motions if free.all() else motions @ U[:, free]


def check_rigid(M: Any, K: Any, R: Array, algebra: Any) -> None:
    """Refuses M-orthonormal columns that strain the body.

    Raises:
        StructureError: with the measured number.
    """
    if R.shape[1]:
        energy = float(np.linalg.eigvalsh(algebra.inner(R, K @ R))[-1])
        scale = mean_eigenvalue(M, K, algebra)
        if not abs(energy) <= 1e3 * NO_ENERGY * scale:  # of anyone's columns, which may have fewer digits
            raise StructureError(
                f"rigid: stiffness sees these columns: RᵀKR is up to {energy:.1e} for RᵀMR = 1, of any columns about "
                f"{scale:.1e}; allowed are columns that span its null space"
            )


def mean_eigenvalue(M: Any, K: Any, algebra: Any) -> float:
    """What zᵀKz / zᵀMz of any z is about, 1/s²."""
    here = algebra.rows()
    z = np.random.default_rng(0).standard_normal((here.stop, 4))[here] if here.stop else np.empty((0, 4))
    return float(np.trace(algebra.inner(z, K @ z)) / np.trace(algebra.inner(z, M @ z)))


def is_singular(K: Any, factor: Any, algebra: Any, held: Array) -> bool:
    """Whether K cannot be told from a singular matrix, though its pivots are positive: K⁻¹K z is not z.

    Args:
        K: stiffness matrix.
        factor: of K with some degrees of freedom held.
        algebra: of K.
        held: which.
    """
    here = algebra.rows()
    moves = ~np.isin(np.arange(here.start, here.stop), held)[:, None]
    z = moves * np.random.default_rng(0).standard_normal((here.stop, 1))[here]
    lack = factor.solve(moves * (K @ z)) - z
    return not algebra.inner(lack, lack)[0, 0] <= TELLABLE**2 * algebra.inner(z, z)[0, 0]


def hint(R: Array) -> str:
    """What to say where K is not definite beside R."""
    if R.shape[1]:
        return f"; beside the {R.shape[1]} columns of rigid it must be"
    return "; of a body that moves freely give rigid, columns that span the null space"


def fixed_dofs(R: Array, algebra: Any) -> Array:
    """ρ degrees of freedom, whose being held takes the rigid motions R (rows here, ρ), where R is best conditioned.

    Loads that are in balance do not feel them: K⁻¹f is exact up to a rigid motion. The same on every rank.
    """
    import scipy.linalg

    if not R.shape[1]:
        return np.empty(0, dtype=int)
    _, order = scipy.linalg.qr(algebra.gather(np.ascontiguousarray(R)).T, mode="r", pivoting=True)
    return np.sort(order[: R.shape[1]])
