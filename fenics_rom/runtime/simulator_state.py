"""What a simulator can be saved as, and come back to."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from fenics_rom.mechanics.linearity import SurfaceStrainPeak
from fenics_rom.mechanics.step import StepperState
from fenics_rom.runtime.switching import SwitchLoss

if TYPE_CHECKING:
    from fenics_rom.mechanics.active_environment import ObstacleState


@dataclass(frozen=True)
class SimulatorState:
    """All that a simulator does not take from its ROM, exact to the bit.

    Attributes:
        contact: the active contact mode.
        dt: time step, s.
        steps: number of steps taken.
        since: time, s, and number of steps at which dt was last changed.
        stepper: of the body.
        sums: of the energy account, J, and what they were rounded by; or None.
        surface_peak: how far the surface went.
        loss: the switch that lost most.
        obstacles: where they are; None where nothing acts by itself.
    """

    contact: str
    dt: float
    steps: int
    since: tuple[float, int]
    stepper: StepperState
    sums: tuple[tuple[float, float], ...] | None
    surface_peak: SurfaceStrainPeak
    loss: SwitchLoss
    obstacles: "ObstacleState | None" = None
