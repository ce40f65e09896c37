"""Where a contact mode is touched, as far as a ROM knows it."""

import numpy as np

from fenics_rom.rom.rom import Rom

Array = np.ndarray


def find_contact_triangles(rom: Rom, name: str) -> Array:
    """Surface triangles (any, 3) of a contact mode; none of a model without a mesh, or of an old file."""
    nodes = rom.contact_surfaces.get(name, np.empty(0, dtype=int))
    return rom.triangles[np.isin(rom.triangles, nodes).all(axis=1)]
