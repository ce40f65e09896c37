"""The tables of a scene file, where these are other than the records of a scene."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, ClassVar

from fenics_rom.mechanics.environment import DETAILS, FRAMES
from fenics_rom.mechanics.signals import Signal
from fenics_rom.scene.contact import Angle
from fenics_rom.scene.effects import Effects, constant_signal
from fenics_rom.scene.outputs import OutputEntry
from fenics_rom.scene.places import Held, Patch, PlaceItem
from fenics_rom.scene.scene import INTEGRATIONS, Elasticity, Material, ReadingEntry, Reduction
from fenics_rom.scene.values import Flag, Items, Metres, Name, Number, Table, Text

Group = Annotated[int, Number(integer=True, at_least=0)]
InputValue = Annotated[float, Number(unit="N")]


@dataclass(frozen=True)
class Mesh:
    """Tetrahedra or hexahedra of a mesh file; prisms, pyramids and several shapes together are cut into tetrahedra."""

    file: Annotated[
        str,
        Text(),
        "a .msh file of Gmsh, or of another format that `fem` reads; its path is relative to the scene's folder",
    ]
    degree: Annotated[
        int, Number(at_least=1, at_most=2, integer=True), "of the displacements in a cell; 1 is stiff in bending"
    ] = 1
    integration: Annotated[
        str,
        Text(choices=INTEGRATIONS),
        '"selective": changes of volume are those of the mean of a cell, of a hexahedron of degree 2 at eight points, '
        "and rubber does not lock; not of tetrahedra of degree 1",
    ] = "full"
    scale: Annotated[
        float, Number(above=0.0), "metres that a unit of its coordinates is worth: 1e-3 of a mesh in millimetres"
    ] = 1.0
    groups: Annotated[Mapping[Name, Group], "names for physical groups that have numbers alone in the file"] = field(
        default_factory=dict
    )


@dataclass(frozen=True)
class Supports:
    """What holds the body."""

    clamped: Annotated[tuple[PlaceItem, ...], Items(), "surfaces that do not move, by name or as places"] = ()
    held: Annotated[tuple[Held, ...], Items(), "rollers and planes of symmetry"] = ()
    rigid: Annotated[
        tuple[PlaceItem, ...],
        Items(),
        "surfaces that move as rigid bodies do, as where a plate is glued on; with effects.large_deformation they turn "
        "as far as they like",
    ] = ()


@dataclass(frozen=True)
class LoadEntry:
    """A force on a contact mode, or the input of an actuator, between two times."""

    ONE_OF: ClassVar = (("contact", "actuator"), ("force", "table"))
    contact: Annotated[str | None, Text(), "a contact mode; this or actuator"] = None
    actuator: Annotated[str | None, Text(), "an actuator, pressure or tendon; this or contact"] = None
    start: Annotated[float, Number(at_least=0.0, unit="s"), "when it begins"] = 0.0
    stop: Annotated[float | None, Number(above=0.0, unit="s"), "when it ends; usually with the run"] = None
    force: Annotated[
        tuple[InputValue, ...] | None,
        Items(at_least=1, example="[0, 0, 1.0] of a resultant, [1.0] of a normal force, a pressure or a tendon"),
        "where it is constant, one number for each column (of a pressure in Pa, of a stroke in m or m³); this or table",
    ] = None
    table: Annotated[Signal | None, Table(), "time (s) of the run, one column for each number"] = None

    @property
    def signal(self) -> Signal:
        """The numbers over time."""
        signal = self.table or constant_signal(self.force)
        assert signal is not None
        return signal


Speed = Annotated[float, Number(unit="m/s")]
AngularVelocity = Annotated[float, Number(unit="rad/s")]


@dataclass(frozen=True)
class Initial:
    """Where a run begins, if not at rest; what is given adds up."""

    AT_MOST_ONE: ClassVar = ("shape", "trajectory")
    shape: Annotated[
        str | None, Text(choices=("rest", "equilibrium")), '"equilibrium" under the loads at time 0; usually "rest"'
    ] = None
    trajectory: Annotated[
        str | None, Text(), "a run of the same mesh, whose shape and velocities it begins with; path as of the mesh"
    ] = None
    time: Annotated[float | None, Number(at_least=0.0, unit="s"), "of that run, of a snapshot; usually its last"] = None
    translation: Annotated[tuple[Metres, Metres, Metres] | None, Items(3), "of a body that nothing holds"] = None
    rotation: Annotated[
        tuple[Angle, Angle, Angle] | None,
        Items(3),
        "about its centre of mass, a rotation vector; in a fixed frame at most 0.1 along each axis",
    ] = None
    velocity: Annotated[tuple[Speed, Speed, Speed] | None, Items(3), "of all of the body"] = None
    spin: Annotated[
        tuple[AngularVelocity, AngularVelocity, AngularVelocity] | None, Items(3), "about its centre of mass"
    ] = None


@dataclass(frozen=True)
class RunTable:
    """A load history."""

    dt: Annotated[float, Number(above=0.0, unit="s"), "time step"]
    duration: Annotated[float, Number(above=0.0, unit="s"), "of the run"]
    snapshots: Annotated[
        int, Number(at_least=1, integer=True), "how many whole shapes are kept of it, evenly spread"
    ] = 100
    every: Annotated[
        int, Number(at_least=1, integer=True), "outputs, forces and account are kept after every so many steps"
    ] = 1
    detail: Annotated[
        str,
        Text(choices=DETAILS),
        'of a moving frame, how its inertia follows the shape: "full", or "quasi-rigid", that of the shape at rest: '
        "cheaper, and good for stubby bodies that turn slowly",
    ] = "full"
    errors: Annotated[
        bool, Flag(), "whether a reduced run is to tell its error: a bound, and an estimate; of small strains"
    ] = False
    error_tolerance: Annotated[
        float | None,
        Number(above=0.0, unit="m"),
        "of the outputs of a reduced run: it says so at once where its estimate of their error is larger; with errors",
    ] = None
    enrich: Annotated[
        bool, Flag(), "whether directions are added to the basis then; the run is given the scene, for the full system"
    ] = False
    initial: Annotated[Initial | None, "where it begins, if not at rest"] = None
    load: Annotated[tuple[LoadEntry, ...], Items(), "what acts on contact modes and actuators"] = ()


@dataclass(frozen=True, kw_only=True)
class SceneFile:
    """A scene file."""

    __pydantic_config__: ClassVar = {"extra": "forbid"}
    name: Annotated[str, Text(), "of the scene"] = "scene"
    mesh: Annotated[Mesh, "tetrahedra or hexahedra of a mesh file"]
    material: Annotated[Elasticity | None, "of the whole body; this or materials"] = None
    materials: Annotated[Mapping[Name, Material] | None, "of cell groups; this or material"] = None
    frame: Annotated[
        str,
        Text(choices=FRAMES),
        '"moving": the body turns as far as it likes, free or, where something is clamped, carried by a rigid base',
    ] = "fixed"
    supports: Annotated[Supports, "what holds the body"] = field(default_factory=Supports)
    contacts: Annotated[Mapping[Name, Patch], "contact modes, at least one: where the body can be touched"]
    actuators: Annotated[Mapping[Name, Patch], "forces that are inputs beside those of the contact mode"] = field(
        default_factory=dict
    )
    outputs: Annotated[
        Mapping[Name, OutputEntry],
        "displacements of points and surfaces, and what surfaces feel, by name: what runs, plots and comparisons show",
    ] = field(default_factory=dict)
    readings: Annotated[
        Mapping[Name, ReadingEntry],
        "what else is read by name: lengths, volumes, contact pressures, strains, stresses and markers",
    ] = field(default_factory=dict)
    effects: Annotated[Effects, "what acts; an effect that is not named costs nothing"]
    reduction: Annotated[Reduction, "how it is to be reduced"] = field(default_factory=Reduction)
    run: Annotated[RunTable | None, "a load history"] = None
