"""What is read of a body by name: lengths, volumes, pressures in contact, strains, stresses, markers off the surface.

The same at full order and reduced: a reading asks a body for what it needs (`ReadableBody`), and gives numbers.

    ℓ = ℓ_0 - s,  V = V_0 + s     s the stroke: what the actuator's input of 1 does work on
    p = λ / A                      normal forces of contact over the areas of their nodes
    ε, σ of H = ∂u/∂X              at places of the surface, from the gradients in the cell that adjoins each
    -tr σ / 3, W                   there: the pressure, and the energy that is stored by volume at rest
    σ of H, averaged               at points, from the cells around the corners of theirs
    u + (R - 1) d                  of a marker at d from its foot on a triangle that is displaced by u and turned by R
    R                              force and couple of supports (`reactions.py`)

Of a linear model s = bᵀx of the actuator's column b, ε = (H + Hᵀ)/2, and σ = λ tr ε' I + 2μ ε' with ε' = ε - α T I of
temperatures T, exactly. With large
deformation s is that of the moved cable or chamber, E the Green strain, σ = F S Fᵀ / det F Cauchy's stress.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.fibres import Fibres
from fenics_rom.mechanics.hyperelastic import small_strain, strain
from fenics_rom.mechanics.nodal_contact import FacetShares
from fenics_rom.mechanics.point_material import PointMaterial
from fenics_rom.mechanics.reactions import REACTION, ReactionReading
from fenics_rom.mechanics.readable_body import ReadableBody
from fenics_rom.mechanics.touch import TOUCH, TouchReading
from fenics_rom.mechanics.voigt import VOIGT_INDEX, VOIGT_PAIRS, VOIGT_SHEAR

READING_UNITS = {
    "length": "m",
    "volume": "m3",
    "contact_pressure": "Pa",
    "strain": "1",
    "von_mises_stress": "Pa",
    "surface_stress": "Pa",
    "principal_stress": "Pa",
    "pressure": "Pa",
    "energy_density": "J/m3",
    "stress": "Pa",
    "marker": "m",
    REACTION: "N and N m",
    TOUCH: "N, N m, m, m2, m/s, Pa and 1",
}
OF_SURFACE = ("strain", "von_mises_stress", "surface_stress", "principal_stress", "pressure", "energy_density")
OF_VOLUME = OF_SURFACE[2:]  # of them those that changes of volume are in
COMPONENTS = ("xx", "yy", "zz", "yz", "xz", "xy")
TENSORS = ("strain", "surface_stress", "stress")  # what has them
PRINCIPAL = ("principal 1", "principal 2", "principal 3")
STRESS_PARTS = (*COMPONENTS, *PRINCIPAL, "von Mises", "spread")  # what is read at a point
VON_MISES = STRESS_PARTS.index("von Mises")
READING_WORDS = {name: name.replace("_", " ") for name in READING_UNITS} | {
    "von_mises_stress": "von Mises stress",
    "surface_stress": "stress",
    "marker": "displacement of a marker",
    REACTION: "reaction of supports",
    TOUCH: "touch",
}


@dataclass(frozen=True)
class StrokeReading:
    """Length of a cable, (), m, or volume that the surface of a pressure encloses, (), m³."""

    quantity: str  # "length" or "volume"
    of: str  # the tendon, or the pressure
    rest: float  # the length, or the volume, at rest

    def read(self, body: ReadableBody) -> Array:
        """Its value."""
        return np.array(self.rest + (-1 if self.quantity == "length" else 1) * body.stroke(self.of))


@dataclass(frozen=True)
class ContactPressure:
    """Normal forces of obstacles by area, at the nodes of a contact surface, (s,), Pa.

    On facets of three nodes a node has a third of its facets, of four a quarter, of nine its share of a uniform
    pressure. On those of six, where a uniform pressure leaves nothing to the corners, each facet has its share by area
    of the forces on its nodes, and a node the mean of its facets, by area. Either way a uniform pressure is exact.
    """

    quantity: ClassVar = "contact_pressure"
    of: str  # the contact mode
    nodes: Array  # (s,) of its surface
    facets: Array  # (F, any) rows of `nodes`, as `FacetShares` takes them
    areas: Array  # (F,) theirs at rest, m²

    def read(self, body: ReadableBody) -> Array:
        """Its values."""
        shares = FacetShares(self.facets, self.areas, len(self.nodes))
        return shares.density(body.normal_forces(self.nodes))


@dataclass(frozen=True)
class SurfaceReading:
    """Strain, (P, 6), stress, or energy in the middle of surface triangles.

    Strain and stress have the components xx, yy, zz, yz, xz, xy of their tensors. Or of the stress it is that of von
    Mises, (P,), the three principal ones from the largest on, (P, 3), or the pressure, (P,), Pa; of the energy that by
    volume at rest, (P,), J/m³. The stress is the elastic one: what viscosity adds while the body moves is not in it.

    Attributes:
        quantity: one of `OF_SURFACE`.
        of: the surface; empty for all of it.
        triangles: (P,) which of the body's.
        operator: to H (3, 3, P) of the body's coordinates, (9 P, c), a matrix; 1/m.
        first_lame, shear: λ and μ of the cells, (P,), Pa.
        fibres: beside them.
        expansions: of each temperature with an amplitude of 1, α T there, (P,).
    """

    quantity: str
    of: str
    triangles: Array
    operator: Any
    first_lame: Array
    shear: Array
    fibres: tuple[Fibres, ...] = ()
    expansions: Mapping[str, Array] = field(default_factory=dict)

    def read(self, body: ReadableBody) -> Array:
        """Its values."""
        H = (self.operator @ body.coordinates()).reshape(3, 3, -1)
        if self.quantity == "strain":
            return ((small_strain(H) if body.law is None else strain(H)) / VOIGT_SHEAR).T
        if self.quantity == "energy_density":
            return energy_of(body, H, self)
        σ = stress_of(body, H, self)
        if self.quantity == "pressure":
            return -σ[:3].mean(axis=0)
        if self.quantity == "surface_stress":
            return σ.T
        return principal_stresses(σ) if self.quantity == "principal_stress" else von_mises(σ)


@dataclass(frozen=True)
class StressReading:
    """Stress at points, (G, 11), Pa: `STRESS_PARTS`, with the principal stresses from the largest to the smallest.

    At each corner of the cell that a point is in, the stresses that the cells of the same material around this corner
    have there are averaged, by volume; between the corners it is interpolated linearly. The spread is how far these
    cells differ: of the component of which it is most, the largest less the smallest of them, interpolated alike.
    In tetrahedra with displacements of second degree the stress of a cell is linear, of first degree constant. That of
    a hexahedron is extrapolated to its corner.

    Attributes:
        points: (G, 3), m, at rest.
        corner_points: (K,) which point each corner is for, ascending.
        corner_weights: (K,) of the interpolation.
        value_corners: (T,) which corner each value of a cell is for, ascending.
        value_shares: (T,) of the cell in the volume around its corner.
        place_weights: (T, R) of the R places in the cell that each value is extrapolated from.
        operator: to H (3, 3, P) of the body's coordinates, (9 P, c), a matrix; 1/m. P is T R, or twice as many where
            changes of volume are integrated apart from the rest: then places for these follow.
        first_lame, shear: λ and μ that each has, (P,), Pa.
        fibres: beside them.
        expansions: of each temperature with an amplitude of 1, α T there, (P,).
    """

    quantity: ClassVar = "stress"
    of: ClassVar = ""
    points: Array
    corner_points: Array
    corner_weights: Array
    value_corners: Array
    value_shares: Array
    place_weights: Array
    operator: Any
    first_lame: Array
    shear: Array
    fibres: tuple[Fibres, ...] = ()
    expansions: Mapping[str, Array] = field(default_factory=dict)

    def read(self, body: ReadableBody) -> Array:
        """Its values."""
        H = (self.operator @ body.coordinates()).reshape(3, 3, -1)
        σ = self._at_corners(stress_of(body, H, self)[..., None])[..., 0]
        of_corner = np.searchsorted(self.value_corners, np.arange(len(self.corner_points)))
        spreads = np.maximum.reduceat(σ, of_corner, axis=1) - np.minimum.reduceat(σ, of_corner, axis=1)
        at = self._at_points(np.add.reduceat(σ * self.value_shares, of_corner, axis=1))
        return np.column_stack([at.T, principal_stresses(at), von_mises(at), self._at_points(spreads).max(axis=0)])

    def components(self, gradients: Array) -> Array:
        """σ (6, G, m), Pa, of a linear body, from H (3, 3, P, m) of each of m displacements."""
        σ = PointMaterial("", self.first_lame, self.shear, self.fibres).linear_stress(small_strain(gradients))
        σ = self._at_corners(σ) * self.value_shares[:, None]
        of_corner = np.searchsorted(self.value_corners, np.arange(len(self.corner_points)))
        return self._at_points(np.add.reduceat(σ, of_corner, axis=1))

    def _at_corners(self, σ: Array) -> Array:
        """(6, T, m) of each cell at its corner, from those (6, P, m) at the places."""
        at_places = σ.reshape(6, -1, *self.place_weights.shape, σ.shape[-1])
        values: Array = (at_places * self.place_weights[..., None]).sum(axis=(1, 3))
        return values

    def _at_points(self, of_corners: Array) -> Array:
        """Values (6, G, ...) at the points, from those (6, K, ...) at their corners."""
        of_point = np.searchsorted(self.corner_points, np.arange(len(self.points)))
        weights = self.corner_weights.reshape(-1, *(1,) * (of_corners.ndim - 2))
        return np.add.reduceat(weights * of_corners, of_point, axis=1)


@dataclass(frozen=True)
class MarkerReading:
    """Displacement, (3,), m, of a marker that is rigidly on a triangle of the surface, which it may stand off.

    Attributes:
        operator: to the displacement u of its foot, ∂u/∂t₁ and ∂u/∂t₂ of the body's coordinates, (9, c), a matrix.
        tangents: t₁ and t₂, orthonormal and in the triangle, (2, 3).
        offset: d, from its foot to it, at rest, (3,), m.
    """

    quantity: ClassVar = "marker"
    of: ClassVar = ""
    operator: Any
    tangents: Array
    offset: Array

    @property
    def small_motion(self) -> Array:
        """To its displacement from what `operator` gives while the body turns little, u + skew(H) d, (3, 9).

        H = Σ ∂u/∂t tᵀ + δN Nᵀ with the turn of the normal, δN = -Σ t (N·∂u/∂t).
        """
        N, d = np.cross(*self.tangents), self.offset
        parts = [np.eye(3)]
        for t in self.tangents:
            parts.append(((t @ d) * (np.eye(3) + np.outer(N, N)) - np.outer(t, d) - (N @ d) * np.outer(t, N)) / 2)
        return np.hstack(parts)

    def read(self, body: ReadableBody) -> Array:
        """Its value."""
        moved = np.asarray(self.operator @ body.coordinates()).reshape(3, 3)
        if body.law is None:
            displacement: Array = self.small_motion @ moved.ravel()
            return displacement
        return self.turned(moved)

    def turned(self, moved: Array) -> Array:
        """Displacements (..., 3), m, however far it turns, from u, ∂u/∂t₁ and ∂u/∂t₂ (..., 3, 3)."""
        frame, moved_frame = (_with_normal(pair) for pair in (self.tangents, self.tangents + moved[..., 1:, :]))
        U, _, V = np.linalg.svd(moved_frame.swapaxes(-1, -2) @ frame)
        there: Array = moved[..., 0, :] + U @ V @ self.offset - self.offset
        return there


def _with_normal(pair: Array) -> Array:
    """Two vectors (..., 2, 3) and the unit one that is normal to them, (..., 3, 3)."""
    normal = np.cross(pair[..., 0, :], pair[..., 1, :])
    return np.concatenate([pair, (normal / np.linalg.norm(normal, axis=-1, keepdims=True))[..., None, :]], axis=-2)


OfDisplacement = SurfaceReading | StressReading | MarkerReading  # with an operator on the body's coordinates
Reading = StrokeReading | ContactPressure | OfDisplacement | ReactionReading | TouchReading


def projected(reading: Reading, basis: Array) -> Reading:
    """The reading of a body whose displacement is basis (n, k) times its coordinates."""
    if isinstance(reading, ReactionReading):
        return reading.projected(basis)
    if not isinstance(reading, OfDisplacement):
        return reading
    return replace(reading, operator=np.asarray(reading.operator @ basis))


def stress_of(body: ReadableBody, H: Array, at: "SurfaceReading | StressReading") -> Array:
    """Cauchy's stress F S Fᵀ / det F (6, P), Pa, of displacement gradients (3, 3, P) by a body's law."""
    law = body.law
    material = PointMaterial(law or "", at.first_lame, at.shear, at.fibres)
    if law is None:
        return material.linear_stress(elastic_strain(body, H, at))
    F, S = H.transpose(2, 0, 1) + np.eye(3), material.stress(strain(H))
    σ = F @ S[VOIGT_INDEX].transpose(2, 0, 1) @ F.transpose(0, 2, 1) / np.linalg.det(F)[:, None, None]
    i, j = VOIGT_PAIRS.T
    components: Array = σ[:, i, j].T
    return components


def elastic_strain(body: ReadableBody, H: Array, at: "SurfaceReading | StressReading") -> Array:
    """Small strains (6, P) less those that temperatures make of a body that is free."""
    ε = small_strain(H)
    if at.expansions:
        now = {} if body.amplitudes is None else body.amplitudes()
        ε[:3] -= sum(now.get(name, 0.0) * strain for name, strain in at.expansions.items())
    return ε


def energy_of(body: ReadableBody, H: Array, at: SurfaceReading) -> Array:
    """W (P,), J/m³ at rest, of displacement gradients (3, 3, P) by a body's law."""
    law = body.law
    material = PointMaterial(law or "", at.first_lame, at.shear, at.fibres)
    if law is None:
        ε = elastic_strain(body, H, at)
        energy: Array = (ε * material.linear_stress(ε)).sum(axis=0) / 2
        return energy
    return material.energy_density(strain(H))


