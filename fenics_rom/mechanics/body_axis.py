"""Some of the bodies of arrays that hold bodies along their last axis.

What NumPy's own indexing takes of a last axis lies in memory the other way round, which makes every operation on it
and other arrays several times slower.
"""

import numpy as np
from numpy import ndarray as Array


def in_one_piece(bodies: Array) -> Array | slice:
    """Distinct bodies in rising order as a slice, where they are one after the other: views cost nothing."""
    if len(bodies) and bodies[-1] - bodies[0] == len(bodies) - 1 and (bodies[1:] - bodies[:-1]).min(initial=1) == 1:
        return slice(int(bodies[0]), int(bodies[-1]) + 1)
    return bodies


def taken(part: Array, bodies: Array | slice) -> Array:
    """(..., B) of some of the bodies: a view where they are a slice."""
    return part[..., bodies] if isinstance(bodies, slice) else part.take(bodies, axis=-1)


def add(part: Array, bodies: Array | slice, values: Array) -> None:
    """Adds values (..., B) to those of some of the bodies of a whole array, contiguous."""
    if isinstance(bodies, slice):
        part[..., bodies] += values
    else:
        put(part, bodies, taken(part, bodies) + values)


def put(part: Array, bodies: Array | slice, values: Array) -> None:
    """Puts values (..., B) into a whole array, contiguous, as those of some of the bodies."""
    if isinstance(bodies, slice):
        part[..., bodies] = values
        return
    assert part.flags.c_contiguous
    size = part.shape[-1]
    flat = part.reshape(-1)
    flat[np.add.outer(np.arange(0, flat.size, size), bodies).ravel()] = values.ravel()
