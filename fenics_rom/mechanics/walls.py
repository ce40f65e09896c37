"""How thick the walls of a body are behind its surface."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.surface_pairs import unit_normals

MOST_RAYS = 500  # that look how thick walls are
NOTHING_BEHIND = 1e-6  # of the largest wall asked for: so near a ray meets where it begins


def thinnest_wall(faces: Array, surface: Array, most: float) -> float:
    """The thinnest wall behind faces (k, 3 corners, 3), m, of a body with this surface (n, 3, 3), m: some rays say so.

    Not more than `most`, m.
    """
    if not len(faces):
        return most
    some, wall = np.unique(np.linspace(0, len(faces) - 1, MOST_RAYS).astype(int)), most
    a, b, c = np.moveaxis(surface, 1, 0)
    for start, n in zip(faces[some].mean(axis=1), -unit_normals(faces[some]), strict=True):
        # start + t n = a + v (b - a) + w (c - a)
        p = np.cross(n, c - a)
        det = np.einsum("ij,ij->i", b - a, p)
        with np.errstate(divide="ignore", invalid="ignore"):
            s = start - a
            v, q = np.einsum("ij,ij->i", s, p) / det, np.cross(s, b - a)
            w, t = q.dot(n) / det, np.einsum("ij,ij->i", c - a, q) / det
            hit = (v >= 0) & (w >= 0) & (v + w <= 1) & (t > wall * NOTHING_BEHIND)
        wall = min(wall, float(t[hit].min(initial=np.inf)))
    return wall
