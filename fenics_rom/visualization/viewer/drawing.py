"""Bodies, obstacles and pulls in viser's scene.

A mesh of viser has one colour (1.1), so a body is drawn as one mesh for each band of the colour scale, cut along the
lines where bands meet (`contours.py`): a contour plot. Everything is drawn in units of the body's size, as viser's
camera and lights are made for scenes of about one metre.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.obstacles import Box, HalfSpace, Obstacle
from fenics_rom.visualization.obstacle_meshes import obstacle_mesh
from fenics_rom.visualization.tendon_routing import TendonRouting
from fenics_rom.visualization.viewer.colours import BANDS, band_colours, levels_of
from fenics_rom.visualization.viewer.contours import Contours
from fenics_rom.visualization.viewer.surface import Surface

ORIGIN = np.zeros(3)
FRAMES_PER_SECOND = 30.0
TENDON_COLOUR, TENDON_THICKNESS = (213, 94, 0), 0.012
SEE_THROUGH = 0.6  # opacity of a body that tendons are inside of
HIGHLIGHT_COLOUR = (255, 120, 30)
OBSTACLE_COLOUR = (150, 150, 160)
SPARE_ROOM = 1.5  # room in a band's mesh, so that it rarely has to be made anew
PART_OF_A_PIXEL, PART_OF_A_BAND = 1e-4, 0.02  # of the body's size, and of a colour: changes that nobody sees
NOTHING = np.zeros((3, 3)), np.zeros((1, 3), dtype=np.uint32)
PICK_OFFSET = 1e-3  # of the body, by which a contact surface is met before the body itself
FLOOR_SIZES = 3.0  # side of the square that stands for a half-space, in sizes of the body


def set_camera_and_light(server: Any, places: Array) -> None:
    """Camera and light for a body at these places, in units of what is drawn.

    Neither shadows nor reflections: without a GPU they cost more than all of the rest.
    """
    server.scene.configure_default_lights(cast_shadow=False)
    server.scene.configure_environment_map(hdri=None)
    server.scene.add_light_hemisphere("/light", sky_color=(255, 255, 255), ground_color=(230, 230, 230), intensity=4.0)
    middle, size = (places.min(axis=0) + places.max(axis=0)) / 2, np.linalg.norm(np.ptp(places, axis=0))
    server.initial_camera.look_at = tuple(middle)
    server.initial_camera.position = tuple(middle + size * np.array([0.35, -0.8, 0.5]))


class BandedBody:
    """A body that changes its shape and its colours, on viser's scene; `scale` in 1/m, `offset` (3,) in m."""

    def __init__(
        self,
        scene: Any,
        name: str,
        surface: Surface,
        scale: float,
        offset: Array = ORIGIN,
        opacity: float | None = None,
    ):
        self._surface, self._scale = surface, scale
        self._contours = Contours(surface.faces, BANDS)
        position = tuple(scale * offset)
        options: dict[str, Any] = {"cast_shadow": False, "receive_shadow": False, "side": "double", "opacity": opacity}
        self._bands = [
            _Band(scene.add_mesh_simple(f"{name}/{k}", *NOTHING, color=colour, position=position, **options))
            for k, colour in enumerate([*band_colours(), HIGHLIGHT_COLOUR])
        ]
        self._drawn: tuple[Array, Array, Array | None] | None = None

    def draw(self, moved: Array, values: Array, largest: float, highlighted: Array | None = None) -> None:
        """Draws the moved nodes (n, 3), m, unless nobody could see a difference from the last picture.

        The values at all vertices are not negative, the `largest` has the brightest colour, and the triangles that are
        `highlighted` another one.
        """
        levels, places = levels_of(values, largest), self._scale * moved
        if self._drawn is not None and _look_alike(self._drawn, (places, levels, highlighted)):
            return
        self._drawn = places, levels, highlighted
        bands = self._contours.cut(levels, highlighted)
        corners = bands.places(places[self._surface.node_of]).astype(np.float32)
        for band, part in zip(self._bands, bands.parts(corners), strict=True):
            band.draw(*part)


class _Band:
    """The mesh of one colour. It has spare corners, and faces without area, so that buffers are rarely made anew."""

    def __init__(self, mesh: Any):
        hide_what_is_behind(mesh)
        self._mesh = mesh
        self._corners, self._faces = len(mesh.vertices), len(mesh.faces)

    def draw(self, corners: Array, faces: Array) -> None:
        """Draws faces (t, 3) into corners (p, 3); none are drawn as faces without area."""
        if not len(faces) and not self._mesh.faces.any():
            return
        self._corners, self._faces = _room(self._corners, len(corners)), _room(self._faces, len(faces))
        padded_faces = np.zeros((self._faces, 3), dtype=np.uint32)
        padded_faces[: len(faces)] = faces
        padded = np.empty((self._corners, 3), dtype=np.float32)
        padded[: len(corners)] = corners
        padded[len(corners) :] = corners[0] if len(corners) else 0.0
        # Faces never name a corner that is not there yet, or not any more.
        if len(padded) < len(self._mesh.vertices):
            self._mesh.faces = padded_faces
            self._mesh.vertices = padded
        else:
            self._mesh.vertices = padded
            self._mesh.faces = padded_faces


def _room(room: int, count: int) -> int:
    """Of a buffer that holds so many, with room in it before and now."""
    return room if room / 4 - 3 < count <= room else round(SPARE_ROOM * count) + 3


def _look_alike(before: tuple[Array, Array, Array | None], now: tuple[Array, Array, Array | None]) -> bool:
    """Whether two pictures, of places, levels and highlighted triangles, are the same but for part of a pixel."""
    (places, levels, highlighted), (places_now, levels_now, highlighted_now) = before, now
    return (
        highlighted is highlighted_now
        and np.abs(places_now - places).max() < PART_OF_A_PIXEL
        and np.abs(levels_now - levels).max() < PART_OF_A_BAND
    )


