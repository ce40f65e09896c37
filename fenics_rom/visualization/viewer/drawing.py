"""Bodies, obstacles and pulls in viser's scene, in units of the body's size.

viser's camera and lights are made for scenes of about one metre.
"""

from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.obstacles import Box, HalfSpace, Mesh, Obstacle
from fenics_rom.visualization.contact_fields import traction_arrows
from fenics_rom.visualization.obstacle_meshes import obstacle_mesh
from fenics_rom.visualization.tendon_routing import TendonRouting
from fenics_rom.visualization.viewer.coloured_body import HIGHLIGHT_COLOUR, ORIGIN, ColouredBody, NextPicture
from fenics_rom.visualization.viewer.surface import Surface

FRAMES_PER_SECOND = 60.0
TENDON_COLOUR, TENDON_THICKNESS = (213, 94, 0), 0.012
SEE_THROUGH = 0.6  # opacity of a body that tendons are inside of
SEEN_THROUGH = 0.25  # opacity of obstacles while contact pressure is shown
OBSTACLE_COLOUR = (150, 150, 160)
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
        next_picture: what waits for the body to be shown.
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
        next_picture: NextPicture,
        scale: float,
        offset: Array = ORIGIN,
    ):
        self._surface, self._next_picture, self._scale, self._offset = surface, next_picture, scale, offset
        opacity = SEE_THROUGH if tendons else None
        self._body = ColouredBody(scene, name, surface, next_picture, scale, offset, opacity)
        self._routings = [TendonRouting(nodes, points) for points in tendons.values()]
        options: dict[str, Any] = {"thickness": TENDON_THICKNESS, "position": tuple(scale * offset)}
        self._tendons = [
            scene.add_line_segments(f"{name}/tendons/{k}", self._segments(points), TENDON_COLOUR, **options)
            for k, points in enumerate(tendons.values())
        ]
        self._obstacles = {
            k: _add_obstacle(scene, f"{name}/obstacles/{k}", obstacle, scale) for k, obstacle in obstacles.items()
        }
        self._covers = Covers(self._obstacles.values())
        self._arrows = TractionArrows(scene, f"{name}/tractions", scale, offset)

    def draw(
        self,
        displacement: Array,
        values: Array,
        largest: float,
        motion: Mapping[str, Array],
        highlighted: Array | None = None,
        traction: Array | None = None,
    ) -> bool:
        """Draws the body as displaced, (N, 3), m, as `ColouredBody` does, and obstacles that have moved.

        `motion`: displacements (3,), m, or poses (7,), as of a Trajectory. `traction`: of contact at all nodes, (N, 3),
        Pa, where values are its pressure: it is shown by arrows, and obstacles are seen through.

        Gives whether the body is drawn anew.
        """
        self._covers.see_through(traction is not None)
        moved = self._surface.places + displacement[self._surface.nodes]
        is_new = self._body.draw(moved, values, largest, highlighted)
        if is_new:
            self._next_picture.add(partial(self._move_tendons, displacement))
        if traction is None:
            self._arrows.hide()
        elif is_new:
            nodes = self._surface.nodes
            self._next_picture.add(partial(self._arrows.draw, moved, traction[nodes], largest))
        for name, mesh in self._obstacles.items():
            shift, *turn = np.split(motion[name], [3]) if len(motion[name]) > 3 else (motion[name],)
            self._next_picture.place(mesh, self._scale * (self._offset + shift), *turn)
        return is_new

    def _move_tendons(self, displacement: Array) -> None:
        for routing, lines in zip(self._routings, self._tendons, strict=True):
            lines.points = self._segments(routing.moved(displacement))

    def _segments(self, points: Array) -> Array:
        places = (self._scale * points).astype(np.float32)
        return np.stack([places[:-1], places[1:]], axis=1)


def _add_obstacle(scene: Any, name: str, obstacle: Obstacle, scale: float) -> Any:
    """Its mesh, whose pose is how it has moved; the scale is that of a body of 1."""
    floor_centre = np.array(obstacle.point if isinstance(obstacle, HalfSpace) else ORIGIN)
    vertices, faces = obstacle_mesh(obstacle, floor_centre, FLOOR_SIZES / scale / 2)
    return scene.add_mesh_simple(
        name,
        scale * vertices,
        faces,
        color=OBSTACLE_COLOUR,
        opacity=0.6 if isinstance(obstacle, HalfSpace) else None,
        side="double",
        flat_shading=isinstance(obstacle, Box | Mesh),
        cast_shadow=False,
        receive_shadow=False,
    )


class Covers:
    """Meshes that can hide where a body is touched."""

    def __init__(self, meshes: Iterable[Any]):
        self._opacities = [(mesh, mesh.opacity) for mesh in meshes]
        self._are_seen_through = False

    def see_through(self, wanted: bool) -> None:
        """Has them seen through, or as they were."""
        if wanted != self._are_seen_through:
            self._are_seen_through = wanted
            for mesh, opacity in self._opacities:
                mesh.opacity = SEEN_THROUGH if wanted else opacity


class TractionArrows:
    """Arrows of what touches a body, which end where it does; an `offset` (3,), m, is added to places."""

    def __init__(self, scene: Any, name: str, scale: float, offset: Array):
        self._scale, self._offset = scale, offset
        shape = {"shaft_radius": 0.003, "head_radius": 0.008, "head_length": 0.018}
        self._arrows = scene.add_arrows(name, np.zeros((1, 2, 3)), HIGHLIGHT_COLOUR, **shape, visible=False)

    def draw(self, places: Array, traction: Array, largest: float) -> None:
        """Draws them at places (n, 3), m, of tractions (n, 3), Pa; see `traction_arrows`."""
        arrows = traction_arrows(self._offset + places, traction, largest, 1 / self._scale)
        self._arrows.visible = bool(len(arrows))
        if len(arrows):
            self._arrows.points = (self._scale * arrows).astype(np.float32)

    def hide(self) -> None:
        """Takes them away."""
        if self._arrows.visible:
            self._arrows.visible = False


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
