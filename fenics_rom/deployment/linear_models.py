"""Which linear models a ROM is to other programs: of all contact modes, or about one state."""

from collections.abc import Sequence
from typing import Any

from fenics_rom.rom.rom import Rom
from fenics_rom.rom.state_space import StateSpace


def linear_models(rom: Rom, outputs: Sequence[str] | None, dt: float | None, at: Any = None) -> dict[str, StateSpace]:
    """State spaces by contact mode: of a body that is not linear about a state, in the contact mode of that alone.

    Raises:
        StepError: as `Rom.state_space`.
    """
    if not rom.nonlinear_parts:
        return {contact: rom.state_space(contact, outputs, dt) for contact in rom.contact_models}
    contact = getattr(at, "contact", None)
    if hasattr(at, "contacts"):  # a run
        contact = at.contacts[int(at.contact[-1])]
    contact = contact if isinstance(contact, str) else next(iter(rom.contact_models))
    return {contact: rom.state_space(contact, outputs, dt, at=at)}
