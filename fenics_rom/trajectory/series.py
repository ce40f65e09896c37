"""Numbers by name at every instant of a run: inputs, and readings."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.reactions import REACTION
from fenics_rom.mechanics.readings import (
    READING_UNITS,
    READING_WORDS,
    TENSORS,
    VON_MISES,
    ContactPressure,
    Reading,
    StressReading,
    SurfaceReading,
    principal_size,
    von_mises,
)
from fenics_rom.mechanics.touch import TOUCH, TaxelMap, TouchReading, TouchState, unpacked
from fenics_rom.mechanics.voigt import VOIGT_INDEX


@dataclass(frozen=True)
class Series:
    """An input over time."""

    values: Array  # (S, columns): what acted in the step that led to each instant, at the first 0
    unit: str


@dataclass(frozen=True)
class ReadingSeries:
    """A reading over time.

    Attributes:
        quantity: one of `mechanics.readings.READING_UNITS`, which has its unit.
        values: of a length or volume (S,), of contact pressure (S, s) at nodes, of von Mises stress (S, P), strain and
            stress (S, P, 6) in the middle of surface triangles, of stress at points (S, G, 11), whose parts are
            `mechanics.readings.STRESS_PARTS`, of a marker (S, 3), of a reaction (S, 6), of touch (S, V), which
            `touch` takes apart.
        nodes: (s,) which of the body's.
        triangles: (P,) which of the body's.
        points: (G, 3) at rest, m.
        taxels: of touch.
    """

    quantity: str
    values: Array
    nodes: Array = field(default_factory=lambda: np.empty(0, dtype=int))
    triangles: Array = field(default_factory=lambda: np.empty(0, dtype=int))
    points: Array = field(default_factory=lambda: np.empty((0, 3)))
    taxels: TaxelMap | None = None

    @property
    def touch(self) -> TouchState:
        """Of touch: what was felt at each instant.

        Raises:
            StepError: it is another reading.
        """
        if self.taxels is None:
            raise StepError(f"a reading of {READING_WORDS[self.quantity]} is no sense of touch")
        return unpacked(self.values, self.taxels.grid)

    @property
    def unit(self) -> str:
        """Of the values; of touch that of the normal force, of a reaction that of its force."""
        return "N" if self.quantity in (TOUCH, REACTION) else READING_UNITS[self.quantity]

    def at(self, instant: int) -> "ReadingSeries":
        """Of one instant."""
        return replace(self, values=self.values[[instant]])

    @property
    def sizes(self) -> Array:
        """The values; of strains and principal stresses the largest one without its sign, (S, P).

        Of a marker its length, and of a reaction of its force, (S,); of stress that of von Mises, (S, P) or (S, G).
        """
        if self.quantity == "stress":
            of_points: Array = self.values[:, :, VON_MISES]
            return of_points
        if self.quantity == "surface_stress":
            return von_mises(np.moveaxis(self.values, -1, 0))
        if self.quantity == TOUCH:
            return self.touch.normal_force
        if self.quantity in ("marker", REACTION):
            lengths: Array = np.linalg.norm(self.values[:, :3], axis=1)
            return lengths
        if self.quantity == "principal_stress":
            largest: Array = np.abs(self.values).max(axis=-1)
            return largest
        return principal_size(self.values) if self.quantity == "strain" else self.values

    @property
    def on_surface(self) -> Array:
        """`sizes` at nodes or triangles, (S, places); of touch the pressures of taxels on triangles, Pa, (S, G)."""
        if self.taxels is None:
            return self.sizes
        return self.taxels.on_triangles(self.touch.pressures)

    @property
    def words(self) -> str:
        """What `sizes` are."""
        if self.quantity == TOUCH:
            return "normal force of touch"
        if self.quantity == REACTION:
            return "force of supports"
        of = {"strain": "largest principal ", "principal_stress": "largest "}
        of |= dict.fromkeys(("stress", "surface_stress"), "von Mises ")
        return of.get(self.quantity, "") + READING_WORDS[self.quantity]

    @property
    def by_point(self) -> Array:
        """The values, (S, points, components); of touch and of supports forces.

        Of a strain, and of stress, all nine of the tensor, whose length no choice of axes changes.
        """
        if self.quantity == TOUCH:
            return self.touch.force[:, None]
        if self.quantity == REACTION:
            forces: Array = self.values[:, None, :3]
            return forces
        values = self.values[..., VOIGT_INDEX] if self.quantity in TENSORS else self.values
        points = max(len(self.nodes), len(self.triangles), len(self.points), 1)
        return values.reshape(len(values), points, -1)


FRAME_SERIES = {  # of a moving frame: what each array of a trajectory consists of, with units and components
    "pose": {"position": ("m", "xyz"), "rotation": ("1", "wxyz")},
    "base_wrench": {"base force": ("N", "xyz"), "base torque": ("N m", "xyz")},
    "momentum": {"momentum": ("N s", "xyz"), "angular momentum": ("N m s", "xyz")},
}


def reading_series(reading: Reading, values: Array) -> ReadingSeries:
    """What a run keeps of a reading."""
    places: dict[str, Any] = {}
    if isinstance(reading, ContactPressure):
        places = {"nodes": reading.nodes}
    elif isinstance(reading, SurfaceReading):
        places = {"triangles": reading.triangles}
    elif isinstance(reading, StressReading):
        places = {"points": reading.points}
    elif isinstance(reading, TouchReading):
        places = {"taxels": reading.map}
    return ReadingSeries(reading.quantity, values, **places)


def input_series(
    contact: Array,
    given: Array,
    contacts: Mapping[str, int],
    actuators: Mapping[str, int],
    loads: Mapping[str, int],
    units: Mapping[str, str],
) -> dict[str, Series]:
    """The inputs of a run by name, but for those that were always 0.

    Those of a contact mode that has the name of an actuator or a load are called contact-NAME.

    Args:
        contact: (S,) which contact mode was active, at all instants.
        given: (S, w) what acted in the step that led to each instant: contact columns, actuators, loads; at the right.
        contacts, actuators, loads: number of columns of each.
        units: of those that are not in N.
    """
    shared = {**actuators, **loads}
    found: dict[str, Array] = {}
    for number, (name, columns) in enumerate(contacts.items()):
        instants = 1 + np.flatnonzero(contact[1:] == number)
        if not len(instants):
            continue
        widths = {f"contact-{name}" if name in shared else name: columns, **shared}
        u = given[instants, given.shape[1] - sum(widths.values()) :]
        for part, block in zip(widths, np.split(u, np.cumsum([*widths.values()])[:-1], axis=1), strict=True):
            if block.any():
                found.setdefault(part, np.zeros((len(contact), block.shape[1])))[instants] = block
    return {name: Series(values, units.get(name, "N")) for name, values in found.items()}
