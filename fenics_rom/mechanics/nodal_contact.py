"""Contact of a body as forces on its nodes, and as pressure and traction of its surface.

A contact point that is no node, as a place on a face, spreads its force over nodes by its weights. With A_f the areas
of the facets around node i, of n nodes each, it has the share a_i = Σ A_f / n of the surface, and

    n = 3, 4:  p_i = F_i / a_i
    n = 6:     p_f = Σ_{i of f} F_i / (6 a_i),   p_i = Σ A_f p_f / (6 a_i)

Σ a_i p_i = Σ F_i exactly. On flat surfaces a uniform pressure is found exactly. On facets of six nodes it may leave
nothing to the corners, or be shared by area where the four parts of a facet touch. On quadrilaterals of nine nodes it
leaves 1/36 to each corner, 1/9 to the middles of sides and 4/9 to the middle: these are shares of A_f, as for n = 4.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.contact_points import ContactPoints

if TYPE_CHECKING:
    from fenics_rom.mechanics.touch import TouchState


NINTHS = np.array([1, 1, 1, 1, 4, 4, 4, 4, 16]) / 36  # of a uniform pressure, on a quadrilateral of nine nodes


class NodalContact(NamedTuple):
    """Forces of all that touches a body in a step; of several instants with one more axis before those of arrays."""

    nodes: Array  # (c,) of the surfaces that can be touched, ascending
    forces: Array  # (c, 3) on them, in world axes, N
    pressing: Array  # (c,) sums of normal forces, N


class Touch(NamedTuple):
    """Forces on the contact points of a body in a step."""

    forces: Array  # (P, 3) in world axes, N
    pressing: Array  # (P,) sums of normal forces, N


class FacetShares:
    """Values that belong to nodes, as forces do, over the area of facets around them.

    Args:
        facets: (F, 3) or (F, 6) nodes of triangles, (F, 4) or (F, 9) of quadrilaterals: corners, sides, the middle.
        areas: (F,) m².
        count: of nodes.

    Attributes:
        areas: (count,) share of each node, m²; 0 of those of no facet.
    """

    def __init__(self, facets: Array, areas: Array, count: int):
        self._facets, self._of_facets, self._n = facets, areas, facets.shape[1]
        self.areas: Array = self._sum_at_nodes(areas, count) / self._n
        if self._n == 9:
            self.areas = np.bincount(facets.ravel(), np.outer(areas, NINTHS).ravel(), minlength=count)

    def density(self, values: Array) -> Array:
        """Of values (count, ...) by area, (count, ...); 0 on nodes of no facet."""
        direct = _quotient(values, self.areas)
        if self._n != 6:
            return direct
        of_facets = direct[self._facets].sum(axis=1) / self._n
        weighed = (self._of_facets * of_facets.T).T
        return _quotient(self._sum_at_nodes(weighed, len(values)) / self._n, self.areas)

    def _sum_at_nodes(self, values: Array, count: int) -> Array:
        """The sum, at each node, of values (F, ...) of the facets around it, (count, ...)."""
        sums = np.zeros((count, *values.shape[1:]))
        np.add.at(sums, self._facets, values[:, None])
        return sums


class ContactSurface:
    """The part of a body's surface that can be touched.

    A node that can be touched but is of no facet whose nodes all can, as a single one, has its share of those around.

    Args:
        coordinates: of all nodes at rest, (N, 3), m.
        triangles: of the surface, (F, 3); of degree 2 four for each facet, as `Nodes.drawn_triangles` orders them.
        nodes: that can be touched, (c,).

    Attributes:
        areas: (N,) of the surface that each node stands for, m²; 0 of those that cannot be touched.
        touchable: which triangles that is, (F,).
    """

    def __init__(self, coordinates: Array, triangles: Array, nodes: Array):
        facets, count = facets_of(triangles), len(coordinates)
        areas = _areas(coordinates, facets[:, :3])
        if facets.shape[1] in (4, 9):
            areas += _areas(coordinates, facets[:, [0, 2, 3]])
        among = np.isin(facets, nodes).all(axis=1)
        self._shares = FacetShares(facets[among], areas[among], count)
        self.nodes, self.areas = nodes, self._shares.areas.copy()
        self._alone = np.setdiff1d(nodes, facets[among])
        self.areas[self._alone] = FacetShares(facets, areas, count).areas[self._alone]
        self.touchable = np.tile(
            among | np.isin(facets, self._alone).any(axis=1), len(triangles) // max(len(facets), 1)
        )

    def density(self, values: Array) -> Array:
        """Of values (c, ...) of the nodes that can be touched, over area: (N, ...)."""
        everywhere = np.zeros((len(self.areas), *values.shape[1:]))
        everywhere[self.nodes] = values
        densities = self._shares.density(everywhere)
        densities[self._alone] = _quotient(everywhere[self._alone], self.areas[self._alone])
        return densities


class TouchedBody:
    """A body whose contact is read on its nodes."""

    _contact_surface: ContactSurface | None = None

    @property
    def _readings(self) -> Mapping[str, Any]:
        """By name."""
        raise NotImplementedError

    def reading(self, name: str) -> Array:
        """Numbers of a reading."""
        raise NotImplementedError

    def touch(self, name: str) -> "TouchState":
        """What a sense of touch shows of the last step: an output of quantity "touch", with what its sensor adds.

        Raises:
            StepError: there is none of that name.
        """
        from fenics_rom.mechanics.touch import touch_of  # here, as few bodies have one

        return touch_of(self._readings, name, self.reading)

    def _touch(self) -> tuple[ContactPoints, Touch | None] | None:
        """Its contact points, and what pushes them in the last step; None where nothing can touch it."""
        raise NotImplementedError

    def _surface_at_rest(self) -> tuple[Array, Array, Array]:
        """Coordinates (N, 3), m, triangles (F, 3), and the nodes of all contact surfaces."""
        raise NotImplementedError

    @property
    def nodal_contact(self) -> NodalContact | None:
        """Forces of contact on nodes in the last step; None where nothing can touch the body."""
        touch = self._touch()
        if touch is None:
            return None
        points, pushed = touch
        nodes = np.union1d(self._surface_at_rest()[2], points.weights()[1])
        if pushed is None:
            return NodalContact(nodes, np.zeros((len(nodes), 3)), np.zeros(len(nodes)))
        return NodalContact(nodes, *(points.on_nodes(of_points, nodes) for of_points in pushed))

    @property
    def contact_surface(self) -> ContactSurface:
        """The part of its surface that can be touched; StepError where nothing can."""
        if self._contact_surface is None:
            coordinates, triangles, _ = self._surface_at_rest()
            self._contact_surface = ContactSurface(coordinates, triangles, self._contact_read().nodes)
        return self._contact_surface

    def contact_pressure(self) -> Array:
        """Normal forces of all that touched the body in the last step, over area: at all nodes, (N,), Pa.

        0 where nothing pushes. Areas are those of the contact surfaces at rest; how, see `mechanics.nodal_contact`.

        Raises:
            StepError: nothing can touch it.
        """
        return self.contact_surface.density(self._contact_read().pressing)

    def contact_traction(self) -> Array:
        """Forces of all that touched the body, friction among them, over area: at all nodes, (N, 3), Pa, in world axes.

        Raises:
            StepError: nothing can touch it.
        """
        return self.contact_surface.density(self._contact_read().forces)

    def _contact_read(self) -> NodalContact:
        contact = self.nodal_contact
        if contact is None:
            raise StepError("there are no contact forces: the scene has no contact")
        return contact


def facets_of(triangles: Array) -> Array:
    """Facets that triangles (T, 3) are of, as `Nodes.drawn_triangles` has them.

    Of three nodes (T, 3), or where they are four parts of each, of six, (T / 4, 6). Where these are halves of
    quadrilaterals, facets of four nodes (T / 2, 4) or nine (T / 8, 9).
    """
    facets = _whole(triangles)
    if not len(facets) or len(facets) % 2:
        return facets
    first, second = np.split(facets, 2)
    shared = [(0, 2), (2, 0), (5, 5)][: 3 if facets.shape[1] == 6 else 2]
    if not all((first[:, i] == second[:, j]).all() for i, j in shared):
        return facets
    corners = np.column_stack([first[:, :3], second[:, 1]])
    if facets.shape[1] == 3:
        return corners
    return np.column_stack([corners, first[:, 3:5], second[:, 3:5], first[:, 5]])


def _whole(triangles: Array) -> Array:
    """Facets of three nodes, (F, 3), or where triangles (F, 3) are four parts of each, of six, (F / 4, 6)."""
    if not len(triangles) or len(triangles) % 4:
        return triangles
    first, second, third, middle = triangles.reshape(4, -1, 3)
    ab, bc, ca = middle.T
    parts = np.stack([first[:, 1:], second[:, [0, 2]], third[:, :2]])
    if not (parts == np.stack([np.stack(each, axis=1) for each in ((ab, ca), (ab, bc), (ca, bc))])).all():
        return triangles
    return np.column_stack([first[:, 0], second[:, 1], third[:, 2], ab, bc, ca])


def _areas(coordinates: Array, triangles: Array) -> Array:
    """(F,), m²."""
    a, b, c = coordinates[triangles].swapaxes(0, 1)
    areas: Array = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    return areas


def _quotient(values: Array, areas: Array) -> Array:
    """Values (k, ...) over areas (k,); 0 where there is none."""
    where = areas > 0
    found = np.zeros(values.shape)
    found[where] = (values[where].T / areas[where]).T
    return found
