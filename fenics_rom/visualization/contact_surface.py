"""Where a contact mode is touched, as triangles of the surface."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.rom.rom import Rom

SURFACE_VELOCITY_SHARE = 0.5  # of the largest velocity after a push, that the contact surface has at least


def on_kept_surface(rom: Rom, contact: str) -> Array:
    """Which surface triangles (F,) are of the surface that the ROM keeps of a contact mode; of many old files none."""
    return np.isin(rom.triangles, rom.contact_surfaces.get(contact, np.empty(0, dtype=int))).all(axis=1)


def divide_contact_triangles(rom: Rom) -> dict[str, Array]:
    """Triangles (F_i,) of each contact mode's surface, none of them two modes': where they overlap, the smallest's."""
    a, b, c = rom.nodes[rom.triangles].swapaxes(0, 1)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    within = np.array([_on_surface(rom, contact) for contact in rom.contact_models])
    smallest = np.where(within, (within @ areas)[:, None], np.inf).argmin(axis=0)
    return {name: np.flatnonzero(within[k] & (smallest == k)) for k, name in enumerate(rom.contact_models)}


def _on_surface(rom: Rom, contact: str) -> Array:
    """Which triangles (F,) are a contact mode's.

    Where that is not kept, a unit impulse W_i Wᵢᵀ B_i tells: it moves the surface at once, and the rest hardly.
    """
    kept = on_kept_surface(rom, contact)
    if kept.any():
        return kept
    mode = rom.contact_models[contact]
    velocity = np.zeros(len(rom.nodes))
    for column in (mode.coordinates @ mode.inputs[:, : rom.contacts[contact]]).T:
        velocity = np.maximum(velocity, np.linalg.norm(rom.reconstruct(column), axis=1))
    moved = velocity[rom.triangles].mean(axis=1)
    return moved > SURFACE_VELOCITY_SHARE * moved.max(initial=0.0)
