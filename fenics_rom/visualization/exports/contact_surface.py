"""Where a contact mode is touched, as far as a ROM knows it."""

import numpy as np

from fenics_rom.errors import FenicsRomError
from fenics_rom.rom.rom import Rom
from fenics_rom.scene.file import parse_scene

Array = np.ndarray


def touched(rom: Rom, name: str) -> Array:
    """Surface triangles (any, 3) of a contact mode: those that obstacles can touch, else those near its point.

    None of a patch that the scene names by a group of the mesh, which a ROM does not hold.
    """
    points = rom.contact_models[name].contact_points
    if len(points):
        return rom.triangles[np.isin(rom.triangles, points).all(axis=1)]
    try:
        patch = parse_scene(rom.scene_text, tables=rom.tables, source=f"scene of ROM {rom.name!r}").contacts.get(name)
    except FenicsRomError:  # it is of matrices, or of another release
        return rom.triangles[:0]
    if patch is None or patch.near is None:
        return rom.triangles[:0]
    centroids = rom.nodes[rom.triangles].mean(axis=1)
    return rom.triangles[np.linalg.norm(centroids - patch.near.point, axis=1) <= patch.near.radius]
