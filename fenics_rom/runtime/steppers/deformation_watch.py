"""Telling how far a body that deforms largely goes beyond what its model was trained on."""

import math
import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING

from numpy import ndarray as Array

from fenics_rom.errors import FenicsRomWarning
from fenics_rom.mechanics.contact import ContactSolution
from fenics_rom.mechanics.frame_motion import Vector
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.training_watch import TrainingWatch

if TYPE_CHECKING:
    from fenics_rom.runtime.steppers.contact_interface import ContactInterface

TRUSTED_EXTENT = 1.5  # times as far as the states that the model was trained on


class DeformationWatch:
    """Of one body.

    Args:
        rom: its reduced models.
        interface: the contact points, if there are any.

    Attributes:
        notes: names of what it keeps of a run, numbers that begin at 0; "distance" is |q| at most.
    """

    def __init__(self, rom: Rom, interface: "ContactInterface | None"):
        assert rom.deformation is not None
        self._radius, trained = rom.deformation.training_radius, rom.deformation.trained
        self._training = None if trained is None else TrainingWatch(rom, trained, interface)
        self._shared = sum(rom.actuators.values()) + sum(rom.loads.values())
        self.notes = ("distance", *(() if self._training is None else self._training.notes))

    def enter(self, contact: str, width: int) -> None:
        """Makes a contact mode of so many inputs active."""
        if self._training is not None:
            self._training.enter(contact, width - self._shared)

    def look(
        self, notes: dict[str, float], u: Array, q: Array, E: Array | None, contact: ContactSolution | None, h: float
    ) -> None:
        """Notes how far a step of h s under u has led, to q and strains E if known, and warns where it is beyond."""
        if self._training is not None:
            self._training.look(notes, u, q, E, contact, h)
        far, before, limit = math.sqrt(q.dot(q)), notes["distance"], TRUSTED_EXTENT * self._radius
        if far > before:
            notes["distance"] = far
            if before <= limit < far < math.inf:
                warnings.warn(self._too_far(far), FenicsRomWarning, stacklevel=6)

    def look_at_frame(self, notes: dict[str, float], *motion: Vector | None) -> None:
        """Notes how a frame moved, see TrainingWatch."""
        if self._training is not None:
            self._training.look_at_frame(notes, *motion)

    def messages(self, notes: Mapping[str, float]) -> tuple[str, ...]:
        """What is to be said of how far the body went beyond what its model was trained on."""
        far = notes["distance"]
        too_far = self._too_far(far) if far > TRUSTED_EXTENT * self._radius else ""
        return tuple(filter(None, [too_far, "" if self._training is None else self._training.message(dict(notes))]))

    def _too_far(self, far: float) -> str:
        return (
            f"the body went {far / self._radius:.2g} times as far as in any state that the model was trained on; "
            f"beyond {TRUSTED_EXTENT:g} times it is not to be trusted: reduce with larger loads"
        )
