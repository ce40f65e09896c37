"""A picture of what the places of a scene pick: a panel for each, the body seen through."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import FileError
from fenics_rom.visualization.exports.body_renderer import CAMERA_DIRECTION, CAMERA_UP, LIGHT, SHARP_EDGE_DEGREES
from fenics_rom.visualization.exports.pictures import write_still
from fenics_rom.visualization.optional_dependencies import check_window, pyvista_package

PANEL_WIDTH, WORDS_HEIGHT = 480, 60  # pixels
MOST_COLUMNS = 4
PICKED_COLOUR = "#d55e00"
BODY_OPACITY = 0.15
POINT_PIXELS = 9
MIN_ASPECT, MAX_ASPECT = 0.2, 1.0  # height of what is seen, of its width
CAMERA_DISTANCE = 5.0  # of the body's diagonal
ROOM = 1.06  # width and height of a panel below its words, of what is to be seen


class ShownPlace(Protocol):
    """What a picture asks a place for: see fem.named_places.PickedPlace."""

    @property
    def name(self) -> str: ...  # noqa: D102
    @property
    def kind(self) -> str: ...  # noqa: D102
    @property
    def count(self) -> int: ...  # noqa: D102
    @property
    def nodes(self) -> Array: ...  # noqa: D102
    @property
    def triangles(self) -> Array: ...  # noqa: D102


def check_picture(file: Path) -> None:
    """Checks, before long work, that a picture can be drawn.

    Raises:
        FileError: another ending than .png.
        MissingPackageError: there is no PyVista, or nothing that it can draw with.
    """
    if file.suffix != ".png":
        raise FileError(f"{file}: a picture of places becomes a file that ends in .png")
    pyvista_package()
    check_window()


def draw_places(file: Path, coordinates: Array, surface: Array, places: Sequence[ShownPlace]) -> None:
    """Writes a .png file with a panel for each place.

    Args:
        file: to write.
        coordinates: (N, 3), m, of all nodes.
        surface: (F, 3) triangles of the body.
        places: nodes are drawn as dots, triangles and cells as surfaces.
    """
    pv = pyvista_package()
    toward = CAMERA_DIRECTION / np.linalg.norm(CAMERA_DIRECTION)
    right = np.cross(CAMERA_UP, toward) / np.linalg.norm(np.cross(CAMERA_UP, toward))
    axes = np.array([right, np.cross(toward, right), toward])
    seen = coordinates[np.unique(surface)] @ axes.T
    middle, (wide, tall, deep) = (seen.min(axis=0) + seen.max(axis=0)) / 2, ROOM * np.ptp(seen, axis=0)
    drawn = PANEL_WIDTH * min(max(tall / wide, MIN_ASPECT), MAX_ASPECT)  # pixels, the height without words
    height = round(drawn) + WORDS_HEIGHT
    middle[1] += max(tall, wide * drawn / PANEL_WIDTH) * WORDS_HEIGHT / drawn / 2

    columns = min(MOST_COLUMNS, math.ceil(math.sqrt(len(places))))
    rows = math.ceil(len(places) / columns)
    plotter = pv.Plotter(
        off_screen=True, shape=(rows, columns), window_size=(columns * PANEL_WIDTH, rows * height), border=False
    )
    body = pv.PolyData.from_regular_faces(coordinates, surface)
    edges = body.extract_feature_edges(SHARP_EDGE_DEGREES, manifold_edges=False)
    for k, place in enumerate(places):
        plotter.subplot(*divmod(k, columns))
        plotter.set_background(LIGHT.paper)
        plotter.add_mesh(body, color=LIGHT.obstacle, opacity=BODY_OPACITY)
        if edges.n_points:
            plotter.add_mesh(edges, color=LIGHT.ghost, line_width=1)
        if len(place.triangles):
            picked = pv.PolyData.from_regular_faces(coordinates, place.triangles)
            plotter.add_mesh(picked, color=PICKED_COLOUR, show_edges=True, edge_color=LIGHT.ink, line_width=0.5)
        else:
            plotter.add_points(
                coordinates[place.nodes], color=PICKED_COLOUR, point_size=POINT_PIXELS, render_points_as_spheres=True
            )
        words = f"{place.name}\n{place.count} {place.kind}"
        plotter.add_text(
            words, font_size=9, color=LIGHT.ink, position=(0.02, 1 - 0.8 * WORDS_HEIGHT / height), viewport=True
        )
        camera = plotter.camera
        camera.focal_point, camera.up = middle @ axes, CAMERA_UP
        camera.position = middle @ axes + CAMERA_DISTANCE * max(wide, tall, deep) * toward
        camera.parallel_projection = True
        camera.parallel_scale = max(tall, wide * drawn / PANEL_WIDTH) * height / drawn / 2
    picture = np.array(plotter.screenshot(None, return_img=True))
    plotter.close()
    write_still(file, picture)
