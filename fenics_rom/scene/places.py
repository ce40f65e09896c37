"""Where on a body something acts."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

from fenics_rom.scene.values import Direction, Number, Point, Text


@dataclass(frozen=True)
class Near:
    """The surface triangles whose centroids lie in a ball."""

    point: Annotated[Point, "centre of the ball"]
    radius: Annotated[float, Number(above=0.0, unit="m"), "of the ball"]


@dataclass(frozen=True)
class Place:
    """A piece of the surface: exactly one of the two."""

    ONE_OF: ClassVar[tuple[tuple[str, ...], ...]] = (("surface", "near"),)
    surface: Annotated[str | None, Text(), "a named surface of the mesh"] = None
    near: Annotated[Near | None, "the surface triangles whose centroids lie in a ball"] = None

    def patch(self, force: str) -> "Patch":
        """The place, with the forces that can act on it."""
        return Patch(self.surface, self.near, force)


@dataclass(frozen=True)
class Patch(Place):
    """A piece of the surface and the forces that can act on it: a contact mode or an actuator."""

    force: Annotated[
        str,
        Text(choices=("resultant", "normal", "nodal")),
        '"resultant" (3 columns: a force spread uniformly over the patch), "normal" (1 column: a uniform pressure along'
        ' the inward normals, scaled so that 1 N is pressure times area) or "nodal" (3 columns a node)',
    ] = "resultant"


@dataclass(frozen=True)
class Held(Place):
    """Nodes that do not move, or do not move along a normal: a roller, or a plane of symmetry."""

    ONE_OF = (("surface", "near", "point"),)
    point: Annotated[Point | None, "a node of the mesh; instead of surface or near"] = None
    normal: Annotated[
        Direction | None, "along which they are held, of any length but zero; without one they are clamped"
    ] = None
