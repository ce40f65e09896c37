"""The step contract: what every integrator takes and gives, reduced or full order, linear or not.

    inputs, obstacle motion  ->  step  ->  stored energy, contact

A contact step says what its contact points would do without forces, and its Delassus operator; `mechanics.contact`
finds the forces; the step takes them in. Nothing else passes between them.

A Stepper is one integrator. It owns the state of a body, and the work that it still owes the energy account, and has

    kind, reason             its name, and why it is the one that steps
    energy, contact          stored, J; the ContactSolution of the last step, None where nothing touched
    reactions                forces found in the last step, of strokes that are given, then at guides, N or Pa
    step(StepInput)          takes one step: the energy stored after it, J, and where that is not finite the caller
                             rolls back; or none and a ValueError where u has another shape, none and a StepError where
                             there are no contact forces or no state
    rollback()               takes the last step back
    flush()                  books what the steps so far supplied and dissipated
    switch(contact)          makes a contact mode active, carries the state to it, and tells what this took, J, >= 0
    set_time_step(dt)        makes the coefficients for another time step, s
    point_displacement()     of the contact points, (P, 3), m
    diagnostics()            what the user should know of the run so far
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from numpy import ndarray as Array

if TYPE_CHECKING:
    from fenics_rom.mechanics.base_path import BaseState
    from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion
    from fenics_rom.mechanics.contact_search import ContactSearch

MOVING_FRAME = "moving-frame"  # the stepper of a body that turns as far as it likes
FINITE_STRAIN_STEPPERS = ("newton", "linearly-implicit")  # of a reduced body with inertia


class StepInput(NamedTuple):
    """What acts in one step."""

    u: Array  # (p,) contact columns, actuators, loads; N, or the unit of the input
    obstacles: "ObstacleMotion | None" = None  # how they move; None where there are none
    base: "BaseState | None" = None  # that carries the body, at the end; None where nothing says how it moves


class StepperState(NamedTuple):
    """All that a stepper does not take from its model, exact to the bit; arrays are read-only."""

    state: Array  # [√γ q, r] (2m,) of a reduced model
    rigid_displacement: Array  # along the rigid motions (ρ,)
    auxiliary: Array  # what a step carries along besides; empty where there is nothing
    contact: "ContactSolution | None"  # of the last step
    search: "ContactSearch | None"  # with which the next search for contact forces begins; None where nothing can touch
    notes: Mapping[str, float]  # of the run so far, to tell the user
    reactions: Array  # (n,) of the last step, N or Pa
    frame: Any = None  # of a moving frame: where it is
