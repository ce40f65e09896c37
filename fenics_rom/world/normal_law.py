"""What the law asks of contacts along their normals; NumPy's steps ask it, and compiled ones do."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.contact_pairs import BACK

RESTS = 2.5  # times as deep as two bodies are in one another: so far points may move in a step of what rests there


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


def speeds_out(
    h: float,
    gaps: Array,
    approach: Array,
    pressure: Array,
    own: Array,
    are_deep: Array,
    meetings: Array,
    dissipated: Array,
) -> Array:
    """Speeds (C,), m/s, at which contacts that are deep are let out in a step of h s, as bodies rest there; else 0.

    Rests is what the forces of the step press without an impact. They leave no faster than these could stop. It takes
    energy, of which contact of these two must have dissipated some.

    Args:
        h: s.
        gaps, approach: as of `normal_law`.
        pressure: found along normals, (C,), N.
        own: normal velocity of each contact by its own pressure, (C,), m/s/N.
        are_deep: (C,) whether two rigid bodies are in one another there.
        meetings: (C,) which two these are, of M.
        dissipated: by contact of these so far, (M,), J.
    """
    moves, depth = np.zeros(len(dissipated)), np.zeros(len(dissipated))
    for c in range(len(gaps)):
        m = meetings[c]
        depth[m] = max(depth[m], -gaps[c])
        if are_deep[c] or pressure[c] > 0:
            moves[m] = max(moves[m], h * abs(approach[c]))
    out = np.zeros(len(gaps))
    for c in are_deep.nonzero()[0]:
        m = meetings[c]
        if moves[m] <= RESTS * depth[m] and dissipated[m] > 0:
            out[c] = max(min(-gaps[c] / h, max(approach[c], 2 * own[c] * pressure[c])), 0.0)
    return out
