"""The step contract: what every integrator takes and gives, reduced or full order, linear or not.

    inputs, obstacle motion  ->  step  ->  stored energy, contact

A contact step says what its contact points would do without forces, and its Delassus operator; `mechanics.contact`
finds the forces; the step takes them in. Nothing else passes between them.
"""

from typing import NamedTuple, Protocol

import numpy as np

from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion

Array = np.ndarray

FINITE_STRAIN_STEPPERS = ("newton", "linearly-implicit")  # of a reduced body with inertia


class StepInput(NamedTuple):
    """What acts in one step.

    Attributes:
        u: (p,) contact columns, actuators, loads; N, or the unit of the input.
        obstacles: how they move; None where there are none.
    """

    u: Array
    obstacles: ObstacleMotion | None = None


class StepResult(NamedTuple):
    """What a step led to.

    Attributes:
        energy: stored after it, J; where it is not finite the caller rolls back.
        contact: what contact did; None where nothing touched.
    """

    energy: float
    contact: ContactSolution | None = None


class StepperState(NamedTuple):
    """All that a stepper does not take from its model, exact to the bit; arrays are read-only.

    Attributes:
        state: [√γ q, r] (2m,) of a reduced model.
        rigid_displacement: along the rigid motions (ρ,).
        auxiliary: what a step carries along besides; empty where there is nothing.
        contact: of the last step.
        contact_forces: the last ones of all pairs (O P, 3), with which the next search begins, N.
    """

    state: Array
    rigid_displacement: Array
    auxiliary: Array
    contact: ContactSolution | None
    contact_forces: Array


class Stepper(Protocol):
    """One integrator: it owns the state of a body, and the work that it still owes the energy account."""

    kind: str  # its name
    reason: str  # why it is the one that steps
    contact: ContactSolution | None  # of the last step; None where nothing touched

    @property
    def energy(self) -> float:
        """Stored, J."""

    def switch(self, contact: str) -> float:
        """Makes a contact mode active and carries the state to it; returns the energy that this took, J, >= 0."""

    def set_time_step(self, dt: float) -> None:
        """Makes the coefficients for another time step, s."""

    def step(self, inputs: StepInput) -> StepResult:
        """Takes one step.

        Raises:
            ValueError: u has another shape; no step was taken.
            StepError: there are no contact forces, or no state; no step was taken.
        """

    def rollback(self) -> None:
        """Takes the last step back."""

    def flush(self) -> None:
        """Books what the steps so far supplied and dissipated."""

    def point_displacement(self) -> Array:
        """Of the contact points, (P, 3), m."""

    def diagnostics(self) -> tuple[str, ...]:
        """What the user should know of the run so far."""
