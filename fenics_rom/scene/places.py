"""Where on a body something acts or is read: one record for surfaces and nodes, one for cells."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Annotated, ClassVar

from fenics_rom.scene.values import Direction, Flag, Items, NameOrTable, Number, Point, Text


@dataclass(frozen=True)
class Near:
    """What lies in a ball."""

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
class Box:
    """What lies in a box along the axes, or within 1e-6 of the body's length of it; the box may be flat."""

    corners: Annotated[tuple[Point, Point], Items(2), "two that are opposite, in any order"]


@dataclass(frozen=True)
class Along:
    """What lies along a line of straight pieces, as a row of nodes on an edge does."""

    points: Annotated[tuple[Point, ...], Items(at_least=2), "of the line, from one end to the other"]
    radius: Annotated[
        float | None, Number(above=0.0, unit="m"), "distance from the line; without it 1e-6 of the body's length"
    ] = None


@dataclass(frozen=True)
class Place:
    """A piece of the surface, or nodes: exactly one of these keys. In a list, a text is the name of a surface."""

    surface: Annotated[str | None, Text(), "a named surface of the mesh"] = None
    near: Annotated[Near | None, "what lies in a ball"] = None
    plane: Annotated[Plane | None, "the surface triangles in a plane"] = None
    facing: Annotated[Facing | None, "the surface triangles that look in a direction"] = None
    box: Annotated[Box | None, "what lies in a box along the axes"] = None
    along: Annotated[Along | None, "what lies along a line of straight pieces"] = None
    inner: Annotated[
        bool | None, Flag(), "the walls of chambers, which hardly see the outside; false: the rest of the surface"
    ] = None
    all: Annotated["tuple[PlaceItem, ...] | None", Items(at_least=1), "what is in all of these places"] = None
    any: Annotated["tuple[PlaceItem, ...] | None", Items(at_least=1), "what is in any of these places"] = None
    none: Annotated["tuple[PlaceItem, ...] | None", Items(at_least=1), "what is in none of these places"] = None

    ONE_OF: ClassVar[tuple[tuple[str, ...], ...]] = (
        ("surface", "near", "plane", "facing", "box", "along", "inner", "all", "any", "none"),
    )

    def patch(self, force: str) -> "Patch":
        """The place, with the forces that can act on it."""
        return Patch(**{piece: getattr(self, piece) for piece in PIECES}, force=force)


PlaceItem = Annotated[Place, NameOrTable("surface")]
PIECES = tuple(field.name for field in fields(Place))  # ways to say which piece of the surface


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
    together: Annotated[
        tuple[Annotated[str, Text()], ...] | None,
        Items(at_least=2),
        "contact modes that are to be pushed at the same time: this one has the inputs of them all; instead of a place",
    ] = None

    ONE_OF = ((*PIECES, "together"),)

    def joined(self, contacts: Mapping[str, "Patch"]) -> "Patch":
        """The same with the place that it has together with other contact modes, by name, if it is made of them."""
        if self.together is None:
            return self
        places = (contacts[name] for name in self.together)
        return replace(self, any=tuple(Place(**{piece: getattr(place, piece) for piece in PIECES}) for place in places))


@dataclass(frozen=True)
class Held(Place):
    """Nodes that do not move, or do not move along a normal: a roller, or a plane of symmetry."""

    ONE_OF = ((*PIECES, "point"),)
    point: Annotated[Point | None, "a node of the mesh; instead of a place"] = None
    normal: Annotated[
        Direction | None,
        "along which they are held, of any length but zero; without one, and where they do not slide, they are clamped",
    ] = None
    sliding: Annotated[
        bool,
        Flag(),
        "whether nodes of a surface, flat or curved, are held along its own normals at rest: mean ones, and at edges "
        "those of both sides; instead of normal",
    ] = False


@dataclass(frozen=True)
class CellPlace:
    """Cells: exactly one of these keys. In a list, a text is the name of a cell group."""

    cells: Annotated[str | None, Text(), "a named cell group of the mesh"] = None
    near: Annotated[Near | None, "what lies in a ball"] = None
    box: Annotated[Box | None, "what lies in a box along the axes"] = None
    along: Annotated[Along | None, "what lies along a line of straight pieces"] = None
    all: Annotated["tuple[CellItem, ...] | None", Items(at_least=1), "what is in all of these places"] = None
    any: Annotated["tuple[CellItem, ...] | None", Items(at_least=1), "what is in any of these places"] = None
    none: Annotated["tuple[CellItem, ...] | None", Items(at_least=1), "what is in none of these places"] = None

    ONE_OF: ClassVar[tuple[tuple[str, ...], ...]] = (("cells", "near", "box", "along", "all", "any", "none"),)


CellItem = Annotated[CellPlace, NameOrTable("cells")]
CELL_PIECES = tuple(field.name for field in fields(CellPlace))  # ways to say which cells


def given_piece(place: Place | CellPlace) -> str | None:
    """Which of the keys of a place is given; None where none is."""
    pieces = PIECES if isinstance(place, Place) else CELL_PIECES
    return next((piece for piece in pieces if getattr(place, piece) is not None), None)


def only_name(place: Place) -> "str | Place":
    """A place that is a named surface by its name; any other as it is."""
    return place if place.surface is None else place.surface
