"""Symmetric matrices as their six components (xx, yy, zz, yz, xz, xy).

A strain has its shears twice: then S:E is a plain product, with the stress S in the same order.
"""

import numpy as np

VOIGT_PAIRS = np.array([[0, 0], [1, 1], [2, 2], [1, 2], [0, 2], [0, 1]])  # of the six components
VOIGT_INDEX = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])  # which component each entry of a symmetric matrix is
VOIGT_SHEAR = np.array([1.0, 1, 1, 2, 2, 2])[:, None]  # how often each counts in S:E
