"""Bodies and obstacles before a camera, drawn off-screen by VTK."""

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.io.units import prefixed
from fenics_rom.mechanics.obstacle_poses import placed
from fenics_rom.mechanics.obstacles import HalfSpace, Obstacle
from fenics_rom.visualization.obstacle_meshes import obstacle_mesh
from fenics_rom.visualization.optional_dependencies import check_window, pyvista_package
from fenics_rom.visualization.tendon_routing import TendonRouting

# Where the camera stands: in front of the body, a little to the right and above.
CAMERA_DIRECTION = np.array([0.42, -0.78, 0.46])
CAMERA_UP = np.array([0.0, 0.0, 1.0])
VIEW_MARGIN = 1.06
SHARP_EDGE_DEGREES = 35.0  # where the surface turns by more, its edge is drawn
LIGHTS = (((0.0, 0.0, 1.0), 0.7), ((-0.6, 0.9, 0.8), 0.45))  # from the camera, and from above its left; strengths
CAPTION_POSITION = (0.015, 0.94)  # where words begin, of width and height
CAPTION_ROOM = 0.25  # for words above and below, of the height
CAPTION_ROOM_BELOW = 0.02  # how much more of it below
CAMERA_DISTANCE = 5.0  # how far the camera stands, of what it sees
MIN_ASPECT, MAX_ASPECT = 0.2, 1.0  # height of a picture, of its width
COLOUR_BAR_PIXELS = 64  # height of the colour bar with its words
SHADING: dict[str, Any] = {
    "smooth_shading": True,
    "split_sharp_edges": True,
    "feature_angle": SHARP_EDGE_DEGREES,
    "ambient": 0.4,
    "diffuse": 0.8,
    "specular": 0.15,
    "specular_power": 20,
}
FLOOR_EXTENT = 0.6  # half the edge of what is shown of a half-space, of the diagonal of all that is to be seen


class RenderColours(NamedTuple):
    """Colours of a picture: background, words and edges, the body at rest, obstacles."""

    paper: str
    ink: str
    ghost: str
    obstacle: str


class Quantity(NamedTuple):
    """What colours show, by its name and SI unit."""

    name: str
    unit: str


DISPLACEMENT = Quantity("displacement", "m")
ARROW_COLOUR = "#d55e00"
ARROW: dict[str, float] = {"tip_length": 0.3, "tip_radius": 0.09, "shaft_radius": 0.03}  # of its length
SEE_THROUGH = 0.25  # opacity of obstacles that can be seen through
TENDON_COLOUR, TENDON_PIXELS = "#d55e00", 4
OUTLINE_COLOUR = "#e41a1c"  # outline of where a contact mode is touched
LIGHT = RenderColours("white", "#1a1a1a", "#9a9a9a", "#c9ccd1")
DARK = RenderColours("#14171c", "#ececec", "#6d7480", "#5b626d")


