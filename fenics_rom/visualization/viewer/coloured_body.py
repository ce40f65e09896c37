"""A body that changes its shape and its colours on viser's scene, and what is shown at the same time.

viser takes a mesh away before it has read the new one (1.1). A body is therefore two of them: one is shown while the
other one reads the next picture, and the two change places with the picture after that. All that belongs to a picture,
as obstacles do that touch the body, waits until then.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.visualization.viewer.colours import linear_light, shares_of, vertex_colours
from fenics_rom.visualization.viewer.glb import Part, encode_mesh
from fenics_rom.visualization.viewer.surface import Surface

ORIGIN, NOT_TURNED = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
HIGHLIGHT_COLOUR = (255, 120, 30)
PART_OF_A_PIXEL, PART_OF_THE_SCALE = 1e-4, 1e-3  # of the body's size, and of all colours: changes that nobody sees


class NextPicture:
    """Changes that are made together, when the browsers have read what they show."""

    def __init__(self) -> None:
        self._changes: list[Callable[[], None]] = []

    def __bool__(self) -> bool:
        """Whether there is something to be shown."""
        return bool(self._changes)

    def add(self, change: Callable[[], None]) -> None:
        """Puts one off."""
        self._changes.append(change)

    def place(self, mesh: Any, position: Array, rotation: Array = NOT_TURNED) -> None:
        """Puts off to move a mesh to a pose, unless nobody could see a difference."""
        if max(np.abs(position - mesh.position).max(), np.abs(rotation - mesh.wxyz).max()) > PART_OF_A_PIXEL:
            self._changes.append(partial(_place, mesh, position, rotation))

    def show(self) -> None:
        """Makes all of them."""
        for change in self._changes:
            change()
        self._changes.clear()


def _place(mesh: Any, position: Array, rotation: Array) -> None:
    mesh.position, mesh.wxyz = tuple(position), tuple(rotation)


class ColouredBody:
    """A body; `scale` in 1/m, `offset` (3,) in m, `opacity` from 0 to 1, or None of one that is not seen through."""

    def __init__(
        self,
        scene: Any,
        name: str,
        surface: Surface,
        next_picture: NextPicture,
        scale: float,
        offset: Array = ORIGIN,
        opacity: float | None = None,
    ):
        self._surface, self._next_picture, self._scale, self._opacity = surface, next_picture, scale, opacity
        self._highlighted: Array | None = None
        self._parts = [Part(surface.faces)]
        at_rest = self._encoded(scale * surface.places, np.zeros(len(surface.node_of)))
        options: dict[str, Any] = {"position": tuple(scale * offset), "cast_shadow": False, "receive_shadow": False}
        self._shown, self._hidden = (scene.add_glb(f"{name}/{k}", at_rest, visible=k == 0, **options) for k in range(2))
        for node in (self._shown, self._hidden):
            hide_what_is_behind(node)
        self._drawn: tuple[Array, Array, Array | None] | None = None

    def draw(self, moved: Array, values: Array, largest: float, highlighted: Array | None = None) -> bool:
        """Draws the moved nodes (n, 3), m, for the next picture, unless nobody could see a difference; gives whether.

        The values at all vertices are not negative, the `largest` has the brightest colour, and the triangles that are
        `highlighted` another one.
        """
        picture = self._scale * moved, shares_of(values, largest), highlighted
        if self._drawn is not None and _look_alike(self._drawn, picture):
            return False
        self._drawn = picture
        if highlighted is not self._highlighted:
            self._highlighted, self._parts = highlighted, _divided(self._surface.faces, highlighted)
        self._hidden.glb_data = self._encoded(*picture[:2])
        self._next_picture.add(self._change_places)
        return True

    def _encoded(self, places: Array, shares: Array) -> bytes:
        return encode_mesh(places[self._surface.node_of], vertex_colours(shares), self._parts, self._opacity)

    def _change_places(self) -> None:
        self._shown, self._hidden = self._hidden, self._shown
        self._shown.visible, self._hidden.visible = True, False


def _divided(faces: Array, highlighted: Array | None) -> list[Part]:
    """Faces in the vertices' colours, and those that are highlighted."""
    if highlighted is None:
        return [Part(faces)]
    others = np.ones(len(faces), dtype=bool)
    others[highlighted] = False
    red, green, blue = linear_light(np.array(HIGHLIGHT_COLOUR) / 255).tolist()
    parts = [Part(faces[others]), Part(faces[highlighted], (red, green, blue))]
    return [part for part in parts if len(part.faces)]


def _look_alike(before: tuple[Array, Array, Array | None], now: tuple[Array, Array, Array | None]) -> bool:
    """Whether two pictures, of places, shares and highlighted triangles, are the same but for part of a pixel."""
    (places, shares, highlighted), (places_now, shares_now, highlighted_now) = before, now
    return (
        highlighted is highlighted_now
        and np.abs(places_now - places).max() < PART_OF_A_PIXEL
        and np.abs(shares_now - shares).max() < PART_OF_THE_SCALE
    )


def hide_what_is_behind(node: Any) -> None:
    """Keeps the mouse from meeting what is behind a mesh, by a gesture that nobody makes; not while it is hidden."""
    node.on_drag("middle", modifier="cmd/ctrl+alt+shift")(_nothing)


async def _nothing(_: Any) -> None:
    pass
