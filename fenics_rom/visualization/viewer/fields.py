"""What can be shown as colour on a surface."""

from collections.abc import Callable, Mapping

import numpy as np

from fenics_rom.mechanics.environment import Environment
from fenics_rom.visualization.viewer.surface import Surface, SurfaceStrain

Array = np.ndarray
# Of displacement (n, 3), m, and velocity (n, 3), m/s: values of all pieces.
SurfaceField = Callable[[Array, Array], Array]

UNITS = {"displacement": "m", "speed": "m/s", "strain": "%", "energy density": "J/m³"}


def surface_fields(
    surface: Surface, environment: Environment | None, *, moves: bool = True
) -> Mapping[str, SurfaceField]:
    """What can be shown, by name; the units are in UNITS.

    Energy density is that of a surface without traction (see SurfaceStrain), and there is none where the body has
    several materials: a ROM does not say which of them a triangle is of.

    Args:
        surface: of the body.
        environment: of the body, which knows its material; None where it is not known.
        moves: whether there are velocities.
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
