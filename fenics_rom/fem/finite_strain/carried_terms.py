"""What a base that moves, and springs and dashpots to the ground, add to the balance of a body in its axes."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.fem.frame_ties import NodalTies, TiedStep, TieForces
from fenics_rom.fem.nodal_frame import NodalFrame
from fenics_rom.fem.nodal_motion import Motion
from fenics_rom.mechanics.frame_geometry import Geometry


class CarriedTies:
    """Springs and dashpots to the ground of a body in a step of h s; fields are of the nodes here, (n, 3).

    Args:
        ties: of the body.
        now: where the step begins.
        turn: how the base turns.
        end: where it is then, (3,), m.
        h: s.
        mass: of the body, kg.

    Attributes:
        constant: N, what they pull with at no rate, beyond K_s q at the start.
    """

    def __init__(self, ties: NodalTies, now: Motion, turn: Geometry, end: Array, h: float, mass: float):
        self._step, self._turn, self._end = TiedStep(ties, now, h, mass), turn, end
        self._ties, self._resistance = ties, ties.resistance(h)
        self._at_no_rate = self.at(np.zeros_like(now.q)).push.modal
        self.constant = self._at_no_rate + ties.of_here(ties.springs @ ties.of_all(now.q))

    def at(self, rate: Array) -> TieForces:
        """What they do at a mid-step rate."""
        return self._step.of_carried(self._turn, rate, self._end)

    def beyond(self, rate: Array) -> Array:
        """What is linear in a mid-step rate, beyond what D_c and h/2 K_s resist it by, N."""
        beyond: Array = self.at(rate).push.modal - self._at_no_rate
        return beyond + self._ties.of_here(self._resistance @ self._ties.of_all(rate))


class CarriedTerms:
    """What a base that moves adds to the balance of a body in its axes, see `carried_stepper.py`.

    Springs and dashpots to the ground pull at the true places of all nodes (`fem/frame_ties.py`). That comes on top of
    what they would do if the base stood where the body is at rest, which is in D_c and K_s.

    Args:
        body: its nodes.
        now: where the step begins.
        end: v and ω (3,) of the base in its axes then.
        tied: what springs and dashpots do in the step, and how the base goes; None: there are none.
        h: s.

    Attributes:
        constant: (rows here, 1), N, what does not depend on the mid-step velocity.
    """

    def __init__(self, body: NodalFrame, now: Motion, end: tuple[Array, Array], tied: CarriedTies | None, h: float):
        (v, ω), (v_end, ω_end), My, Mr = (now.v, now.ω), end, body.mass_times_arms + now.Mq, now.Mr
        self._body, self._ω, self._ω_end, self._h, self._tied = body, ω, ω_end, h, tied
        constant = np.cross(ω_end - ω, My / h + Mr / 2) + self._turned_twice(My)
        constant = constant + body.mass_of_nodes * ((v_end - v) / h + (np.cross(ω, v_end) + np.cross(ω_end, v)) / 2)
        if tied is not None:
            constant = constant - tied.constant
        self.constant = body.on_unknowns(constant)

    def force(self, v: Array) -> Array:
        """What is linear in a mid-step velocity (rows here, 1), (rows here, 1), N."""
        r̂ = self._body.nodal(v)
        Mr = self._body.inert(r̂)
        force = np.cross(self._ω + self._ω_end, Mr) + self._h / 2 * self._turned_twice(Mr)
        if self._tied is not None:
            force = force - self._tied.beyond(r̂)
        return self._body.on_unknowns(force)

    def _turned_twice(self, field: Array) -> Array:
        """½ [ω × (ω⁺ × ·) + ω⁺ × (ω × ·)] of a field (n, 3)."""
        ω, ω_end = self._ω, self._ω_end
        twice: Array = (np.cross(ω, np.cross(ω_end, field)) + np.cross(ω_end, np.cross(ω, field))) / 2
        return twice