class BodyRenderer:
    """Draws a body and obstacles in a window without a screen, whose camera sees all that will be shown.

    Args:
        nodes, triangles: (N, 3), m, and (F, 3).
        shapes: displacements that will be shown, (N, 3) each, m.
        coloured: what colours show, and of each shape its values, (N,); what is not a number has no colour. None:
            lengths of displacements.
        scale: by which displacements are multiplied before they are drawn; colours show them as they are.
        obstacles: by name, in the same frame.
        offsets: how far the obstacles will be from there, (any, O, 3), m; or poses (any, O, 7), as of a Trajectory.
        tendons: points at rest that each leads through, (K, 3), m; they are seen through the body.
        width: of a picture, pixels.
        dark: light on dark instead of dark on light.
        captions: whether there is to be room for words and a colour bar.
        below: whether the camera looks from below.
        ghost: whether to draw the edges of the body at rest.
        coloured_triangles: which of them have colours, (F,); others have that of 0. None: all.
        see_through: whether obstacles, and triangles without colours, can be seen through.

    Raises:
        MissingPackageError: there is no PyVista, or nothing that it can draw with.
    """

    def __init__(
        self,
        nodes: Array,
        triangles: Array,
        shapes: Sequence[Array],
        *,
        coloured: tuple[Quantity, Sequence[Array]] | None = None,
        scale: float = 1.0,
        obstacles: Mapping[str, Obstacle] | None = None,
        offsets: Array | None = None,
        tendons: Mapping[str, Array] | None = None,
        width: int = 1000,
        dark: bool = False,
        captions: bool = True,
        below: bool = False,
        ghost: bool = True,
        coloured_triangles: Array | None = None,
        see_through: bool = False,
    ):
        self._pv = pyvista_package()
        check_window()
        self._nodes, self._scale, self._colours, self._captions = nodes, scale, DARK if dark else LIGHT, captions
        self._quantity, fields = coloured or (DISPLACEMENT, [np.linalg.norm(shape, axis=1) for shape in shapes])
        self._largest = max((float(np.nan_to_num(field).max()) for field in fields), default=0.0)
        self._factor, self._unit = prefixed(self._quantity.unit, self._largest)
        self._see_through = {"opacity": SEE_THROUGH} if see_through else {}
        self._triangles, self._ghost, self._coloured_triangles = triangles, ghost, coloured_triangles
        used = np.unique(triangles)
        visible = [nodes[used], *(nodes[used] + scale * shape[used] for shape in shapes)]
        ranges = [zip(points.min(axis=0), points.max(axis=0), strict=True) for points in visible]
        ends = np.array([corner for of_axes in ranges for corner in product(*of_axes)])  # of the boxes around them
        middle, diagonal = ends.mean(axis=0), float(np.linalg.norm(np.ptp(ends, axis=0)))
        obstacles, half_edge = obstacles or {}, FLOOR_EXTENT * diagonal
        meshes = {name: obstacle_mesh(obstacle, middle, half_edge) for name, obstacle in obstacles.items()}
        self._obstacles = meshes
        moved = np.zeros((1, len(meshes), 3)) if offsets is None else offsets
        for k, (name, obstacle) in enumerate(obstacles.items()):
            if not isinstance(obstacle, HalfSpace):  # a floor goes on beyond the picture
                visible += [placed(meshes[name][0], row) for row in np.unique(moved[:, k], axis=0)]
        camera = CAMERA_DIRECTION * [1.0, 1.0, -1.0] if below else CAMERA_DIRECTION
        self._plotter = self._open_window(visible, width, camera)
        self.height = int(self._plotter.window_size[1])  # of a picture, pixels
        routings = [TendonRouting(nodes, points) for points in (tendons or {}).values()]
        self._tendons = list(zip(self._lay_over(len(routings)), routings, strict=True))

    def render(
        self,
        displacement: Array,
        offsets: Array | None = None,
        words: str = "",
        coloured: Array | None = None,
        arrows: Array | None = None,
    ) -> Array:
        """One picture (height, width, 3), bytes, of a displacement (N, 3), m, and obstacles as they have moved.

        `offsets`: (O, 3), m, or poses (O, 7). Colours show the length of the displacement, or what is `coloured` (N,),
        the brightest the largest. `arrows`: where they start and end, (k, 2, 3), m.
        """
        plotter = self._plotter
        body = self._body(self._scale * displacement)
        values = np.linalg.norm(displacement, axis=1) if coloured is None else coloured
        body["shown"] = self._factor * values
        self._draw(body)
        for k, (name, (vertices, faces)) in enumerate(self._obstacles.items()):
            there = vertices if offsets is None else placed(vertices, offsets[k])
            moved = self._pv.PolyData.from_regular_faces(there, faces)
            how = {"color": self._colours.obstacle, "culling": "back"} | self._see_through | SHADING
            plotter.add_mesh(moved, name=f"obstacle {name}", render=False, **how)
        for mapper, routing in self._tendons:
            mapper.dataset = self._pv.MultipleLines(routing.moved(displacement, self._scale))
        self._draw_arrows(np.empty((0, 2, 3)) if arrows is None else arrows)
        if words:
            colour = self._colours.ink
            plotter.add_text(
                words, name="words", font_size=12, color=colour, position=CAPTION_POSITION, viewport=True, render=False
            )
        plotter.render()
        return np.array(plotter.screenshot(None, return_img=True))

    def _draw_arrows(self, arrows: Array) -> None:
        self._plotter.remove_actor("arrows", render=False)
        if len(arrows):
            starts, ways = arrows[:, 0], arrows[:, 1] - arrows[:, 0]
            tips = self._pv.PolyData(starts)
            tips["way"] = ways
            drawn = tips.glyph(orient="way", scale="way", geom=self._pv.Arrow(**ARROW))
            self._plotter.add_mesh(drawn, name="arrows", color=ARROW_COLOUR, render=False)

    def outline(self, triangles: Array, displacement: Array) -> None:
        """Paints some of the surface of the next picture, (any, 3) triangles: where a contact mode is touched."""
        self._plotter.remove_actor("mark", render=False)
        if len(triangles):
            patch = self._pv.PolyData.from_regular_faces(self._nodes + self._scale * displacement, triangles)
            edges = patch.extract_feature_edges(feature_edges=False, manifold_edges=False, boundary_edges=True)
            self._plotter.add_mesh(edges, name="mark", color=OUTLINE_COLOUR, line_width=4, lighting=False, render=False)

    def close(self) -> None:
        """Gives the window back."""
        self._plotter.close()

    def _open_window(self, visible: list[Array], width: int, place: Array) -> Any:
        """The window, as high as what is to be seen, with its camera and the body at rest as a ghost."""
        toward = place / np.linalg.norm(place)
        right = np.cross(CAMERA_UP, toward) / np.linalg.norm(np.cross(CAMERA_UP, toward))
        axes = np.array([right, np.cross(toward, right), toward])
        low = np.min([(points @ axes.T).min(axis=0) for points in visible], axis=0)
        high = np.max([(points @ axes.T).max(axis=0) for points in visible], axis=0)
        middle, (wide, tall, deep) = (low + high) / 2, VIEW_MARGIN * (high - low)
        if self._captions:
            tall *= 1 + CAPTION_ROOM
            middle[1] -= CAPTION_ROOM_BELOW * tall
        ratio = min(max(tall / wide, MIN_ASPECT), MAX_ASPECT)
        height = 2 * round(width * ratio / 2)  # encoders want even numbers
        plotter = self._pv.Plotter(off_screen=True, window_size=(width, height), lighting="none")
        plotter.set_background(self._colours.paper)
        for light, strength in LIGHTS:
            plotter.add_light(self._pv.Light(position=light, intensity=strength, light_type="camera light"))
        camera, focus = plotter.camera, middle @ axes
        distance = CAMERA_DISTANCE * max(wide, tall, deep)
        camera.focal_point, camera.position, camera.up = focus, focus + distance * toward, CAMERA_UP
        camera.parallel_projection, camera.parallel_scale = True, max(tall, wide * ratio) / 2
        plotter.enable_anti_aliasing("msaa", multi_samples=8)
        return plotter

    def _body(self, moved: Array | float) -> Any:
        return self._pv.PolyData.from_regular_faces(self._nodes + moved, self._triangles)

    def _lay_over(self, count: int) -> list[Any]:
        """Mappers of lines in front of all else: in a layer of their own, before the same camera."""
        window = self._plotter.render_window
        self._layer = self._pv.Renderer(self._plotter)  # which empties itself when nobody holds it
        mappers = [self._pv.DataSetMapper() for _ in range(count)]
        for mapper in mappers:
            actor = self._pv.Actor(mapper=mapper)
            actor.prop.color, actor.prop.line_width, actor.prop.lighting = TENDON_COLOUR, TENDON_PIXELS, False
            self._layer.AddActor(actor)
        if mappers:
            self._layer.SetLayer(window.GetNumberOfLayers())
            window.SetNumberOfLayers(window.GetNumberOfLayers() + 1)
            self._layer.SetActiveCamera(self._plotter.camera)
            window.AddRenderer(self._layer)
        return mappers

    def _parts(self, body: Any) -> dict[str, Any]:
        """What has colours, and what has that of 0, as triangles that do not share their corners."""
        coloured = self._coloured_triangles
        if coloured is None or coloured.all() or not coloured.any():
            return {"body": body}
        parts = {}
        for name, which in (("body", coloured), ("rest", ~coloured)):
            parts[name] = part = self._pv.PolyData.from_regular_faces(body.points, self._triangles[which])
            part["shown"] = body["shown"] if name == "body" else 0 * body["shown"]  # where there is no number is none
        return parts

    def _draw(self, body: Any) -> None:
        plotter, colours = self._plotter, self._colours
        for name, part in self._parts(body).items():
            plotter.add_mesh(
                part,
                name=name,
                scalars="shown",
                cmap="viridis",
                nan_color=colours.obstacle,
                clim=(0.0, self._factor * self._largest or 1.0),
                show_scalar_bar=False,
                render=False,
                **SHADING | (self._see_through if name == "rest" else {}),
            )
        lines = [("edges", body, colours.ink, 1.6)]
        if self._ghost:
            lines.append(("ghost", self._body(0.0), colours.ghost, 1.0))
        for name, surface, colour, wide in lines:
            edges = surface.extract_feature_edges(SHARP_EDGE_DEGREES, manifold_edges=False)
            if edges.n_points:
                plotter.add_mesh(edges, name=name, color=colour, line_width=wide, render=False)
        title = f"{self._quantity.name} ({self._unit})"
        if self._captions and title not in plotter.scalar_bars:
            height = COLOUR_BAR_PIXELS / plotter.window_size[1]
            plotter.add_scalar_bar(
                title,
                mapper=plotter.actors["body"].mapper,
                color=colours.ink,
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
