"""What is asked of contacts that take part in a step, as the law has it, and how these are read."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.mechanics.compiled.contact_law import Pairs
from fenics_rom.mechanics.compiled.copying import copy
from fenics_rom.mechanics.compiled.coulomb import frame_along
from fenics_rom.world.compiled.tables import OF_FRICTION, near_at


@jit_part
def pairs_among(world: Array, among: Array, level: Array, target: Array) -> Pairs:
    """What the law asks of some contacts (K,)."""
    near, K = near_at(world), len(among)
    axes, friction = np.empty((K, 3, 3)), np.empty(K)
    free, relative, asked = np.empty((K, 3)), np.empty((K, 3)), np.empty((K, 3))
    none = np.zeros(K, dtype=np.bool_)
    pairs = Pairs(axes, free, relative, asked, level[among], none, none.copy(), friction, near.forces[among])
    for i in range(K):
        c = among[i]
        copy(near.normals[c], axes[i, 0])
        friction[i] = near.numbers[c, OF_FRICTION]
        frame_along(axes[i])
        set_in_frame(axes[i], near.before[c], relative[i])
        slides = 0.5 if friction[i] > 0 else 0.0
        asked[i, 0], asked[i, 1], asked[i, 2] = target[c], slides * relative[i, 1], slides * relative[i, 2]
    return pairs


@jit_part
def set_in_frame(axes: Array, vector: Array, turned: Array) -> None:
    """Sets a vector (3,) along axes (3, 3)."""
    for k in range(3):
        turned[k] = axes[k, 0] * vector[0] + axes[k, 1] * vector[1] + axes[k, 2] * vector[2]


@jit_part
def along(Wᵀ: Array, i: int, n: Array) -> float:
    """How a pair moves along a normal under a force along it, m/s/N."""
    total = 0.0
    for k in range(3):
        for j in range(3):
            total += n[k] * Wᵀ[3 * i + k, 3 * i + j] * n[j]
    return total


@jit_part
def largest(values: Array) -> float:
    """Of numbers (C, 3), without their signs; not a number where one is none."""
    largest = 0.0
    for c in range(len(values)):
        for k in range(3):
            if not abs(values[c, k]) <= largest:
                largest = abs(values[c, k])
    return largest
