"""What of a surface is drawn: smooth parts between its edges, and what colours them."""

import math
from collections.abc import Callable, Mapping

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.environment import Environment
from fenics_rom.mechanics.linearity import triangle_frames
from fenics_rom.mechanics.touch import TOUCH
from fenics_rom.trajectory.series import ReadingSeries
from fenics_rom.visualization.viewer.colours import with_unit

# Of displacement (n, 3), m, and velocity (n, 3), m/s: values at all vertices.
SurfaceField = Callable[[Array, Array], Array]

READING = "reading "  # before the name of one, among the fields
OFF_SURFACE = ("length", "volume", "stress", "marker", "reaction")  # readings that are said in words alone
CONTACT_PRESSURE = "contact pressure"
UNITS = {"displacement": "m", "speed": "m/s", "strain": "%", "energy density": "J/m³", CONTACT_PRESSURE: "Pa"}
CREASE = math.radians(35)  # between triangles that turn by more, light and colours have an edge
MIN_RELATIVE_AREA = 1e-9  # twice the area of a triangle, of its longest side squared; below, it has no strain


class Surface:
    """The surface of a body as it is drawn: smooth, but for the edges that the body has at rest.

    Attributes:
        nodes: (n,) those of the body that are on the surface.
        places: (n, 3) theirs at rest, m.
        triangles: (F, 3) into `nodes`.
        node_of: (V,) the node (into `nodes`) that each vertex is at; on an edge a node has one for each side of it.
        faces: (F, 3) the triangles' vertices.
    """

    def __init__(self, nodes: Array, triangles: Array):
        self.nodes, corners = np.unique(triangles, return_inverse=True)
        self.places, self.triangles = nodes[self.nodes], corners.reshape(-1, 3)
        across = np.cross(*(self.places[self.triangles[:, k]] - self.places[self.triangles[:, 0]] for k in (1, 2)))
        self._doubled_area = np.linalg.norm(across, axis=1)
        normals = across / np.maximum(self._doubled_area, np.finfo(float).tiny)[:, None]
        smooth = _smoothly_joined_corners(self.triangles, normals)
        _, first, faces = np.unique(smooth, return_index=True, return_inverse=True)
        self.node_of, self.faces = self.triangles.ravel()[first], faces.reshape(-1, 3)

    def of_nodes(self, values: Array, triangles: Array | None = None) -> Array:
        """Values at all vertices, (V,), of values at the nodes (n,); 0 off triangles (F,) that are told."""
        at_vertices: Array = values[self.node_of]
        if triangles is not None:
            off = np.ones(len(at_vertices), dtype=bool)
            off[self.faces[triangles]] = False
            at_vertices[off] = 0.0
        return at_vertices

    def of_triangles(self, values: Array) -> Array:
        """Values at all vertices, (V,), of values that are constant on triangles (F,): means weighted by area."""
        weight = np.maximum(self._doubled_area, np.finfo(float).tiny)
        sums = [
            np.bincount(self.faces.ravel(), np.repeat(each, 3), len(self.node_of)) for each in (weight * values, weight)
        ]
        return sums[0] / sums[1]


