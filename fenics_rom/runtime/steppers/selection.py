"""Which stepper a body gets: what its environment calls for, in the form that is the fastest."""

import math
from typing import TYPE_CHECKING

import numpy as np

from fenics_rom.errors import StepError, shown, unknown
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.mechanics.step import FINITE_STRAIN_STEPPERS
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.body_parts import maxwell_branches, parts_of
from fenics_rom.runtime.steppers.kernel import Kernel
from fenics_rom.runtime.steppers.midpoint import fastest_kernel
from fenics_rom.runtime.steppers.stepper import FiniteStrainStepper, LinearStepper, ReducedStepper

if TYPE_CHECKING:
    from fenics_rom.mechanics.active_environment import ActiveEnvironment
    from fenics_rom.mechanics.contact_solver import ContactSolver

# In a period of the slowest mode, from which on linearly implicit steps come to any error sooner than Newton's; below
# it they may go astray. Measured: demos/rates/stepper_choice.py.
LINEARLY_IMPLICIT_STEPS = 8


def make_stepper(
    rom: Rom,
    dt: float,
    environment: "ActiveEnvironment | None",
    ledger: EnergyLedger | None,
    kind: str | None = None,
    detail: str = "full",
    solver_of: "type[ContactSolver] | None" = None,
) -> ReducedStepper:
    """The stepper of a reduced body.

    Args:
        rom: the reduced models.
        dt: time step, s.
        environment: what acts; None: inputs alone.
        ledger: the account to book in, if one is kept.
        kind: of large deformation, one of FINITE_STRAIN_STEPPERS; None: the one that suits dt.
        detail: of a moving frame, one of DETAILS.
        solver_of: what finds contact forces; None: ContactSolver.

    Raises:
        StepError: there is no such stepper, or the body begins in an obstacle.
    """
    interface, actuators, has_inertia, series = None, None, True, None
    is_moving = environment is not None and environment.environment.is_moving
    if environment is not None and not environment.environment.is_plain:  # bodies on which nothing acts start sooner
        from fenics_rom.runtime.steppers.contact_interface import contact_interface

        interface = contact_interface(rom, environment, solver_of)
        has_inertia = environment.environment.has_inertia
        if interface is not None and not is_moving:
            interface.check_start()
        acting = environment.environment
        series = acting.viscoelasticity if has_inertia else None  # an equilibrium is relaxed
        if acting.finds_forces:
            from fenics_rom.mechanics.actuator_forces import ActuatorForces  # here, as few forces are found

            actuators = ActuatorForces(acting.controls, acting.guides, {**rom.actuators, **rom.loads}, acting.gases)
    rigid_displacement = np.zeros(rom.rigid)
    if rom.deformation is None:
        if kind is not None:
            raise StepError(f"stepper = {shown(kind)}: belongs to large deformation, which ROM {rom.name!r} has not")
        if interface is None and actuators is None and series is None and has_inertia and not is_moving:

            def make_kernel(contact: str) -> Kernel:
                return fastest_kernel(rom.contact_models[contact], ledger, rigid_displacement)

            return LinearStepper(rom, dt, interface, rigid_displacement, make_kernel)
    from fenics_rom.runtime.steppers.residual_motion import residual_motions

    residual_of = residual_motions(rom, interface, has_inertia)
    if environment is not None and is_moving:
        from fenics_rom.runtime.steppers.moving_frame import moving_frame_stepper

        law, why = ("linear", "") if rom.deformation is None else _finite_strain_kind(rom, dt, kind, has_inertia)
        return moving_frame_stepper(
            rom, dt, environment, interface, ledger, residual_of, detail, actuators, series, law, why
        )
    if rom.deformation is not None:
        suited, reason = _finite_strain_kind(rom, dt, kind, has_inertia)
        first = next(iter(rom.contact_models))
        parts = parts_of(rom, first, rom.contact_models[first], suited, actuators, series, interface)
        if has_inertia:
            from fenics_rom.runtime.steppers.held import HeldBody

            held = HeldBody(rom, first, ledger, interface, residual_of(first), parts)
            return FiniteStrainStepper(rom, dt, interface, held, suited, reason)
        from fenics_rom.runtime.steppers.equilibrium import Equilibrium

        still = Equilibrium(rom, rom.contact_models[first], ledger, interface, residual_of(first), parts)
        return FiniteStrainStepper(rom, dt, interface, still, suited, reason)

    def make_booked_kernel(contact: str) -> Kernel:
        model = rom.contact_models[contact]
        if not has_inertia:
            from fenics_rom.runtime.steppers.equilibrium import Equilibrium

            parts = parts_of(rom, contact, model, "linear", actuators, None, interface)
            return Equilibrium(rom, model, ledger, interface, residual_of(contact), parts)
        from fenics_rom.runtime.steppers.contact_midpoint import ContactMidpoint

        share = None if series is None else rom.relaxing_share(contact)
        carried = residual_of(contact), maxwell_branches(series, 1, model.order, share)
        return ContactMidpoint(model, ledger, rigid_displacement, interface, actuators, *carried)

    return LinearStepper(rom, dt, interface, rigid_displacement, make_booked_kernel)


def longest_linearly_implicit_step(rom: Rom) -> float:
    """The time step, s, beyond which a body of large deformation gets Newton's steps unless others are asked for."""
    slowest: float = next(iter(rom.contact_models.values())).eigenvalues[rom.rigid]
    return 2 * math.pi / math.sqrt(slowest) / LINEARLY_IMPLICIT_STEPS


def _finite_strain_kind(rom: Rom, dt: float, kind: str | None, has_inertia: bool) -> tuple[str, str]:
    """The stepper that was asked for or, where none was, that suits a time step (s), and why."""
    if not has_inertia:
        if kind is not None:
            raise StepError(f"stepper = {shown(kind)}: a scene without inertia has but equilibria")
        return "equilibrium", "the scene has no inertia"
    if kind is not None:
        if kind not in FINITE_STRAIN_STEPPERS:
            raise StepError(unknown("stepper", kind, list(FINITE_STRAIN_STEPPERS)))
        return kind, "it was asked for"
    limit = LINEARLY_IMPLICIT_STEPS
    steps = limit * longest_linearly_implicit_step(rom) / dt
    if steps >= limit:
        return (
            "linearly-implicit",
            f"{steps:.3g} steps in a period of the slowest mode, from {limit} on it is sooner exact",
        )
    return "newton", f"{steps:.2g} steps in a period of the slowest mode, below {limit} only iteration is to be trusted"
