"""What the law asks of contacts along their normals; NumPy's steps ask it, and compiled ones do."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.contact_pairs import BACK


def normal_law(
    h: float,
    gaps: Array,
    approach: Array,
    free: Array,
    restitution: Array,
    are_rigid: Array,
    yield_at_once: Array,
    out: Array,
) -> tuple[Array, Array]:
    """Levels, below which a contact takes part, and targets of C contacts in a step of h s, (C,) each, m/s.

    Args:
        h: s.
        gaps: when it begins, (C,), m.
        approach: a (C,): velocities along normals when it begins, m/s.
        free: in its middle without forces of contact, (C,), m/s.
        restitution, are_rigid, yield_at_once, out: as in `contact_step.Pairs`.
    """
    closing, half = gaps / -h, approach / 2
    later = (closing + half) / 2
    level, target = np.maximum(closing, later), np.minimum(half, later)
    bounces = restitution > 0
    if bounces.any():
        leaves = (free >= BACK * (1 + restitution) * approach) | ((restitution == 1) & ~are_rigid)
        target = np.where(bounces & leaves, (1 - restitution) * half, target)
    target = np.minimum(target, 0.0)
    if yield_at_once.any():  # no impact has them in one another: they follow at once
        target = np.where(yield_at_once, np.maximum(target, np.minimum(closing, 0.0)), target)
    if out.any():
        target = np.where(out > 0, np.minimum((approach + out) / 2, closing), target)
    return level, target
