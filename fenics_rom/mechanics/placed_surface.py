"""The surface of a soft body among others, as it is, and points of another one that are near to it."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.body_faces import BodyFaces
from fenics_rom.mechanics.smooth_surface import Bent, bends_of, corner_normals, unit_normals
from fenics_rom.mechanics.surface_pairs import DEEPEST, Boxes, OnSurface, near_boxes, nearest_of


class PlacedSurface(NamedTuple):
    """The surface of a soft body as it is."""

    points: Array  # (n, 3) in world axes, m
    triangles: Array  # (t, 3) rows of points, counterclockwise from outside
    touching: Array  # rows of the points that may touch
    bends: Array | None = None  # (t, 9) of `bends_of`, by how it is at rest; None: it is as flat as its triangles
    faces: BodyFaces | None = None  # of a body whose faces others meet, and not its points alone


def surface_at_rest(points: Array, triangles: Array) -> PlacedSurface:
    """That of a body whose points (n, 3), m, may all touch, smooth but for its creases."""
    return PlacedSurface(points, triangles, np.arange(len(points)), bends_of(points, triangles))


def points_near(first: PlacedSurface, second: PlacedSurface, margin: float) -> OnSurface:
    """Those points of the first that may touch, and are nearer than a margin, m, to the second."""
    corners = second.points[second.triangles.T]
    boxes = Boxes.about(corners)
    reach = margin + DEEPEST * boxes.size
    row, triangle = near_boxes(first.points[first.touching], boxes.wider(reach))
    row = first.touching[row]
    near = corners[:, triangle].transpose(1, 0, 2)
    normals, bent = unit_normals(near), None
    if second.bends is not None and len(row):
        bent = Bent(second.bends[triangle], corner_normals(corners.transpose(1, 0, 2), second.bends[:, :3]))
    return nearest_of(first.points, row, second.triangles[triangle], near, normals, boxes.size, margin, reach, bent)
