"""Pressure and traction of what touches bodies of a run, and the arrows of tractions."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.nodal_contact import ContactSurface
from fenics_rom.trajectory.trajectory import Trajectory

LEAST_SHOWN = 0.05  # of the largest traction: arrows of less are left out
LONGEST_ARROW = 0.12  # of the body's size


class ContactFields:
    """Of a run that keeps what touches its bodies, at all nodes of each of its shapes.

    Attributes:
        touchable: which triangles can be touched, (F,).
        areas: at rest of the surface that each node stands for, (N,), m²; 0 of those that cannot be touched.
    """

    def __init__(self, run: Trajectory):
        assert run.touched is not None
        self._touched, self._count, bodies = run.touched, len(run.nodes), run.bodies.values()
        self.touchable, self.areas = np.zeros(len(run.triangles), dtype=bool), np.zeros(self._count)
        self._surfaces = list[tuple[Array, slice, ContactSurface]]()  # which of the touched nodes, all nodes, of each
        for rows in [body.nodes for body in bodies if body.kind == "soft"] if run.bodies else [slice(0, self._count)]:
            of_nodes = (run.touched.nodes >= rows.start) & (run.touched.nodes < rows.stop)
            of_triangles = (run.triangles[:, 0] >= rows.start) & (run.triangles[:, 0] < rows.stop)
            triangles, nodes = run.triangles[of_triangles] - rows.start, run.touched.nodes[of_nodes] - rows.start
            surface = ContactSurface(run.nodes[rows], triangles, nodes)
            self._surfaces.append((of_nodes, rows, surface))
            self.touchable[of_triangles], self.areas[rows] = surface.touchable, surface.areas

    def pressure(self, row: int) -> Array:
        """Of the shape in a row, (N,), Pa."""
        return self._density(self._touched.pressing[row])

    def traction(self, row: int) -> Array:
        """Of the shape in a row, (N, 3), Pa, in world axes."""
        return self._density(self._touched.forces[row])

    def _density(self, values: Array) -> Array:
        everywhere = np.zeros((self._count, *values.shape[1:]))
        for of_nodes, rows, surface in self._surfaces:
            everywhere[rows] = surface.density(values[of_nodes])
        return everywhere


def traction_arrows(places: Array, traction: Array, largest: float, size: float) -> Array:
    """Arrows that end where tractions act, (k, 2, 3), m: where each starts and ends.

    Args:
        places: of nodes now, (N, 3), m.
        traction: (N, 3), Pa.
        largest: the length of one that has the longest arrow, Pa.
        size: of the body, m.
    """
    lengths = np.linalg.norm(traction, axis=1)
    shown = lengths > LEAST_SHOWN * largest
    ends = places[shown]
    ways = LONGEST_ARROW * size / largest * traction[shown] if len(ends) else ends
    return np.stack([ends - ways, ends], axis=1)
