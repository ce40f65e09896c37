"""Pictures of a soft body, of what it is to reach, and of what is in its way; there need not be a screen."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fenics_rom import Rom
from fenics_rom.visualization.optional_dependencies import check_window, pyvista_package

Array = np.ndarray


class Ball(NamedTuple):
    """In m, as all that follows."""

    centre: Array
    radius: float

    def surface(self):
        """For PyVista."""
        return pyvista_package().Sphere(radius=self.radius, center=self.centre)


class Rod(NamedTuple):
    """A cylinder between two points."""

    start: Array
    end: Array
    radius: float

    def surface(self):
        """For PyVista."""
        way = self.end - self.start
        centre, length = (self.start + self.end) / 2, float(np.linalg.norm(way))
        return pyvista_package().Cylinder(center=centre, direction=way, radius=self.radius, height=length)


class Block(NamedTuple):
    """Its edges are along the axes."""

    centre: Array
    size: Array

    def surface(self):
        """For PyVista."""
        low, high = self.centre - self.size / 2, self.centre + self.size / 2
        return pyvista_package().Box(bounds=np.column_stack([low, high]).ravel())


Thing = Ball | Rod | Block


def picture(
    rom: Rom,
    displacement: Array,
    targets: Sequence[Thing],
    obstacles: Sequence[Thing],
    size: tuple[int, int] = (320, 240),
) -> Array:
    """An image (height, width, 3) of a body whose nodes moved by (nodes, 3), m, from its left; targets are red.

    Raises:
        MissingPackageError: there is no PyVista, or nothing that it can draw with.
    """
    pv = pyvista_package()
    check_window()
    plotter = pv.Plotter(off_screen=True, window_size=size)
    faces = np.insert(rom.triangles, 0, 3, axis=1).ravel()
    body = pv.PolyData(rom.nodes + displacement, faces)
    plotter.add_mesh(body, color="lightsteelblue", show_edges=True, edge_color="slategray", line_width=0.5, ambient=0.4)
    for things, colour, opacity in ((targets, "crimson", 1.0), (obstacles, "tan", 0.5)):
        for thing in things:
            plotter.add_mesh(thing.surface(), color=colour, opacity=opacity, ambient=0.4)
    span = float(np.ptp(rom.nodes[:, 0]))
    plotter.camera.position = np.array([1.6, -1.5, 0.9]) * span
    plotter.camera.focal_point = np.array([0.5, 0.0, 0.0]) * span
    plotter.camera.up = 0, 0, 1
    image = plotter.screenshot(return_img=True)
    plotter.close()
    return np.asarray(image)[..., :3]
