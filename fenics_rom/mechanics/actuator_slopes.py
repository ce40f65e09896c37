"""What the forces of actuators that a step found fulfil, linearised: see `actuator_forces`, whose law it is.

Every force keeps what it was found to do. A stroke that is held, and a guide at which its cable sticks, goes at its
rate c; a cable that is slack has no force, and at a guide that slides z = (e^(±μα) - 1) T of the tension T ahead of it.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.actuator_forces import ActuatorForces

AT_BOUND = 1e-9  # of the largest force: as near as that to what slides it does


class Conditions(NamedTuple):
    """Rows (n,) of what n forces z fulfil: g·(Bᵀv̂ - a c) + Z z + .. = 0."""

    goes: Array  # g: 1 where a stroke goes at its rate, else 0
    asked: Array  # a: 1, and 0 at guides that are to stop at once, as friction would do work else
    by_forces: Array  # Z (n, n)
    by_inputs: Array  # (n, p), by the tensions that are given
    by_angles: Array  # (n,), by the angles at guides, 1/rad


def conditions(
    actuators: ActuatorForces, u: Array, z: Array, angles: Array | None, rates: Array, targets: Array
) -> Conditions:
    """Of forces z (n,) that were found.

    Args:
        actuators: what found them.
        u: the input (p,), without what is found.
        angles: (n,) at guides, rad; None: those at rest.
        rates, targets: Bᵀv̂ and c (n,), per s.
    """
    n, k = len(z), len(actuators.names)
    goes, by_forces, by_inputs, by_angles = np.zeros(n), np.zeros((n, n)), np.zeros((n, len(u))), np.zeros(n)
    held = actuators.held(z)
    goes[held] = 1.0
    slack = np.setdiff1d(np.arange(k), held)
    by_forces[slack, slack] = 1.0
    bends, near = actuators.bends(angles), AT_BOUND * float(np.abs(z).max(initial=0.0))
    tensions = actuators.tensions(u, z)
    for stroke, column, guides in actuators.chains:
        for place, guide in enumerate(guides):
            side = _side(z[guide], tensions[guide], bends[guide], near)
            if side == 0:
                goes[guide] = 1.0
                continue
            by_forces[guide, guide] = 1.0
            if tensions[guide] <= 0:
                continue
            share = np.expm1(side * bends[guide])
            by_forces[guide, guides[:place]] -= share
            if stroke is None:
                by_inputs[guide, column] -= share * (u[column] > 0)
            else:
                by_forces[guide, stroke] -= share * (z[stroke] > 0)
            by_angles[guide] = -side * actuators.friction[guide] * np.exp(side * bends[guide]) * tensions[guide]
    asked = np.ones(n)
    asked[k:] = np.abs(rates - targets)[k:] <= np.abs(rates)[k:]
    return Conditions(goes, asked, by_forces, by_inputs, by_angles)


def _side(force: float, tension: float, bend: float, near: float) -> int:
    """To which side a cable slides at a guide, -1 or 1; 0 where it sticks."""
    if abs(force - tension * np.expm1(-bend)) <= near:
        return -1
    return 1 if abs(force - tension * np.expm1(bend)) <= near else 0
