"""How well data know the parameters: intervals and correlations of linearized least squares (Seber & Wild 2003, ch. 5).

The noise of all values is taken for independent and alike; s² = |r|² / (N - p) estimates its variance, s² (JᵀJ)⁻¹ is
the covariance of q, and the intervals are Student's.
"""

import numpy as np
import scipy.stats

Array = np.ndarray

CONFIDENCE = 0.95


def noise_deviation(residual: Array, parameters: int) -> float:
    """s, m: standard deviation of a single value, from residuals (N,) of a fit."""
    return float(np.sqrt(np.sum(residual**2) / (len(residual) - parameters)))


def t_quantile(freedom: int) -> float:
    """How many standard errors half an interval is."""
    return float(scipy.stats.t.ppf((1 + CONFIDENCE) / 2, freedom))


def unit_covariance(jacobian: Array) -> Array:
    """(JᵀJ)⁻¹ (p, p)."""
    R = np.linalg.qr(jacobian, mode="r")
    inverse = np.linalg.pinv(R)
    return inverse @ inverse.T


def interval_half_widths(residual: Array, jacobian: Array) -> Array:
    """Half the intervals of q, (p,)."""
    count, p = jacobian.shape
    errors = noise_deviation(residual, p) * np.sqrt(np.diag(unit_covariance(jacobian)))
    return t_quantile(count - p) * errors


def correlations(jacobian: Array) -> Array:
    """Of the errors of q, (p, p)."""
    covariance = unit_covariance(jacobian)
    sizes = np.sqrt(np.diag(covariance))
    return covariance / sizes[:, None] / sizes
