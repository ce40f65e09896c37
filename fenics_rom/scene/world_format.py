"""The tables of a world file: bodies, joints, who does not touch whom, a load history."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np

from fenics_rom.mechanics.base_path import BasePath
from fenics_rom.mechanics.signals import Signal
from fenics_rom.scene.certificate_format import CertificateTable
from fenics_rom.scene.contact import Angle
from fenics_rom.scene.effects import constant_signal
from fenics_rom.scene.file_format import AngularVelocity, Speed
from fenics_rom.scene.surface_file import FileTriangles
from fenics_rom.scene.values import Direction, Flag, Items, Name, Number, Point, PoseTable, SurfaceFile, Table, Text

WORLD_SHAPES = ("half-space", "box", "sphere", "capsule", "cylinder", "hull", "mesh")
Length = Annotated[float, Number(above=0.0, unit="m")]
Acceleration = Annotated[float, Number(unit="m/s2")]
Restitution = Annotated[float, Number(at_least=0.0, at_most=1.0), "part of the approaching speed that comes back"]
Friction = Annotated[float, Number(at_least=0.0), "Coulomb's coefficient"]
BodyName = Annotated[str, Text()]
ZERO = (0.0, 0.0, 0.0)
STANDS_STILL = "world"  # what joints may hold a body to


@dataclass(frozen=True, kw_only=True)
class MotorTable:
    """What pushes a joint of a robot towards the target that it is given."""

    kind: Annotated[
        str,
        Text(choices=("position", "velocity", "torque")),
        "gain (target - position) - damping speed, gain (target - speed), or the target itself",
    ]
    gain: Annotated[float, Number(at_least=0.0), "N m/rad or N m s/rad; of a slider N/m or N s/m; none of a torque"] = (
        0.0
    )
    damping: Annotated[float, Number(at_least=0.0), "of a position, N m s/rad; of a slider N s/m"] = 0.0
    most: Annotated[
        float | None, Number(above=0.0), "largest torque, N m, or force, N; else what the file of the robot says"
    ] = None


@dataclass(frozen=True, kw_only=True)
class WorldBody:
    """A body, soft or rigid."""

    ONE_OF: ClassVar = (("rom", "scene", "shape", "robot"),)
    AT_MOST_ONE: ClassVar = ("density", "mass")
    rom: Annotated[str | None, Text(), "of a soft body: a file that `reduce` wrote; this, scene or shape"] = None
    scene: Annotated[str | None, Text(), "of a soft body: a scene file, which is reduced as it says"] = None
    shape: Annotated[str | None, Text(choices=WORLD_SHAPES), "of a rigid body: says which dimensions it has"] = None
    robot: Annotated[
        str | None, Text(), "of a robot: a URDF or MJCF file; its links are bodies NAME.LINK, its joints NAME.JOINT"
    ] = None
    positions: Annotated[
        Mapping[Name, Annotated[float, Number()]],
        "of joints of a robot where it begins, rad or m; else as its file says",
    ] = field(default_factory=dict)
    motors: Annotated[
        Mapping[Name, MotorTable], "of joints of a robot by name, or `all` of them; else those of its MJCF file"
    ] = field(default_factory=dict)
    surface: Annotated[
        str | None,
        Text(),
        "of a free soft body on a link of a robot (`on`): the contact mode whose surface is welded to it",
    ] = None
    size: Annotated[tuple[Length, Length, Length] | None, Items(3), "of a box: lengths of its edges"] = None
    radius: Annotated[Length | None, "of a sphere, a capsule or a cylinder"] = None
    length: Annotated[Length | None, "of a cylinder, or of the axis of a capsule without its ends, along z"] = None
    points: Annotated[tuple[Point, ...] | None, Items(at_least=4), "of a hull: its corners, in any axes"] = None
    file: Annotated[
        FileTriangles | None,
        SurfaceFile(),
        "of a mesh, which stands still or follows a path: as of effects.contact.obstacles",
    ] = None
    scale: Annotated[
        float | None, Number(above=0.0, unit="m"), "of a mesh: that a unit of its file is worth; else 1"
    ] = None
    open: Annotated[
        bool | None, Flag(), "of a mesh: whether it may have a border; all behind it is solid; else false"
    ] = None
    density: Annotated[float | None, Number(above=0.0, unit="kg/m3"), "of a rigid body that moves; this or mass"] = None
    mass: Annotated[float | None, Number(above=0.0, unit="kg"), "of a rigid body that moves; this or density"] = None
    position: Annotated[
        Point,
        "of the centre of mass; of a half-space a point of its face; of a mesh the origin of its file; of a soft body "
        "that is held, of the axes of its mesh; of one that is carried (`on`), of these axes, or of its "
        "base_path.origin, counted from the carrier's centre of mass, not its surface, along its axes, as the rotation "
        "is; none beside a path",
    ] = ZERO
    rotation: Annotated[
        tuple[Angle, Angle, Angle], Items(3), "a rotation vector; the face of a half-space looks along z where it is 0"
    ] = ZERO
    velocity: Annotated[tuple[Speed, Speed, Speed], Items(3), "of the centre of mass"] = ZERO
    spin: Annotated[tuple[AngularVelocity, AngularVelocity, AngularVelocity], Items(3), "about it"] = ZERO
    on: Annotated[str | None, Text(), "of a soft body that is carried: the rigid body on which it is mounted"] = None
    path: Annotated[
        BasePath | None,
        PoseTable(),
        "of a rigid body that is moved: time, poses and perhaps twists, as of effects.base_path; a rigid body without "
        "mass, density and path stands still",
    ] = None


@dataclass(frozen=True, kw_only=True)
class ContactTable:
    """How bodies meet."""

    friction: Friction = 0.0
    restitution: Restitution = 0.0


@dataclass(frozen=True, kw_only=True)
class PairEntry:
    """How two bodies meet, where it is not as all others; or how a soft body meets itself, if it does."""

    bodies: Annotated[tuple[BodyName, BodyName], Items(2), "which; a soft body twice touches itself"]
    friction: Friction = 0.0
    restitution: Restitution = 0.0


@dataclass(frozen=True, kw_only=True)
class JointEntry:
    """What holds two bodies together, for ever or between two times; then they do not touch one another."""

    ONE_OF: ClassVar = (("point", "surface"),)
    kind: Annotated[str, Text(choices=("ball", "hinge", "weld")), "which motions it leaves"]
    first: Annotated[str, Text(), "a body"]
    second: Annotated[str, Text(), 'another one, or "world", which stands still'] = "world"
    point: Annotated[Point | None, "of the joint, where the bodies are when it is made; this or surface"] = None
    surface: Annotated[
        str | None,
        Text(),
        "of the first body, a soft one: the contact mode whose surface is held; a weld holds all of it (a rigid one by "
        "three forces and three couples), a ball joint its mean place, a hinge a line in it; this or point",
    ] = None
    axis: Annotated[Direction | None, "of a hinge, of any length but zero"] = None
    name: Annotated[str | None, Text(), 'by which Python makes and lets go of it; else "joint0" and so on'] = None
    start: Annotated[
        float,
        Number(at_least=0.0, unit="s"),
        "when it is made, where the bodies are then; an impulse stops what moves relative to one another, and takes "
        "energy, which is dissipated",
    ] = 0.0
    stop: Annotated[
        float | None, Number(above=0.0, unit="s"), "when it is let go, which takes no energy; else never"
    ] = None


@dataclass(frozen=True, kw_only=True)
class WorldInput:
    """The input of an actuator of a soft body, or the target of a motor, between two times."""

    ONE_OF: ClassVar = (("value", "table"), ("body", "joint"))
    body: Annotated[str | None, Text(), "a soft body, with an actuator; this or joint"] = None
    actuator: Annotated[str | None, Text(), "an actuator, pressure or tendon of its scene"] = None
    joint: Annotated[str | None, Text(), "a joint of a robot with a motor, as ROBOT.JOINT, whose target this is"] = None
    start: Annotated[float, Number(at_least=0.0, unit="s"), "when it begins"] = 0.0
    stop: Annotated[float | None, Number(above=0.0, unit="s"), "when it ends; usually with the run"] = None
    value: Annotated[
        float | None,
        Number(),
        "where it is constant, in N, Pa, m or m³; of a motor in rad, rad/s, N m, m, m/s or N; this or table",
    ] = None
    table: Annotated[Signal | None, Table(columns=1, unit="N"), "time (s) of the run, the number"] = None

    @property
    def signal(self) -> Signal:
        """The number over time."""
        signal = self.table or constant_signal(None if self.value is None else (self.value,))
        assert signal is not None
        return signal


@dataclass(frozen=True, kw_only=True)
class WorldRun:
    """A load history of a world."""

    dt: Annotated[float, Number(above=0.0, unit="s"), "time step"]
    duration: Annotated[float, Number(above=0.0, unit="s"), "of the run, a whole number of steps"]
    snapshots: Annotated[int, Number(at_least=1, integer=True), "how many shapes are kept of it, evenly spread"] = 100
    every: Annotated[int, Number(at_least=1, integer=True), "all else is kept after every so many steps"] = 1
    input: Annotated[tuple[WorldInput, ...], Items(), "what acts on actuators"] = ()


@dataclass(frozen=True, kw_only=True)
class WorldFile:
    """A world file: several bodies that touch one another."""

    __pydantic_config__: ClassVar = {"extra": "forbid"}
    name: Annotated[str, Text(), "of the world"] = "world"
    bodies: Annotated[Mapping[Name, WorldBody], "at least one, by name"]
    gravity: Annotated[
        tuple[Acceleration, Acceleration, Acceleration], Items(3), "on rigid bodies; soft ones have that of their scene"
    ] = ZERO
    contact: Annotated[ContactTable, "how all bodies meet"] = field(default_factory=ContactTable)
    pairs: Annotated[
        tuple[PairEntry, ...], Items(), "which two bodies meet otherwise, each two once; or a soft one itself"
    ] = ()
    apart: Annotated[
        tuple[Annotated[tuple[BodyName, ...], Items(at_least=2)], ...],
        Items(),
        "groups of bodies without contact between them: they pass through one another, as bodies that are joined do "
        "without being named here",
    ] = ()
    joints: Annotated[tuple[JointEntry, ...], Items(), "what holds bodies together"] = ()
    run: Annotated[WorldRun | None, "a load history"] = None
    certificate: Annotated[CertificateTable | None, "of impacts: `fenics-rom certify`"] = None


@dataclass(frozen=True)
class WorldScene:
    """A world file that was read.

    Attributes:
        file: what it says.
        folder: what paths in it are relative to.
        source: its name, for messages.
        raw: what it says, as TOML has it.
        tables: what the tables and surfaces hold that it was read from, by name, in SI units.
    """

    file: WorldFile
    folder: Path
    source: str
    raw: Mapping[str, Any]
    tables: Mapping[str, np.ndarray]

    def __repr__(self) -> str:
        file = self.file
        run = "no run" if file.run is None else f"run of {file.run.duration:g} s with dt = {file.run.dt:g} s"
        return f"WorldScene {file.name!r}: bodies {', '.join(file.bodies)}; {run}"