def hide_what_is_behind(mesh: Any) -> None:
    """Keeps the mouse from meeting what is behind a mesh, by a gesture that nobody makes."""
    mesh.on_drag("middle", modifier="cmd/ctrl+alt+shift")(_nothing)


async def _nothing(_: Any) -> None:
    pass


class PickSurface:
    """A contact surface that the mouse can meet: an invisible mesh just above it, which viser outlines under the mouse.

    Of the surface it has the triangles that are `selected` (F_i,); `triangles` (F_i, 3) are their nodes.
    """

    def __init__(self, scene: Any, name: str, surface: Surface, selected: Array, scale: float):
        self._scale, self.triangles = scale, surface.triangles[selected]
        self._nodes, corners = np.unique(self.triangles, return_inverse=True)
        self._corners = corners.reshape(-1, 3)
        self.mesh = scene.add_mesh_simple(
            name, self._raised(surface.places), self._corners, opacity=0.0, cast_shadow=False, receive_shadow=False
        )

    def draw(self, moved: Array) -> None:
        """Follows the moved nodes of the surface, (n, 3), m."""
        self.mesh.vertices = self._raised(moved)

    def _raised(self, moved: Array) -> Array:
        places = self._scale * moved[self._nodes]
        a, b, c = places[self._corners].swapaxes(0, 1)
        of_triangles = np.repeat(np.cross(b - a, c - a), 3, axis=0).T
        normals = np.column_stack(
            [np.bincount(self._corners.ravel(), component, len(places)) for component in of_triangles]
        )
        return places + PICK_OFFSET * normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)


class DrawnBody:
    """A body and the tendons in it among its obstacles, all at an offset (3,), m.

    Args:
        scene: viser's.
        name: of what is added to it.
        nodes: (N, 3) of the whole body at rest, m.
        surface: of it.
        tendons: points (K, 3) at rest that each leads through, m; a body with some can be seen through.
        obstacles: by name.
        scale: 1/m, of what is drawn.
        offset: where it is drawn.
    """

    def __init__(
        self,
        scene: Any,
        name: str,
        nodes: Array,
        surface: Surface,
        tendons: Mapping[str, Array],
        obstacles: Mapping[str, Obstacle],
        scale: float,
        offset: Array = ORIGIN,
    ):
        self._surface, self._scale, self._offset = surface, scale, offset
        self._body = BandedBody(scene, name, surface, scale, offset, SEE_THROUGH if tendons else None)
        self._routings = [TendonRouting(nodes, points) for points in tendons.values()]
        options: dict[str, Any] = {"thickness": TENDON_THICKNESS, "position": tuple(scale * offset)}
        self._tendons = [
            scene.add_line_segments(f"{name}/tendons/{k}", self._segments(points), TENDON_COLOUR, **options)
            for k, points in enumerate(tendons.values())
        ]
        self._obstacles = {
            k: _add_obstacle(scene, f"{name}/obstacles/{k}", obstacle, scale) for k, obstacle in obstacles.items()
        }

    def draw(
        self,
        displacement: Array,
        values: Array,
        largest: float,
        motion: Mapping[str, Array],
        highlighted: Array | None = None,
    ) -> None:
        """Draws the body as displaced, (N, 3), m, as `BandedBody` does, and obstacles that have moved, (3,), m."""
        moved = self._surface.places + displacement[self._surface.nodes]
        self._body.draw(moved, values, largest, highlighted)
        for routing, lines in zip(self._routings, self._tendons, strict=True):
            lines.points = self._segments(routing.moved(displacement))
        for name, mesh in self._obstacles.items():
            mesh.position = tuple(self._scale * (self._offset + motion[name]))

    def _segments(self, points: Array) -> Array:
        places = (self._scale * points).astype(np.float32)
        return np.stack([places[:-1], places[1:]], axis=1)


def _add_obstacle(scene: Any, name: str, obstacle: Obstacle, scale: float) -> Any:
    """Its mesh, whose position is how far it has moved; the scale is that of a body of 1."""
    floor_centre = np.array(obstacle.point if isinstance(obstacle, HalfSpace) else ORIGIN)
    vertices, faces = obstacle_mesh(obstacle, floor_centre, FLOOR_SIZES / scale / 2)
    return scene.add_mesh_simple(
        name,
        scale * vertices,
        faces,
        color=OBSTACLE_COLOUR,
        opacity=0.6 if isinstance(obstacle, HalfSpace) else None,
        side="double",
        flat_shading=isinstance(obstacle, Box),
        cast_shadow=False,
        receive_shadow=False,
    )


class ForceArrow:
    """The arrow of a force, from the node to where the mouse is, and its size."""

    def __init__(self, scene: Any, scale: float):
        self._scale = scale
        self._arrow = scene.add_arrows(
            "/pull",
            np.zeros((1, 2, 3)),
            HIGHLIGHT_COLOUR,
            shaft_radius=0.006,
            head_radius=0.016,
            head_length=0.04,
            visible=False,
        )
        self._label = scene.add_label("/pull_label", "", visible=False)

    def draw(self, start: Array, end: Array, text: str) -> None:
        """Draws it from one point to another, (3,), m."""
        self._arrow.points = self._scale * np.array([[start, end]])
        self._label.position = tuple(self._scale * end)
        self._label.text = text
        self._arrow.visible = self._label.visible = True

    def hide(self) -> None:
        """Takes it away."""
        self._arrow.visible = self._label.visible = False
