"""The surface of a soft body among others, as it is, and points of another one that are near to it."""

from typing import NamedTuple

from numpy import ndarray as Array

from fenics_rom.mechanics.body_faces import BodyFaces
from fenics_rom.mechanics.rounded_surface import Rounding, rounded
from fenics_rom.mechanics.surface_pairs import DEEPEST, Boxes, OnSurface, near_boxes, nearest_of, unit_normals


class PlacedSurface(NamedTuple):
    """The surface of a soft body as it is."""

    points: Array  # (n, 3) in world axes, m
    triangles: Array  # (t, 3) rows of points, counterclockwise from outside
    touching: Array  # rows of the points that may touch
    faces: BodyFaces | None = None  # of a body whose faces others meet, and not its points alone
    rounding: Rounding | None = None  # of its edges; None: others meet it as it is


def points_near(first: PlacedSurface, second: PlacedSurface, margin: float) -> OnSurface:
    """Those points of the first that may touch, and are nearer than a margin, m, to the second."""
    corners = second.points[second.triangles.T]
    boxes = Boxes.about(corners)
    reach = margin + DEEPEST * boxes.size
    row, triangle = near_boxes(first.points[first.touching], boxes.wider(reach))
    row = first.touching[row]
    near = corners[:, triangle].transpose(1, 0, 2)
    normals = unit_normals(near)
    sizes = boxes.size, margin, reach
    if second.rounding is None:
        return nearest_of(first.points, row, second.triangles[triangle], near, normals, *sizes)
    found = nearest_of(first.points, row, triangle[:, None], near, normals, *sizes)
    return rounded(second.rounding, first.points[found.row], second.points, second.triangles, margin, found)