def principal_stresses(σ: Array) -> Array:
    """(P, 3), Pa, from the largest to the smallest, of stresses (6, P), Pa."""
    principal: Array = np.linalg.eigvalsh(σ[VOIGT_INDEX].transpose(2, 0, 1))[:, ::-1]
    return principal


def von_mises(σ: Array) -> Array:
    """√(3/2 s:s) (P,), Pa, of the deviator s of stresses (6, P), Pa."""
    xx, yy, zz, yz, xz, xy = σ
    normal = ((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2) / 2
    return np.sqrt(normal + 3 * (yz**2 + xz**2 + xy**2))


def principal_size(strains: Array) -> Array:
    """Largest |principal strain| (...,) of strain tensors (..., 6)."""
    return np.abs(np.linalg.eigvalsh(strains[..., VOIGT_INDEX])).max(axis=-1)


def swept_volume(force: Callable[[Array], Array], x: Array) -> float:
    """∫ f·dx along the straight way to x (c,), m³, of the force f (c,) of 1 Pa, of second degree in x.

    f is the derivative of the volume, so any way would do; Simpson's rule is exact for it.
    """
    return float(x @ (force(np.zeros_like(x)) + 4 * force(x / 2) + force(x))) / 6


def swept_volume_slope(force: Callable[[Array], Array], slope: Callable[[Array], Array], x: Array) -> Array:
    """∂/∂x of it (c,), by ∂f/∂x (c, c): f to round-off, or as nearly as f is the derivative of a volume."""
    along = force(np.zeros_like(x)) + 4 * force(x / 2) + force(x)
    by_force: Array = (along + (2 * slope(x / 2) + slope(x)).T @ x) / 6
    return by_force
