"""A law that was linearised for some pairs, where a few of them leave, or others come.

Forces change by J δq with the velocities that they have to stop. A pair that leaves has no force any more: velocities s
of its own see to that, f_i + J_i δq + J_ii s = 0, and the others take over what it carried, by

    J - J_·i J_ii⁺ J_i·,    f - J_·i J_ii⁺ f_i.

J_ii has as many singular values as the pair had unknown forces: three where it stuck, two where it slipped. A pair that
comes begins without a force, as if it was open.
"""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.complementarity.solution import KeptLaw

_DETERMINED = 1e-9  # of the largest singular value of J_ii


def of_other_pairs(kept: KeptLaw, before: Array, now: Array) -> KeptLaw:
    """The law of other pairs.

    Args:
        kept: that of those of before, with its inverse, in axes that last for these and those.
        before, now: which of all pairs take part, (N,) booleans, and neither is without any.
    """
    J, f, C = kept.inverse, kept.forces.ravel(), kept.forces.shape[1]
    assert J is not None
    places = np.full((3, len(before)), 3 * C)  # of each component in (3, C); those that come are after all of it
    places[:, before] = np.arange(3 * C).reshape(3, C)
    here, left = places[:, now].ravel(), places[:, before & ~now].ravel()
    if len(left):
        theirs = np.column_stack([J, f]).take(left, axis=0)
        carried = J.take(left, axis=1).dot(np.linalg.lstsq(theirs.take(left, axis=1), theirs, rcond=_DETERMINED)[0])
        J, f = J - carried[:, :-1], f - carried[:, -1]
    grown = np.zeros((3 * C + 1, 3 * C + 1))
    grown[:-1, :-1] = J
    forces, q = (np.append(values, 0.0).take(here).reshape(3, -1) for values in (f, kept.q))
    known = np.frombuffer(kept.statuses, dtype=bool).reshape(-1, C)
    statuses = np.column_stack([known, np.zeros(len(known), dtype=bool)]).take(np.minimum(places[0, now], C), axis=1)
    return KeptLaw(statuses.tobytes(), grown.take(here, axis=0).take(here, axis=1), q, forces)
