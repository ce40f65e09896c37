"""What springs ask beside the law of rigid pairs, compiled: see `contact_pairs.NormalRule` and `held_springs`."""

from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.mechanics.compiled.contact_law import FOUND, OTHERWISE, Found, Law, Pairs


@jit_part
def ask_springs(law: Law, gaps: Array, farthest: float, pairs: Pairs) -> None:
    """Has springs that are not pressed yet act where a step would end inside; pairs (N,) have been asked by `ask`."""
    if law.compliance > 0:
        for c in range(len(gaps)):
            if 0 < gaps[c] <= farthest:
                pairs.level[c] = pairs.target[c, 0] = -gaps[c] / law.h
                pairs.chosen[c] = pairs.free[c, 0] < pairs.level[c]


@jit_part
def held_by(law: Law, gaps: Array, pairs: Pairs, found: Found) -> Found:
    """The same, but for springs that let a point deeper into an obstacle than it is thick: what to do NumPy knows."""
    if law.compliance > 0 and found.status == FOUND:
        for c in range(len(gaps)):
            if pairs.chosen[c]:
                pressure = 0.0
                for k in range(3):
                    pressure += pairs.axes[c, 0, k] * pairs.forces[c, k]
                speed = pairs.target[c, 0] - law.compliance * pressure
                if pressure > 0 and speed < 0 and gaps[c] + law.h * speed < -law.radius:
                    return Found(OTHERWISE, found.sweeps, 0.0)
    return found
