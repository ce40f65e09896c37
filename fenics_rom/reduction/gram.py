"""Singular vectors by way of a Gram matrix: proper orthogonal decomposition in any inner product (Sirovich 1987)."""

import numpy as np

from fenics_rom.system.protocols import Array

ROUND_OFF = 1e-14  # share of the largest eigenvalue of a Gram matrix below which it is noise


def significant_eigenpairs(gram: Array, floor: float | None = None) -> tuple[Array, Array]:
    """Eigenvalues w above a floor, descending, and their eigenvectors E.

    Of G = XᵀMX the left singular vectors of X in the norm of M are X E / √w, and √w the singular values.

    Args:
        gram: G (c, c), symmetric and positive semi-definite.
        floor: of w; None: the round-off in G.

    Returns:
        w (r,) and E (c, r).
    """
    w, E = np.linalg.eigh(gram)
    significant = w > (ROUND_OFF * w[-1] if floor is None else floor)
    return w[significant][::-1], E[:, significant][:, ::-1]
