"""What the full-order steppers share: a state on many ranks, the contact mode it is in, and how it is read."""

import numpy as np

from fenics_rom.fem.contact_interface import interface_of
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.contact import ContactSolution
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.mechanics.time_step_monitor import TimeStepMonitor
from fenics_rom.system.system import Array, System


class FullOrderBody:
    """A full-order body at rest; every rank must call every method.

    Args:
        system: the full-order model.
        dt: time step, s; may be set anew before any step.
        environment: obstacles, and whether there is inertia; None: no obstacles, and inertia.
        ledger: whether the energy account is kept.

    Attributes:
        time: s.
        x, v: displacement and velocity (rows here, 1), m and m/s.
        contact: in the last step; None where nothing touched.
        contact_mode: the active one, in whose order the inputs are.
        ledger: the energy account, or None.
        interface: the contact points; None where nothing can touch.
        time_step_monitor: of the length of the steps, where an account is kept.

    Raises:
        StepError: the body begins in an obstacle.
    """

    def __init__(self, system: System, dt: float, environment: ActiveEnvironment | None, ledger: bool):
        self.system, self.dt, self.time = system, dt, 0.0
        self.contact: ContactSolution | None = None
        self.contact_mode = next(iter(system.contacts))
        self.interface = interface_of(system, environment)
        self.ledger = EnergyLedger() if ledger else None
        self.time_step_monitor = TimeStepMonitor()
        rows = system.algebra.rows()
        self.x = np.zeros((rows.stop - rows.start, 1))
        self.v = np.zeros_like(self.x)
        self._has_inertia = environment is None or environment.environment.has_inertia
        self._input_matrices: dict[str, Array] = {}

    @property
    def input_matrix(self) -> Array:
        """B (rows here, p) of the active contact mode."""
        if self.contact_mode not in self._input_matrices:
            self._input_matrices[self.contact_mode] = self.system.input_matrix(self.contact_mode)
        return self._input_matrices[self.contact_mode]

    def switch(self, contact: str) -> float:
        """See Stepper; the state stays as it is, and nothing is lost."""
        self.contact_mode = contact
        return 0.0

    def set_time_step(self, dt: float) -> None:
        """See Stepper."""
        self.dt = dt

    def flush(self) -> None:
        """See Stepper; every step books by itself."""

    def point_displacement(self) -> Array:
        """See Stepper."""
        assert self.interface is not None
        return self.interface.at_points(self.x)

    def diagnostics(self) -> tuple[str, ...]:
        """See Stepper."""
        residual = "" if self.interface is None else self.interface.solver.residual.message
        return tuple(filter(None, [residual, self.time_step_monitor.message]))

    def displacement(self, output: str | None = None) -> Array:
        """Displacement, m: of a named output (points, 3), or of every mesh node (nodes, 3)."""
        return self._field(self.x, output)

    def velocity(self, output: str | None = None) -> Array:
        """Velocity, m/s, as displacement."""
        return self._field(self.v, output)

    def _field(self, x: Array, output: str | None) -> Array:
        """A field (rows here, 1) at an output, or on all nodes, the same on every rank."""
        s = self.system
        if output is not None:
            return s.algebra.inner(s.outputs[output], x).reshape(-1, 3)
        return s.body.unknowns.expand(s.algebra.gather(x)).reshape(-1, 3)
