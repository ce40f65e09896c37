"""What a step's forces of actuators that were found fulfil, linearised: strokes that are held, and guides that rub."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.actuator_forces import CREEP
from fenics_rom.mechanics.actuator_slopes import Conditions, conditions
from fenics_rom.runtime.steppers.acts.found_forces import FoundForces


class FoundSlopes(NamedTuple):
    """Of χ (n,) = X v̂ + Z z + .. = 0, by which n forces z are found."""

    places: Array  # of these forces in the input (n,)
    sticks: Array  # which of them are at guides that stick (n,)
    by_velocity: Array  # X (n, m), of v̂
    by_forces: Array  # Z (n, n)
    by_shape: Array  # (n, m), of q at the start
    by_rate: Array  # (n, m), of r then
    by_input: Array  # (n, p)
    by_goal: Array  # (n,), of the strokes at the end of the step, 1/s or 1; 0 at guides
    at_once: Array  # which of them (n,) get what is given in the first part of a step: gas
    by_middle: Array  # (n, m), of q where the forces act, which is in the others as far as that follows q and v̂

    def bordered(self, K: Array, columns: Array) -> Array:
        """[K -B; X Z], of K (k, k), whose last columns are of v̂, and columns B (k, n)."""
        n, X = len(self.places), np.zeros((len(self.places), len(K)))
        X[:, len(K) - self.by_velocity.shape[1] :] = self.by_velocity
        Z = self.by_forces.copy()
        if self.sticks.any():  # gives way a little, so that as many may stick as there are
            Z[np.arange(n), np.arange(n)] += CREEP * self.sticks * (X @ np.linalg.solve(K, columns)).diagonal()
        return np.block([[K, -columns], [X, Z]])

    def back(self, η: Array, by_input: Array) -> tuple[Array, Array]:
        """What is owed to the input (p,) and to goals (n,), from what χ owes -η, and to the input as forces (p,)."""
        by_input = by_input.copy()
        by_input[self.places] = 0.0  # what is there is no force
        return by_input - η @ self.by_input, -self.by_goal * η


class FoundIn(NamedTuple):
    """A step in which they were found."""

    found: FoundForces
    u: Array  # (p,) without them
    strokes: Array  # that were given in their place, or gas (n,)
    z: Array  # (n,)
    h: float  # s
    q: Array  # at the start (m,)
    r: Array
    v: Array
    middle: Array  # q where the forces act

    def slopes(self, *, follows: bool) -> FoundSlopes:
        """Of a step with inertia, whose middle `follows` v̂, or the v̂ that was expected."""
        found, (q, r, v, middle), h, k = self.found, self[5:], self.h, len(self.found.actuators.names)
        B, B_start = found.columns(middle), found.columns(q)
        share = 1 - found.actuators.share
        rates, targets = B.T.dot(v), found.actuators.rates(np.zeros(len(self.z)), 0 * self.z, r.dot(B_start), h)
        goals = np.where(np.arange(len(self.z)) < k, found.actuators.share / h, 0.0)
        rows = conditions(found.actuators, self.u, self.z, found.angles(middle), rates, targets)
        asked = rows.goes * rows.asked
        by_shape = (asked * goals)[:, None] * found.stroke_slopes(q) - (asked * share)[:, None] * found.turned(q, r)
        by_velocity, by_middle = rows.goes[:, None] * B.T, rows.goes[:, None] * found.turned(middle, v)
        by_middle += rows.by_angles[:, None] * found.angle_slopes(middle)
        by_shape, goal = by_shape + by_middle, -asked * goals
        gas = found.actuators.targets(self.strokes, found.strokes(q), 0 * self.z, h).gas
        if gas is not None:  # (p - z) / p', p of its rate, which goes as strokes do
            at, (by_p, by_stroke, by_amount) = gas.places, gas.slopes(rates[gas.places])
            by_shape[at] = by_middle[at] + (by_stroke / by_p)[:, None] * found.stroke_slopes(q)[at]
            asked[at], goal[at], rows.by_forces[at, at] = 0.0, by_amount / by_p, -1 / by_p
        if follows:
            by_velocity = by_velocity + h / 2 * by_middle
        by_rate = -(asked * share)[:, None] * B_start.T
        places = found.actuators.columns + len(self.u)
        return self._with(rows, places, (by_velocity, by_shape, by_rate, goal, by_middle))

    def resting_slopes(self) -> FoundSlopes:
        """Without inertia, in units of strokes; v̂ leads to the middle, which is where the step ends."""
        found, k = self.found, len(self.found.actuators.names)
        is_stroke, B = np.arange(len(self.z)) < k, found.columns(self.middle)
        nothing = np.zeros(len(self.z))
        rows = conditions(found.actuators, self.u, self.z, found.angles(self.middle), B.T.dot(self.v), nothing)
        by_end = (rows.goes * is_stroke)[:, None] * found.stroke_slopes(self.middle)
        sticks = (rows.goes * ~is_stroke)[:, None]
        moved = sticks * (B.T + found.turned(self.middle, self.middle - self.q))
        by_end += rows.by_angles[:, None] * found.angle_slopes(self.middle)
        by_velocity = self.h * (by_end + moved)
        by_shape = by_end + moved - sticks * B.T
        goal = -rows.goes * is_stroke
        gas = found.actuators.resting_targets(self.strokes, found.strokes(self.middle), self.h).gas
        if gas is not None:  # (p - z) / p', p of its stroke
            _, by_p, by_amount = gas.slopes(np.zeros(len(gas.places)))
            goal[gas.places], rows.by_forces[gas.places, gas.places] = by_amount / by_p, -1 / by_p
        places = found.actuators.columns + len(self.u)
        return self._with(rows, places, (by_velocity, by_shape, 0 * by_shape, goal, by_shape))

    def _with(self, rows: Conditions, places: Array, slopes: tuple[Array, ...]) -> FoundSlopes:
        (by_velocity, by_shape, by_rate, goal, by_middle), actuators = slopes, self.found.actuators
        each = np.arange(len(goal))
        sticks, at_once = rows.goes * (each >= len(actuators.names)), np.isin(each, list(actuators.gases))
        own = by_velocity, rows.by_forces, by_shape, by_rate
        return FoundSlopes(places, sticks, *own, rows.by_inputs, goal, at_once, by_middle)
