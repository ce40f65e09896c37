"""A sense of touch: what a patch of the surface feels of all that touches it, on the whole and by taxels.

Forces of contact are taken to the nodes of the patch: forces F_i and normal forces N_i. With places x_i now and X_i at
rest, and o the point of the torque,

    force Σ F_i,  torque Σ (x_i - o) × F_i,  centre of pressure Σ N_i X_i / Σ N_i,  pressures p_k = Σ_i T_ki N_i / A_k

T_ki is the share of node i in taxel k: Σ_k T_ki = 1, so that Σ p_k A_k = Σ N_i. Nodes that touch and share a facet are
one patch of contact. Of its tangential forces t, limits μ λ and slip velocities s it tells the margin to slip,
1 - |Σ t| / Σ μ λ, the mean slip velocity, Σ λ s / Σ λ, and the part of Σ λ at pairs that slide.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError, check_known
from fenics_rom.mechanics.readable_body import ReadableBody
from fenics_rom.mechanics.sensor import Sensor

TOUCH = "touch"
WHOLE = {"force": 3, "torque": 3, "centre": 3, "normal_force": 1, "area": 1, "touching": 1}  # numbers that lead
PATCH = {"normal_force": 1, "area": 1, "centre": 3, "slip": 3, "margin": 1, "sliding": 1}  # of each patch of contact
HEAD, OF_PATCH = sum(WHOLE.values()), sum(PATCH.values())
MARGIN = sum(width for name, width in PATCH.items() if name in ("normal_force", "area", "centre", "slip"))
COVERED = np.linspace(0.0, 1.0, 21)  # parts f of what a node on the rim stands for
RIM = COVERED**1.5 / (1.5 * np.sqrt(COVERED + 0.5))  # its pressure over that of the next one inside, if p² ~ distance
PRESSES = 1e-9  # of the largest force on a node: what is less is round-off


class ContactPatches(NamedTuple):
    """Connected parts of a surface that touch, those that press most first; those that are not there are 0."""

    normal_force: Array  # (..., Q) N
    area: Array  # (..., Q) m²
    centre: Array  # (..., Q, 3) m, of pressure, in the mesh at rest
    slip: Array  # (..., Q, 3) m/s, mean velocity by which they slip on what they touch, in world axes
    margin: Array  # (..., Q) to slip: 1 without tangential force, 0 at the limit of friction; 1 of those not there
    sliding: Array  # (..., Q) part of the normal force where they slide already


class TouchState(NamedTuple):
    """What a sense of touch feels, at an instant or with axes before, as (bodies,) or (instants,)."""

    force: Array  # (..., 3) N, in world axes, as is the torque
    torque: Array  # (..., 3) N m, about the point that was given, or the middle of the surface, moved with it
    centre: Array  # (..., 3) m, of pressure, in the mesh at rest; the middle of the surface where nothing presses
    normal_force: Array  # (...) N
    area: Array  # (...) m², of contact
    touching: Array  # (...) how many patches touch, also beyond the Q that are told
    patches: ContactPatches
    pressures: Array  # (..., rows, columns) Pa, of taxels; 0 of those that are not on the surface


class TaxelMap(NamedTuple):
    """Taxels of a grid on a surface, numbered row by row, and the triangles that show them."""

    grid: Array  # (2,) rows and columns
    areas: Array  # (K,) m²; 0 of those that are not on the surface
    centres: Array  # (K, 3) m, at rest; 0 of those
    triangles: Array  # (G,) which of the body's
    seen: Array  # (h,) which of these
    taxels: Array  # (h,) is shown by which taxel
    shares: Array  # (h,) of its area

    def on_triangles(self, pressures: Array) -> Array:
        """Mean pressures (..., G) on the triangles, from those of taxels, (..., rows, columns)."""
        flat = pressures.reshape(-1, len(self.areas))
        shown = np.zeros((len(flat), len(self.triangles)))
        np.add.at(shown.T, self.seen, (flat[:, self.taxels] * self.shares).T)
        return shown.reshape(*pressures.shape[:-2], len(self.triangles))


def unpacked(values: Array, grid: Array) -> TouchState:
    """What a reading's numbers (..., V) say, of taxels in so many rows and columns."""
    rows, columns = (int(count) for count in grid)
    lead = values.shape[:-1]
    head, rest = values[..., :HEAD], values[..., HEAD:]
    of_patches, pressures = np.split(rest, [rest.shape[-1] - rows * columns], axis=-1)
    parts = of_patches.reshape(*lead, -1, OF_PATCH)
    patches = ContactPatches(**_parts(parts, PATCH))
    return TouchState(**_parts(head, WHOLE), patches=patches, pressures=pressures.reshape(*lead, rows, columns))


