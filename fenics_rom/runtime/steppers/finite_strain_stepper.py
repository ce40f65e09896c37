"""The stepper of bodies that deform as far as they like."""

from typing import TYPE_CHECKING

import numpy as np

from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.finite_strain import FiniteStrainKernel
from fenics_rom.runtime.steppers.stepper import ReducedStepper

if TYPE_CHECKING:
    from fenics_rom.runtime.steppers.contact_interface import ContactInterface


class FiniteStrainStepper(ReducedStepper):
    """One kernel for all contact modes, which share a basis: a switch changes the inputs only, and loses nothing.

    Args:
        rom: the reduced models, with large deformation.
        dt: time step, s.
        interface: the contact points; None where nothing can touch.
        ledger: the account to book in, if one is kept.
        kind: "newton", "linearly-implicit" or "equilibrium".
        reason: why it is that one.
    """

    kernel: FiniteStrainKernel

    def __init__(
        self,
        rom: Rom,
        dt: float,
        interface: "ContactInterface | None",
        ledger: EnergyLedger | None,
        kind: str,
        reason: str,
    ):
        self.kernel = finite_strain_kernel(kind)(rom, ledger, interface)
        super().__init__(rom, dt, interface, np.empty(0), kind, reason)

    def switch(self, contact: str) -> float:
        """As in ReducedStepper."""
        self._enter(contact)
        return 0.0

    def _enter(self, contact: str) -> None:
        """As in ReducedStepper."""
        self.contact_mode = contact
        self.kernel.enter(self._rom.contact_models[contact])
        self.kernel.reset_buffer()
        if self.kernel.h != self._dt:
            self.kernel.set_time_step(self._dt)


def finite_strain_kernel(kind: str) -> type[FiniteStrainKernel]:
    """The kernel of a kind; only that one is imported."""
    if kind == "newton":
        from fenics_rom.runtime.steppers.newton import Newton

        return Newton
    if kind == "linearly-implicit":
        from fenics_rom.runtime.steppers.linearly_implicit import LinearlyImplicit

        return LinearlyImplicit
    from fenics_rom.runtime.steppers.equilibrium import Equilibrium

    return Equilibrium
