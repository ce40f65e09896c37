"""Pictures of a soft body among balls and rods, drawn by VTK where there need not be a screen."""

import numpy as np
import pyvista as pv

from fenics_rom import Rom

Array = np.ndarray


def picture(
    rom: Rom,
    displacement: Array,
    balls: list[tuple[Array, float]],
    rods: list[tuple[Array, Array, float]],
    size: tuple[int, int] = (320, 240),
) -> Array:
    """An image (height, width, 3) of a body whose nodes moved by (nodes, 3), m."""
    plotter = pv.Plotter(off_screen=True, window_size=size)
    faces = np.insert(rom.triangles, 0, 3, axis=1).ravel()
    plotter.add_mesh(pv.PolyData(rom.nodes + displacement, faces), color="lightsteelblue", show_edges=True)
    for centre, radius in balls:
        plotter.add_mesh(pv.Sphere(radius=radius, center=centre), color="crimson")
    for start, end, radius in rods:
        tube = pv.Cylinder(
            center=(start + end) / 2, direction=end - start, radius=radius, height=float(np.linalg.norm(end - start))
        )
        plotter.add_mesh(tube, color="tan")
    span = float(np.ptp(rom.nodes[:, 0]))
    plotter.camera.position = np.array([1.6, -1.5, 0.9]) * span
    plotter.camera.focal_point = np.array([0.5, 0.0, 0.0]) * span
    plotter.camera.up = 0, 0, 1
    image = plotter.screenshot(return_img=True)
    plotter.close()
    return np.asarray(image)[..., :3]
