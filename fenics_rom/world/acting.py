"""What of a ROM's scene acts on a soft body in a world: all but its obstacles and its law of contact."""

from dataclasses import replace

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError
from fenics_rom.mechanics.contact import ContactLaw
from fenics_rom.mechanics.contact_points import ContactPoints
from fenics_rom.mechanics.environment import Environment
from fenics_rom.mechanics.placed_surface import PlacedSurface
from fenics_rom.mechanics.rounded_surface import rounding_of
from fenics_rom.mechanics.triangles import triangles_among
from fenics_rom.rom.rom import Rom

_NO_NODES = np.empty(0, dtype=int)


def acting_in_world(rom: Rom) -> tuple[Rom, Environment, tuple[str, ...]]:
    """A ROM with points at which others can hold it, what acts on it, and what to say of that.

    Raises:
        SceneError: a ROM that was made from matrices, of which nobody knows where it is.
    """
    acting = rom.environment
    if not acting.is_of_scene:
        raise SceneError(
            f"ROM {rom.name!r} was made from matrices, which do not say where it can be touched or held: use a "
            "ROM of a scene"
        )
    law, said = acting.contact_law, list[str]()
    if law is None:
        rom = _with_points(rom)
    elif law.stiffness is not None:
        said.append(
            f"its scene has springs of {law.stiffness:g} N/m at its contact points (effects.contact.method = "
            "'penalty'); bodies of a world meet by the rigid law, without these"
        )
    return (
        rom,
        replace(acting, obstacles={}, self_contact=(), touches_faces=False, run=None, contact_law=ContactLaw()),
        tuple(said),
    )


def touched_surface(rom: Rom, points: ContactPoints) -> PlacedSurface:
    """Where others can touch a body: at its contact points at rest, and at faces between them if its scene says so."""
    triangles, places = triangles_among(points.nodes, rom.triangles), points.coordinates
    faces = points.faces(rom.triangles) if rom.environment.touches_faces else None
    return PlacedSurface(places, triangles, np.arange(len(places)), faces, rounding_of(places, triangles))


def _with_points(rom: Rom) -> Rom:
    """The same with the nodes of its contact modes that can move, or of its whole surface, as contact points."""
    movable = np.zeros(3 * len(rom.nodes), dtype=bool)
    movable[rom.free] = True
    movable = movable.reshape(-1, 3).any(axis=1)

    def points(name: str) -> Array:
        nodes = rom.contact_surfaces.get(name, _NO_NODES)
        nodes = nodes if len(nodes) else np.unique(rom.triangles)
        return nodes[movable[nodes]]

    modes = {name: replace(model, contact_points=points(name)) for name, model in rom.contact_models.items()}
    return replace(rom, contact_models=modes)
