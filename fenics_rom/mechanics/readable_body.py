"""What readings ask a body for."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.contact_points import ContactPoints

if TYPE_CHECKING:
    from fenics_rom.mechanics.rubbing import Rubbing


class LastStep(NamedTuple):
    """What a body did in the last step, by its coordinates, (c,).

    Attributes:
        h: its length, s; 0 where an equilibrium followed another.
        start, end: displacement and velocity before it and after it.
        contact: the contact mode.
        inputs: (p,) contact columns, actuators and loads, with the forces that were found in place of what is given.
    """

    h: float
    start: tuple[Array, Array]
    end: tuple[Array, Array]
    contact: str
    inputs: Array

    @property
    def motion(self) -> tuple[Array, Array, Array]:
        """Acceleration, and velocity and displacement in the middle; at rest the displacement at the end."""
        (x, v), (x_end, v_end) = self.start, self.end
        if not self.h:
            return np.zeros_like(x), np.zeros_like(x), x_end
        return (v_end - v) / self.h, (v_end + v) / 2, (x_end + x) / 2


class ReadableBody(NamedTuple):
    """What readings ask a body for, as it is now.

    Attributes:
        law: as `hyperelastic` has them, of a body that deforms largely; None: linear.
        coordinates: its displacement, in what the operators of readings are of: free components, or the shared basis,
            (c,).
        stroke: what 1 of an actuator's input does work on: how much shorter a tendon is (m), or larger a chamber (m³).
        points: what obstacles can touch; None where there are none.
        pressing: normal forces of obstacles on them in the last step, (P,), N; None where nothing touched.
        forces: of obstacles on them, (P, 3), N, in world axes; None as above, or where nothing asks for them.
        rubbing: what friction did there.
        places: of all nodes now, (N, 3), m, in world axes.
        last: the last step; None where nothing asks for it, or none was taken.
        amplitudes: of temperatures now, by name; None: there are none.
    """

    law: str | None
    coordinates: Callable[[], Array]
    stroke: Callable[[str], float]
    points: ContactPoints | None = None
    pressing: Array | None = None
    forces: Array | None = None
    rubbing: "Callable[[], Rubbing | None] | None" = None
    places: Callable[[], Array] | None = None
    last: LastStep | None = None
    amplitudes: Callable[[], Mapping[str, float]] | None = None

    def normal_forces(self, nodes: Array) -> Array:
        """Of obstacles in the last step, on nodes of the body (s,), N, (s,); 0 where none can touch."""
        if self.points is None or self.pressing is None:
            return np.zeros(len(nodes))
        return self.points.on_nodes(self.pressing, nodes)
