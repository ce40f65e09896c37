"""How the finer model of a run that states its errors goes on through parts of its steps; see error_blocks.py."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit
from fenics_rom.compiled_products import LANES, copy_into, turn_pairs


@jit
def take_parts(
    powers: Array, apart: Array, two: tuple[int, int], y: Array, pushed: Array, inputs: Array, z: Array
) -> float:
    """As `go_on` of error_blocks."""
    f, q, total = len(y), inputs.shape[1], 0.0
    turn, states = np.zeros((2, 2 * f)), np.empty((2, 2 * f))  # of real and imaginary parts, by own and by the other
    for j in range(f):
        λ, off = powers[0, j], apart[0, j]
        turn[0, 2 * j], turn[0, 2 * j + 1] = λ.real + off, λ.real - off
        turn[1, 2 * j], turn[1, 2 * j + 1] = -λ.imag, λ.imag
        states[0, 2 * j], states[0, 2 * j + 1] = y[j].real, y[j].imag
    for k in range(len(pushed)):
        here = k % 2
        copy_into(z, k, 0, inputs, k, q)
        copy_into(z, k, q, states, here, z.shape[1] - q)
        if 2 * f >= LANES:
            total += turn_pairs(turn, states, here, pushed, k)
        else:
            for j in range(2 * f):
                number, other = states[here, j], states[here, j + 1 - 2 * (j % 2)]
                states[1 - here, j] = turn[0, j] * number + turn[1, j] * other + pushed[k, j]
                total += number * number
    for j in range(f):
        y[j] = complex(states[len(pushed) % 2, 2 * j], states[len(pushed) % 2, 2 * j + 1])
    return total
