"""Bodies and obstacles before a camera, drawn off-screen by VTK."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from fenics_rom.io.units import prefixed
from fenics_rom.mechanics.obstacles import Box, Capsule, HalfSpace, Obstacle, Sphere
from fenics_rom.visualization.optional_dependencies import check_window, pyvista_package

Array = np.ndarray

FROM = np.array([0.42, -0.78, 0.46])  # where the camera stands: in front of the body, a little to the right and above
UP = np.array([0.0, 0.0, 1.0])
MARGIN = 1.06
SHARP = 35.0  # degrees; where the surface turns by more, its edge is drawn
LIGHTS = (((0.0, 0.0, 1.0), 0.7), ((-0.6, 0.9, 0.8), 0.45))  # from the camera, and from above its left; strengths
WORDS = (0.015, 0.94)  # where they begin, of width and height
ROOM, ROOM_BELOW = 0.25, 0.02  # for words above and below, of the height, and how much more of it below
FAR = 5.0  # how far the camera stands, of what it sees
FLATTEST, TALLEST = 0.2, 1.0  # height of a picture, of its width
BAR = 64  # height of the colour bar with its words, pixels
SHINE: dict[str, Any] = {
    "smooth_shading": True,
    "split_sharp_edges": True,
    "feature_angle": SHARP,
    "ambient": 0.4,
    "diffuse": 0.8,
    "specular": 0.15,
    "specular_power": 20,
}
FLOOR = 0.6  # half the edge of what is shown of a half-space, of the diagonal of all that is to be seen


@dataclass(frozen=True)
class Look:
    """Colours of a picture, for light or dark surroundings."""

    paper: str
    ink: str
    ghost: str
    obstacle: str


MARK = "#e41a1c"  # outline of where a contact mode is touched
LIGHT = Look("white", "#1a1a1a", "#9a9a9a", "#c9ccd1")
DARK = Look("#14171c", "#ececec", "#6d7480", "#5b626d")


class Stage:
    """A window without a screen, with a camera that sees all that will be shown.

    Args:
        nodes: (N, 3), m.
        triangles: (F, 3).
        shapes: displacements that will be shown, (N, 3) each, m.
        scale: by which displacements are multiplied before they are drawn; colours show them as they are.
        obstacles: by name, in the same frame.
        offsets: how far the obstacles will be from there, (any, O, 3), m.
        width: of a picture, pixels.
        dark: light on dark instead of dark on light.
        captions: whether there is to be room for words and a colour bar.
        below: whether the camera looks from below.

    Attributes:
        height: of a picture, pixels.

    Raises:
        MissingPackageError: there is no PyVista, or nothing that it can draw with.
    """

    def __init__(
        self,
        nodes: Array,
        triangles: Array,
        shapes: Sequence[Array],
        *,
        scale: float = 1.0,
        obstacles: Mapping[str, Obstacle] | None = None,
        offsets: Array | None = None,
        width: int = 1000,
        dark: bool = False,
        captions: bool = True,
        below: bool = False,
    ):
        self._pv = pyvista_package()
        check_window()
        self._nodes, self._scale, self._look, self._captions = nodes, scale, DARK if dark else LIGHT, captions
        self._largest = max((float(np.linalg.norm(shape, axis=1).max()) for shape in shapes), default=0.0)
        self._factor, self._unit = prefixed("m", self._largest)
        self._faces = np.column_stack([np.full(len(triangles), 3), triangles]).ravel()
        used = np.unique(triangles)
        seen = [nodes[used], *(nodes[used] + scale * shape[used] for shape in shapes)]
        ends = np.concatenate([_corners(points) for points in seen])
        middle, diagonal = ends.mean(axis=0), float(np.linalg.norm(np.ptp(ends, axis=0)))
        self._obstacles = {
            name: _solid(self._pv, one, middle, FLOOR * diagonal) for name, one in (obstacles or {}).items()
        }
        moved = np.zeros((1, len(self._obstacles), 3)) if offsets is None else offsets
        for k, (one, solid) in enumerate(zip((obstacles or {}).values(), self._obstacles.values(), strict=True)):
            if not isinstance(one, HalfSpace):  # a floor goes on beyond the picture
                seen += [np.asarray(solid.points) + offset for offset in np.unique(moved[:, k], axis=0)]
        self._plotter = self._opened(seen, width, FROM * [1.0, 1.0, -1.0] if below else FROM)
        self.height = int(self._plotter.window_size[1])

    def picture(self, displacement: Array, offsets: Array | None = None, words: str = "") -> Array:
        """One picture (height, width, 3), bytes.

        Args:
            displacement: (N, 3), m; colours show its length, the brightest that of the largest shape.
            offsets: of the obstacles, (O, 3), m.
            words: to be written into its corner.
        """
        pv, plotter = self._pv, self._plotter
        body = pv.PolyData(self._nodes + self._scale * displacement, self._faces)
        body["length"] = self._factor * np.linalg.norm(displacement, axis=1)
        self._draw(body)
        for k, (name, solid) in enumerate(self._obstacles.items()):
            moved = solid.translate([0.0, 0.0, 0.0] if offsets is None else offsets[k])
            plotter.add_mesh(
                moved, name=f"obstacle {name}", color=self._look.obstacle, culling="back", render=False, **SHINE
            )
        if words:
            plotter.add_text(
                words, name="words", font_size=12, color=self._look.ink, position=WORDS, viewport=True, render=False
            )
        plotter.render()
        return np.array(plotter.screenshot(None, return_img=True))

    def mark(self, triangles: Array, displacement: Array) -> None:
        """Paints some of the surface of the next picture, (any, 3) triangles: where a contact mode is touched."""
        faces = np.column_stack([np.full(len(triangles), 3), triangles]).ravel()
        patch = self._pv.PolyData(self._nodes + self._scale * displacement, faces) if len(triangles) else None
        self._plotter.remove_actor("mark", render=False)
        if patch is not None:
            edges = patch.extract_feature_edges(feature_edges=False, manifold_edges=False, boundary_edges=True)
            self._plotter.add_mesh(edges, name="mark", color=MARK, line_width=4, lighting=False, render=False)

    def close(self) -> None:
        """Gives the window back."""
        self._plotter.close()

    def _opened(self, seen: list[Array], width: int, place: Array) -> Any:
        """The window, as high as what is to be seen, with its camera and the body at rest as a ghost."""
        toward = place / np.linalg.norm(place)
        right = np.cross(UP, toward) / np.linalg.norm(np.cross(UP, toward))
        axes = np.array([right, np.cross(toward, right), toward])
        low = np.min([(points @ axes.T).min(axis=0) for points in seen], axis=0)
        high = np.max([(points @ axes.T).max(axis=0) for points in seen], axis=0)
        middle, (wide, tall, deep) = (low + high) / 2, MARGIN * (high - low)
        if self._captions:
            tall *= 1 + ROOM
            middle[1] -= ROOM_BELOW * tall
        ratio = min(max(tall / wide, FLATTEST), TALLEST)
        height = 2 * round(width * ratio / 2)  # encoders want even numbers
        plotter = self._pv.Plotter(off_screen=True, window_size=(width, height), lighting="none")
        plotter.set_background(self._look.paper)
        for light, strength in LIGHTS:
            plotter.add_light(self._pv.Light(position=light, intensity=strength, light_type="camera light"))
        camera, focus = plotter.camera, middle @ axes
        camera.focal_point, camera.position, camera.up = focus, focus + FAR * max(wide, tall, deep) * toward, UP
        camera.parallel_projection, camera.parallel_scale = True, max(tall, wide * ratio) / 2
        plotter.enable_anti_aliasing("msaa", multi_samples=8)
        return plotter

    def _draw(self, body: Any) -> None:
        pv, plotter, look = self._pv, self._plotter, self._look
        plotter.add_mesh(
            body,
            name="body",
            scalars="length",
            cmap="viridis",
            clim=(0.0, self._factor * self._largest or 1.0),
            show_scalar_bar=False,
            render=False,
            **SHINE,
        )
        for name, surface, colour, wide in (
            ("ghost", pv.PolyData(self._nodes, self._faces), look.ghost, 1.0),
            ("edges", body, look.ink, 1.6),
        ):
            edges = surface.extract_feature_edges(SHARP, manifold_edges=False)
            if edges.n_points:
                plotter.add_mesh(edges, name=name, color=colour, line_width=wide, render=False)
        title = f"displacement ({self._unit})"
        if self._captions and title not in plotter.scalar_bars:
            height = BAR / plotter.window_size[1]
            plotter.add_scalar_bar(
                title,
                mapper=plotter.actors["body"].mapper,
                color=look.ink,
                n_labels=2,  # as the title is above the middle
                fmt="%.3g",
                width=0.4,
                height=height,
                position_x=0.3,
                position_y=height / 8,
                title_font_size=18,
                label_font_size=16,
                unconstrained_font_size=True,
                render=False,
            )


def _corners(points: Array) -> Array:
    """Of the box around points (any, 3), (8, 3)."""
    low, high = points.min(axis=0), points.max(axis=0)
    return np.array(list(product(*zip(low, high, strict=True))))


def _solid(pv: Any, obstacle: Obstacle, centre: Array, half: float) -> Any:
    """The surface of an obstacle; of a half-space a square of its face, nearest to a point."""
    if isinstance(obstacle, Sphere):
        return pv.Sphere(radius=obstacle.radius, center=obstacle.center, theta_resolution=60, phi_resolution=60)
    if isinstance(obstacle, Capsule):
        start, end = np.array(obstacle.start), np.array(obstacle.end)
        return pv.Capsule(
            center=(start + end) / 2,
            direction=end - start,
            radius=obstacle.radius,
            cylinder_length=float(np.linalg.norm(end - start)),
            resolution=60,
        )
    if isinstance(obstacle, Box):
        x, y, z = obstacle.size
        angle = math.hypot(*obstacle.rotation)
        block = pv.Cube(x_length=x, y_length=y, z_length=z)
        if angle > 0:
            block = block.rotate_vector(obstacle.rotation, math.degrees(angle))
        return block.translate(obstacle.center)
    assert isinstance(obstacle, HalfSpace)
    gap, normals = obstacle.distance(centre[None])
    return pv.Plane(center=centre - gap[0] * normals[0], direction=normals[0], i_size=2 * half, j_size=2 * half)
