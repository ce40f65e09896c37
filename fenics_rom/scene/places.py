"""Where on a body something acts."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

from fenics_rom.scene.values import Direction, Number, Point, Text

PIECES = ("surface", "near", "plane", "facing")  # ways to say which piece of the surface


@dataclass(frozen=True)
class Near:
    """The surface triangles whose centroids lie in a ball."""

    point: Annotated[Point, "centre of the ball"]
    radius: Annotated[float, Number(above=0.0, unit="m"), "of the ball"]


@dataclass(frozen=True)
class Plane:
    """The surface triangles in a plane."""

    point: Annotated[Point, "of the plane"]
    normal: Annotated[Direction, "of the plane, of any length but zero"]
    distance: Annotated[
        float | None, Number(above=0.0, unit="m"), "that their corners may be off; without it 1e-6 of the body's length"
    ] = None


@dataclass(frozen=True)
class Facing:
    """The surface triangles that look in a direction."""

    direction: Annotated[Direction, "of any length but zero"]
    angle: Annotated[float, Number(above=0.0, below=1.6, unit="rad"), "by which their outward normals may be off"] = 0.1


@dataclass(frozen=True)
class Place:
    """A piece of the surface: exactly one of them."""

    ONE_OF: ClassVar[tuple[tuple[str, ...], ...]] = (PIECES,)
    surface: Annotated[str | None, Text(), "a named surface of the mesh"] = None
    near: Annotated[Near | None, "the surface triangles whose centroids lie in a ball"] = None
    plane: Annotated[Plane | None, "the surface triangles in a plane"] = None
    facing: Annotated[Facing | None, "the surface triangles that look in a direction"] = None

    def patch(self, force: str) -> "Patch":
        """The place, with the forces that can act on it."""
        return Patch(self.surface, self.near, self.plane, self.facing, force)


@dataclass(frozen=True)
class Patch(Place):
    """A piece of the surface and the forces that can act on it: a contact mode or an actuator."""

    force: Annotated[
        str,
        Text(choices=("resultant", "wrench", "normal", "nodal")),
        '"resultant" (3 columns: a force spread uniformly over the patch), "wrench" (6 columns: that, and a moment'
        ' about its centre, in N m), "normal" (1 column: a uniform pressure along inward normals, scaled so that 1 N'
        ' is pressure times area) or "nodal" (3 columns a node)',
    ] = "resultant"


@dataclass(frozen=True)
class Held(Place):
    """Nodes that do not move, or do not move along a normal: a roller, or a plane of symmetry."""

    ONE_OF = ((*PIECES, "point"),)
    point: Annotated[Point | None, "a node of the mesh; instead of a piece of the surface"] = None
    normal: Annotated[
        Direction | None, "along which they are held, of any length but zero; without one they are clamped"
    ] = None
