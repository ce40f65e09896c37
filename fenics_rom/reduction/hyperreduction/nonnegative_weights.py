"""Non-negative least squares that stops as soon as the residual is small enough: few weights are positive then."""

import numpy as np
import scipy.linalg

Array = np.ndarray

ROUND_OFF = 1e-13  # share of the largest product with the right-hand side below which no weight helps any more


def sparse_weights(A: Array, b: Array, tolerance: float) -> Array:
    """Weights x >= 0, few of them positive, with |A x - b| <= tolerance |b| where there are any.

    Lawson & Hanson (1974, algorithm 23.10) with the QR factors of the active columns updated, as ECSW uses it (Farhat,
    Avery, Chapman & Cortial, 2014): columns enter one by one, the one that points most along the residual first.

    Args:
        A: (rows, columns).
        b: (rows,).
        tolerance: relative; 0 solves min |A x - b|, x >= 0.

    Returns:
        (columns,); the best there is where the tolerance cannot be met.
    """
    active: list[int] = []
    x = np.empty(0)
    Q, R = np.eye(len(b)), np.empty((len(b), 0))
    residual, helpless = b, np.zeros(A.shape[1], dtype=bool)
    smallest_gain = ROUND_OFF * np.abs(A.T @ b).max(initial=0.0)
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
            for k in reversed(falling[x[falling] <= ROUND_OFF * x.max()]):
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