def touch_of(readings: Mapping[str, Any], name: str, read: Callable[[str], Array]) -> TouchState:
    """What a sense of touch among readings shows, by what reads them: of one body, or of many.

    Raises:
        StepError: there is none of that name.
    """
    known = {own: reading for own, reading in readings.items() if isinstance(reading, TouchReading)}
    check_known("sense of touch", name, known, StepError)
    return unpacked(read(name), known[name].map.grid)


def _parts(values: Array, widths: dict[str, int]) -> dict[str, Array]:
    ends = np.cumsum([*widths.values()])
    return {
        name: values[..., end - width : end] if width > 1 else values[..., end - 1]
        for (name, width), end in zip(widths.items(), ends, strict=True)
    }


@dataclass(frozen=True)
class TouchReading:
    """A sense of touch on a piece of the surface.

    Attributes:
        of: empty.
        nodes: (s,) of the surface.
        facets: (F, 3) or (F, 6) rows of `nodes`.
        areas: (F,) theirs at rest, m².
        places: (s, 3) of the nodes at rest, m.
        origin: (3,) about which torques are, at rest, m.
        patches: Q, how many patches of contact are told.
        map: of the taxels.
        felt: (h,) which node shares its force with
        taxels: (h,) which taxel, and
        shares: (h,) which share of it.
        sensor: what a real one adds.
    """

    quantity: ClassVar = TOUCH
    of: ClassVar = ""
    nodes: Array
    facets: Array
    areas: Array
    places: Array
    origin: Array
    patches: int
    map: TaxelMap
    felt: Array
    taxels: Array
    shares: Array
    sensor: Sensor

    @property
    def size(self) -> int:
        """V, how many numbers there are."""
        return HEAD + OF_PATCH * self.patches + len(self.map.areas)

    @property
    def shares_of_area(self) -> Array:
        """Area that each node stands for, (s,), m²; on facets of six nodes those in the middles of sides."""
        return np.bincount(self._sharing.ravel(), np.repeat(self.areas / 3, 3), minlength=len(self.nodes))

    @property
    def _sharing(self) -> Array:
        """Of each facet the nodes that have a third of its area, (F, 3)."""
        return self.facets if self.facets.shape[1] == 3 else self.facets[:, 3:]

    @property
    def middle(self) -> Array:
        """Of the surface at rest, (3,), m."""
        return self._middle_of(self.places)

    @property
    def untouched(self) -> Array:
        """Its values where nothing touches, (V,)."""
        values = np.zeros(self.size)
        values[6:9] = self.middle
        self._patches_in(values)[:, MARGIN] = 1.0
        return values

    def read(self, body: ReadableBody) -> Array:
        """Its values, (V,), without what a sensor adds; see `unpacked`."""
        values = self.untouched
        patches = self._patches_in(values)
        if body.points is None or body.pressing is None:
            return values
        assert body.forces is not None
        assert body.places is not None
        assert body.rubbing is not None
        forces, pressing = (body.points.on_nodes(of, self.nodes) for of in (body.forces, body.pressing))
        touches = np.abs(pressing) > PRESSES * np.abs(body.pressing).max(initial=0.0)
        if not touches.any():
            return values
        places = body.places()[self.nodes]
        values[:3] = forces.sum(axis=0)
        values[3:6] = np.cross(places - self._origin_at(places), forces).sum(axis=0)
        areas, rubbing = self._areas_of_contact(pressing, touches), body.rubbing()
        assert rubbing is not None
        t, limits, slipping, sliding = (body.points.on_nodes(of, self.nodes) for of in rubbing)
        labels = self._labels(touches)
        several = [labels == label for label in np.unique(labels[touches])]
        several.sort(key=lambda own: -pressing[own].sum())
        values[9], values[10], values[11] = pressing.sum(), areas[touches].sum(), len(several)
        if values[9] > 0:
            values[6:9] = pressing @ self.places / values[9]
        for row, own in zip(patches, several, strict=False):
            total = pressing[own].sum()
            if total <= 0:
                continue
            row[:2], row[2:5] = (total, areas[own].sum()), pressing[own] @ self.places[own] / total
            row[5:8], limit = slipping[own].sum(axis=0) / total, limits[own].sum()
            used = np.linalg.norm(t[own].sum(axis=0)) / limit if limit > 0 else 1.0
            row[MARGIN:] = max(0.0, 1.0 - used), sliding[own].sum() / total
        values[len(values) - len(self.map.areas) :] = self._pressures(pressing)
        return values

    def _patches_in(self, values: Array) -> Array:
        """The part of them that is of patches, (Q, 10)."""
        return values[HEAD : HEAD + OF_PATCH * self.patches].reshape(-1, OF_PATCH)

    def _areas_of_contact(self, pressing: Array, touches: Array) -> Array:
        """Of nodes (s,), m²: of those on the rim of a patch that part which their pressure tells, see `RIM`."""
        shares = self.shares_of_area
        pressures = np.divide(pressing, shares, out=np.zeros(len(shares)), where=touches & (shares > 0))
        nodes, around = self._sharing, np.zeros(len(shares))
        np.maximum.at(around, nodes, pressures[nodes].max(axis=1)[:, None])
        is_rim = np.zeros(len(shares), dtype=bool)
        is_rim[nodes[~touches[nodes].all(axis=1)]] = True
        ratio = np.divide(pressures, around, out=np.zeros(len(shares)), where=around > 0)
        return shares * touches * np.where(is_rim, np.interp(ratio, RIM, COVERED), 1.0)

    def _pressures(self, pressing: Array) -> Array:
        """Of taxels (K,), Pa, under normal forces on the nodes (s,), N."""
        areas = self.map.areas
        forces = np.bincount(self.taxels, self.shares * pressing[self.felt], minlength=len(areas))
        return np.divide(forces, areas, out=np.zeros(len(areas)), where=areas > 0)

    def _labels(self, touches: Array) -> Array:
        """Of nodes (s,): the same for those that touch and are connected by facets."""
        labels = np.where(touches, np.arange(len(touches)), len(touches))
        facets = self.facets[touches[self.facets].sum(axis=1) > 1]
        while True:
            least = labels[facets].min(axis=1)
            new = labels.copy()
            np.minimum.at(new, facets, least[:, None])
            new[~touches] = len(touches)
            if (new == labels).all():
                return labels
            labels = new

    def _middle_of(self, places: Array) -> Array:
        """The mean over the surface of places of its nodes (s, 3), m."""
        middle: Array = self.areas @ places[self.facets[:, :3]].mean(axis=1) / self.areas.sum()
        return middle

    def _origin_at(self, places: Array) -> Array:
        """Where `origin` is, as if fixed to the surface as a whole, whose nodes are at places (s, 3)."""
        there, here = self._middle_of(places), self.middle
        weights = self.shares_of_area[:, None]
        U, _, V = np.linalg.svd((weights * (places - there)).T @ (self.places - here))
        U[:, 2] *= np.linalg.det(U) * np.linalg.det(V)
        origin: Array = there + U @ V @ (self.origin - here)
        return origin
