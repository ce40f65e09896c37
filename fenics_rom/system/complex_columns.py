"""Complex columns where an operation takes real ones only."""

from collections.abc import Callable

import numpy as np

from fenics_rom.system.protocols import Array


def apply_to_complex(operation: Callable[[Array], Array], block: Array) -> Array:
    """A real linear operation on complex columns (any, k): one call on their real and imaginary parts side by side."""
    result, count = operation(np.hstack([block.real, block.imag])), block.shape[1]
    return result[:, :count] + 1j * result[:, count:]
