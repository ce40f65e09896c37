"""What a body touches, as a scene file has it: obstacles and their motion, contact, friction."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, ClassVar

from fenics_rom.mechanics.base_path import BasePath
from fenics_rom.mechanics.environment import CONTACT_POINTS, CONTACT_SWITCHINGS
from fenics_rom.mechanics.signals import Signal
from fenics_rom.scene.law import Law
from fenics_rom.scene.surface_file import FileTriangles
from fenics_rom.scene.values import Direction, Flag, Items, Name, Number, Point, PoseTable, SurfaceFile, Table, Text

TURN = 6.2832  # rad, one turn: what is more was meant in degrees
Length = Annotated[float, Number(above=0.0, unit="m")]
Angle = Annotated[float, Number(at_least=-TURN, at_most=TURN, unit="rad, not degrees")]


@dataclass(frozen=True)
class ObstacleMotion:
    """Poses by which an obstacle moves and turns, as a rigid base does: its point X is at position + R (X - origin)."""

    table: Annotated[
        BasePath | None,
        PoseTable(),
        "times, poses and, where they are known, twists, as of effects.base_path; without a table given in Python",
    ] = None
    origin: Annotated[
        Point, "the point of the scene whose position it says; unless given a pose at 0 leaves the obstacle where it is"
    ] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class RigidObstacle:
    """A rigid obstacle, by the dimensions of its shape; it stands still, or moves by a table, a motion or a function.

    A table shifts it; a motion shifts and turns it. Its work is told in the energy account of contact.
    """

    AT_MOST_ONE: ClassVar = ("table", "motion")
    shape: Annotated[str, Text(choices=("half-space", "sphere", "capsule", "box", "mesh")), "says which keys it has"]
    point: Annotated[Point | None, "of a half-space: on its surface"] = None
    normal: Annotated[Direction | None, "of a half-space: outwards, of any length but zero"] = None
    center: Annotated[Point | None, "of a sphere or a box"] = None
    start: Annotated[Point | None, "of a capsule: one end of its axis"] = None
    end: Annotated[Point | None, "of a capsule: the other end of its axis"] = None
    radius: Annotated[Length | None, "of a sphere or a capsule"] = None
    size: Annotated[tuple[Length, Length, Length] | None, Items(3), "of a box: lengths of its edges"] = None
    rotation: Annotated[tuple[Angle, Angle, Angle] | None, Items(3), "of a box or a mesh: rotation vector"] = None
    file: Annotated[
        FileTriangles | None, SurfaceFile(), "of a mesh: .stl, or .vtk, .vtp, .vtu (VTK), or .step, .stp (Gmsh)"
    ] = None
    scale: Annotated[
        float | None, Number(above=0.0, unit="m"), "of a mesh: that a unit of its file is worth; else 1"
    ] = None
    position: Annotated[Point | None, "of a mesh: where the origin of its file is; else the scene's"] = None
    open: Annotated[
        bool | None, Flag(), "of a mesh: whether it may have a border; all behind it is solid; else false"
    ] = None
    table: Annotated[Signal | None, Table(columns=3, unit="m"), "time (s), displacement (m); this or a motion"] = None
    motion: Annotated[ObstacleMotion | None, "poses over time, of what turns; {} where given in Python"] = None


@dataclass(frozen=True, kw_only=True)
class Contact:
    """Contact with rigid obstacles and of the body with itself, without friction where none is named."""

    LAW: ClassVar = Law(
        force="λ ≥ 0 along the normals of what is touched, with λ = 0 or a gap that does not close",
        dissipates="what restitution below 1 takes in an impact",
        supplies="the work of moving obstacles",
        changing=(
            *("restitution", "method", "stiffness", "damping", "switching", "self_contact", "obstacles"),
            "residual_compliance",
        ),
    )
    restitution: Annotated[
        float, Number(at_least=0.0, at_most=1.0), "part of the approaching speed that an impact gives back"
    ] = 0.0
    method: Annotated[
        str,
        Text(choices=("complementarity", "penalty")),
        '"complementarity" (rigid obstacles) or "penalty" (springs at all places, which need a stiffness)',
    ] = "complementarity"
    stiffness: Annotated[float | None, Number(above=0.0, unit="N/m"), "of the penalty's spring at every place"] = None
    damping: Annotated[float | None, Number(at_least=0.0, unit="N s/m"), "of a dashpot beside each spring"] = None
    switching: Annotated[
        str,
        Text(choices=CONTACT_SWITCHINGS),
        '"automatic" (the contact mode follows the obstacles) or "scene" (the load history says which it is)',
    ] = "automatic"
    points: Annotated[
        str,
        Text(choices=CONTACT_POINTS),
        'what is touched: "nodes"; "surface", also points between, where an obstacle would pass; or whole "faces"',
    ] = "nodes"
    residual_compliance: Annotated[
        bool,
        Flag(),
        "whether contact points of a reduced model keep the compliance that its basis lacks; false to compare",
    ] = True
    self_contact: Annotated[
        tuple[Annotated[str, Text()], ...],
        Items(),
        "contact modes whose surfaces touch one another and themselves, as folds and fingers of one body do",
    ] = ()
    obstacles: Annotated[Mapping[Name, RigidObstacle], "at least one, where there is no self_contact"] = field(
        default_factory=dict
    )


@dataclass(frozen=True)
class Friction:
    """Dry friction with all that is touched."""

    LAW: ClassVar = Law(
        force="Coulomb's, at most μ λ, against sliding",
        dissipates="μ λ times what is slid",
        needs=("contact",),
        changing=("coefficient",),
    )
    coefficient: Annotated[float, Number(at_least=0.0), "μ"]