def _smoothly_joined_corners(triangles: Array, normals: Array) -> Array:
    """A number for each corner of triangles, (3 F,), the same of those at one node that no crease parts."""
    corners = np.arange(triangles.size).reshape(-1, 3)
    starts, ends = corners.ravel(), np.roll(corners, -1, axis=1).ravel()
    at = triangles.ravel()
    sides = np.sort(np.stack([at[starts], at[ends]], axis=1), axis=1)
    order = np.lexsort(sides.T)
    same = (sides[order[1:]] == sides[order[:-1]]).all(axis=1)
    one, other = order[:-1][same], order[1:][same]
    flat = (normals[one // 3] * normals[other // 3]).sum(axis=1) > math.cos(CREASE)
    one, other = one[flat], other[flat]
    meets = at[starts[one]] == at[ends[other]]  # neighbours run through a side in opposite directions
    one_ends = np.concatenate([starts[one], ends[one]])
    other_ends = np.concatenate(
        [np.where(meets, ends[other], starts[other]), np.where(meets, starts[other], ends[other])]
    )
    numbers = corners.ravel().copy()
    while True:  # the least of a group goes round it, a triangle at a time
        least = np.minimum(numbers[one_ends], numbers[other_ends])
        if (least == numbers[one_ends]).all() and (least == numbers[other_ends]).all():
            return numbers
        np.minimum.at(numbers, one_ends, least)
        np.minimum.at(numbers, other_ends, least)


class SurfaceStrain:
    """Strain in the plane of each triangle, from the displacement of its corners.

    A surface that nothing pushes is free of traction, so that its stress is plane and its strain in the plane tells
    all of its energy density: w = E / (2 (1 - ν²)) (ε₁₁² + ε₂₂² + 2 ν ε₁₁ ε₂₂ + 2 (1 - ν) ε₁₂²).
    Source: Timoshenko & Goodier, Theory of Elasticity, 1970, § 16 and § 90 (plane stress). Triangles without area have
    no strain.
    """

    def __init__(self, places: Array, triangles: Array):
        a, b = places[triangles[:, 1]] - places[triangles[:, 0]], places[triangles[:, 2]] - places[triangles[:, 0]]
        longest = np.maximum(np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1))
        solid = np.linalg.norm(np.cross(a, b), axis=1) > MIN_RELATIVE_AREA * longest**2
        a[~solid], b[~solid] = np.eye(3)[:2]
        frame, shape_gradients = triangle_frames(a, b)
        (e1, e2, _), (s1, s2) = frame.swapaxes(0, 1), shape_gradients.transpose(2, 0, 1)
        rows = [
            s1[:, :, None] * e1[:, None],
            s2[:, :, None] * e2[:, None],
            (s2[:, :, None] * e1[:, None] + s1[:, :, None] * e2[:, None]) / 2,
        ]
        self._operator = np.stack(rows, axis=1).reshape(-1, 3, 9) * solid[:, None, None]
        self._triangles = triangles

    def components(self, displacement: Array) -> Array:
        """ε₁₁, ε₂₂ and ε₁₂ of each triangle, (F, 3), from the displacement of the nodes (n, 3), m."""
        corners = displacement[self._triangles].reshape(-1, 9, 1)
        return (self._operator @ corners)[:, :, 0]

    def largest(self, displacement: Array) -> Array:
        """The principal strain of largest size, without its sign, (F,)."""
        ε1, ε2, shear = self.components(displacement).T
        return np.abs(ε1 + ε2) / 2 + np.hypot((ε1 - ε2) / 2, shear)

    def energy_density(self, displacement: Array, young: float, poisson: float) -> Array:
        """Of a surface without traction, (F,), J/m³; E in Pa."""
        ε1, ε2, shear = self.components(displacement).T
        plane = ε1**2 + ε2**2 + 2 * poisson * ε1 * ε2 + 2 * (1 - poisson) * shear**2
        return young / (2 * (1 - poisson**2)) * plane


def surface_fields(
    surface: Surface, environment: Environment | None, *, moves: bool = True
) -> Mapping[str, SurfaceField]:
    """What can be shown, by name; the units are in UNITS.

    Energy density is that of a surface without traction (see SurfaceStrain), and there is none where the body has
    several materials: a ROM does not say which of them a triangle is of. A body that `moves` has velocities.
    """
    strain = SurfaceStrain(surface.places, surface.triangles)

    def of_length(vectors: Array) -> Array:
        return surface.of_nodes(np.linalg.norm(vectors, axis=1))

    available: dict[str, SurfaceField] = {"displacement": lambda x, v: of_length(x)}
    if moves:
        available["speed"] = lambda x, v: of_length(v)
    available["strain"] = lambda x, v: surface.of_triangles(100 * strain.largest(x))
    places = [] if environment is None else [place for place in environment.built_in if place.startswith("materials.")]
    if environment is not None and len(places) == 1:
        material = environment.details(places[0])
        E, ν = material["young"], material["poisson"]
        available["energy density"] = lambda x, v: surface.of_triangles(strain.energy_density(x, E, ν))
    return available


class ReadingField:
    """A reading on the surface as colour.

    Attributes:
        unit: of the values.
    """

    def __init__(self, surface: Surface, reading: ReadingSeries):
        self._surface, self._nodes, self._triangles = surface, reading.nodes, reading.triangles
        self._factor, self.unit = (100.0, "%") if reading.quantity == "strain" else (1.0, reading.unit)
        if reading.taxels is not None:
            self._triangles, self.unit = reading.taxels.triangles, "Pa"

    def __call__(self, sizes: Array) -> Array:
        """Values at all vertices, (V,), from those at the reading's places; 0 where nothing is read."""
        if len(self._nodes):
            on_nodes = np.zeros(len(self._surface.nodes))
            on_nodes[np.searchsorted(self._surface.nodes, self._nodes)] = sizes
            return self._surface.of_nodes(on_nodes)
        on_triangles = np.zeros(len(self._surface.triangles))
        on_triangles[self._triangles] = self._factor * sizes
        return self._surface.of_triangles(on_triangles)


def reading_fields(surface: Surface, readings: Mapping[str, ReadingSeries]) -> dict[str, ReadingField]:
    """Those that are on the surface, by what they are called among the fields."""
    return {
        READING + name: ReadingField(surface, reading)
        for name, reading in readings.items()
        if reading.quantity not in OFF_SURFACE and (reading.taxels is None or len(reading.taxels.triangles))
    }


def reading_words(readings: Mapping[str, ReadingSeries], instant: int) -> list[str]:
    """Lengths and volumes, as flexor: 98.231 mm, how far markers are displaced, stresses and forces of supports.

    Of touch the normal force, the area of contact, and the margin to slip of the patch that presses most.
    """
    words = []
    for name, reading in readings.items():
        if reading.quantity == TOUCH:
            felt = reading.at(instant).touch
            words.append(
                f"{name}: {with_unit(float(felt.normal_force[0]), 'N')} on {1e6 * felt.area[0]:.3g} mm², "
                f"margin to slip {100 * felt.patches.margin[0, 0]:.0f} %"
            )
        elif reading.quantity in OFF_SURFACE:
            words.append(f"{name}: {with_unit(float(reading.sizes[instant].max()), reading.unit, digits=5)}")
    return words
