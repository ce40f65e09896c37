"""The effects: everything that can act on a body, typed, with what each does to the energy.

A scene names the effects it calls for. One that is not named costs nothing and changes no bit.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Annotated, ClassVar

import numpy as np

from fenics_rom.mechanics.base_path import BasePath
from fenics_rom.mechanics.signals import Signal
from fenics_rom.scene.chambers import ChamberGas, Valve
from fenics_rom.scene.contact import Contact, Friction
from fenics_rom.scene.expression import Expression
from fenics_rom.scene.fibres import Cable, Membrane
from fenics_rom.scene.large_deformation import LargeDeformation
from fenics_rom.scene.law import Law
from fenics_rom.scene.places import CELL_PIECES, PIECES, CellPlace, Place
from fenics_rom.scene.values import Direction, Flag, Items, Name, Number, Point, PoseTable, Table, Text

Alpha = Annotated[float, Number(at_least=0.0, unit="1/s"), "share of the mass matrix in the damping matrix"]
Beta = Annotated[float, Number(at_least=0.0, unit="s"), "share of the stiffness matrix in the damping matrix"]
Acceleration = Annotated[float, Number(unit="m/s2")]
Newtons = Annotated[float, Number(unit="N")]
Moment = Annotated[float, Number(at_least=0.0, unit="kg m2")]


@dataclass(frozen=True)
class Inertia:
    """The mass of the body; without it every step is an equilibrium."""

    LAW: ClassVar = Law(force="M dv/dt", stores="½ vᵀ M v")


@dataclass(frozen=True)
class RayleighDamping:
    """Damping of one material, in place of the body's."""

    alpha: Alpha = 0.0
    beta: Beta = 0.0


@dataclass(frozen=True, kw_only=True)
class Dashpot(Place):
    """A dashpot to ground, spread evenly over a surface; in a moving frame it is of the true velocities."""

    coefficient: Annotated[float, Number(above=0.0, unit="N s/m"), "force per speed of the whole surface"]


@dataclass(frozen=True)
class Damping(RayleighDamping):
    """Rayleigh damping of the body, or of each material, and dashpots to ground."""

    LAW: ClassVar = Law(
        force="D v, D = α M + β K (Rayleigh), for each material, and dashpots to ground",
        dissipates="vᵀ D v per second",
        needs=("inertia",),
    )
    materials: Annotated[Mapping[Name, RayleighDamping], "materials that damp otherwise"] = field(default_factory=dict)
    dashpots: Annotated[Mapping[Name, Dashpot], "dashpots to ground"] = field(default_factory=dict)


@dataclass(frozen=True)
class Viscoelasticity:
    """A material that creeps and relaxes: a generalised Maxwell solid, by its Prony series."""

    LAW: ClassVar = Law(
        force="Σ g K w, dw/dt = dx/dt - w/τ: for each branch a spring g K in line with a dashpot; `young` is relaxed",
        stores="½ Σ g wᵀ K w",
        dissipates="Σ g/τ wᵀ K w per second",
        needs=("inertia",),
        changing=("ratios", "times"),
    )
    ratios: Annotated[
        tuple[Annotated[float, Number(above=0.0)], ...],
        Items(at_least=1),
        "g, stiffness of each branch as a share of the relaxed stiffness; of shares ḡ of the instantaneous one "
        "(Abaqus and others) it is ḡ/(1 - Σ ḡ)",
    ]
    times: Annotated[
        tuple[Annotated[float, Number(above=0.0, unit="s")], ...], Items(at_least=1), "τ, in which each branch relaxes"
    ]


@dataclass(frozen=True, kw_only=True)
class Spring(Place):
    """A spring to ground, or an elastic foundation, spread evenly over a surface.

    In a moving frame it pulls to where nodes are at rest.
    """

    LAW: ClassVar = Law(
        force="K_s x, a spring to ground spread evenly over a surface", stores="½ xᵀ K_s x", online=False
    )
    ONE_OF = (PIECES, ("stiffness", "foundation"))
    stiffness: Annotated[
        float | None, Number(above=0.0, unit="N/m"), "force per displacement of the whole surface; this or foundation"
    ] = None
    foundation: Annotated[
        float | None, Number(above=0.0, unit="N/m3"), "of an elastic foundation (Winkler): pressure per displacement"
    ] = None
    sliding: Annotated[
        bool, Flag(), "whether it resists along the surface's normals alone; where the frame does not move"
    ] = False


@dataclass(frozen=True, kw_only=True)
class PointMass(Place):
    """A mass fixed to a point of the body, spread evenly over a piece of its surface, or hung from it by a thread."""

    LAW: ClassVar = Law(
        force="m dv/dt of a mass fixed to the body, and its weight under gravity", stores="½ m v²", online=False
    )
    ONE_OF = ((*PIECES, "point"),)
    point: Annotated[Point | None, "a material point of the body"] = None
    mass: Annotated[float, Number(above=0.0, unit="kg"), "of the whole"]
    direction: Annotated[
        Direction | None,
        "along which alone it is inert, as a weight on a thread is, while the body hardly moves aside, so that only a "
        "fixed frame has it; any length but zero; without it in all",
    ] = None


@dataclass(frozen=True, kw_only=True)
class RigidPart(Place):
    """A rigid part fixed to a piece of the surface: its mass, where its centre is, and how hard it is to turn.

    It is carried by the mean displacement of the surface, and by the mean of ∂u/∂X in the cells behind it.
    """

    LAW: ClassVar = Law(
        force="m dv/dt of a rigid part's centre and the torque of its inertia, and its weight under gravity",
        stores="½ m v² + ½ ωᵀ I ω",
        online=False,
    )
    mass: Annotated[float, Number(above=0.0, unit="kg"), "of the part"]
    center: Annotated[Point, "its centre of mass, on the body or off it"]
    inertia: Annotated[
        tuple[Moment, Moment, Moment],
        Items(3, example="[1e-6, 1e-6, 2e-6]"),
        "its moments about the axes x, y, z through its centre; each at most the sum of the other two",
    ] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Gravity:
    """Weight, which is there from the first step on."""

    LAW: ClassVar = Law(force="M g", supplies="its work")
    acceleration: Annotated[tuple[Acceleration, Acceleration, Acceleration], Items(3, example="[0, 0, -9.81]"), "g"]


@dataclass(frozen=True)
class BaseMotion:
    """A support that is shaken; constant, by a table, or by a function of time given in Python."""

    LAW: ClassVar = Law(
        force="-M a of a support that is shaken; displacements are relative to it",
        supplies="its work",
        needs=("inertia",),
        changing=("acceleration", "table"),
    )
    AT_MOST_ONE: ClassVar = ("acceleration", "table")
    direction: Annotated[Direction, "along which it is shaken; any length but zero"]
    acceleration: Annotated[Acceleration | None, "of the support, where it is constant"] = None
    table: Annotated[Signal | None, Table(columns=1, unit="m/s2"), "time (s), acceleration (m/s2)"] = None

    @property
    def signal(self) -> Signal | None:
        """The acceleration (1,) over time, m/s²; None where it is to be given in Python."""
        return self.table or constant_signal(self.acceleration)


@dataclass(frozen=True)
class RigidBase:
    """A rigid base that carries the body, where `frame = "moving"`: all that supports hold moves with it."""

    LAW: ClassVar = Law(
        force="that of a rigid base, all clamped surfaces, whose path is given",
        supplies="the base's wrench times its twist",
        changing=("table",),
    )
    table: Annotated[
        BasePath | None,
        PoseTable(),
        "times, poses and, where they are known, twists, as above; without a table given in Python",
    ] = None
    origin: Annotated[
        Point, "the material point whose position it says; unless given a base at 0 leaves the body where its mesh is"
    ] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class PrescribedForce(Place):
    """A force on a surface, a ball of it, or at a point; constant, by a table, or given in Python."""

    LAW: ClassVar = Law(
        force="a force on a surface, evenly, or at a point", supplies="its work", changing=("force", "table")
    )
    ONE_OF = ((*PIECES, "point"),)
    AT_MOST_ONE: ClassVar = ("force", "table")
    point: Annotated[Point | None, "a material point of the body"] = None
    force: Annotated[
        tuple[Newtons, Newtons, Newtons] | None, Items(3, example="[0, 0, -1.0]"), "where it is constant"
    ] = None
    table: Annotated[Signal | None, Table(columns=3, unit="N"), "time (s), three components (N)"] = None

    @property
    def signal(self) -> Signal | None:
        """The force (3,) over time, N; None where it is to be given in Python."""
        return self.table or constant_signal(self.force)

    def scaled(self, share: float) -> "PrescribedForce":
        """A share of the force."""
        force = None if self.force is None else (share * self.force[0], share * self.force[1], share * self.force[2])
        return replace(self, force=force, table=None if self.table is None else self.table.scaled(share))


@dataclass(frozen=True, kw_only=True)
class Temperature(CellPlace):
    """A temperature of the body, or of some cells, above that at which it is at rest.

    It is known, not found: no heat flows. Where several temperatures act they add up.
    """

    LAW: ClassVar = Law(
        force="of strain α T that is held back, ∫ C:α T I : ∇δ, with `expansion` α of the materials",
        supplies="its work",
        changing=("amplitude", "table"),
    )
    ONE_OF: ClassVar = ()
    AT_MOST_ONE: ClassVar = CELL_PIECES
    field: Annotated[str, Expression(), "T, K, of the place at rest x, y, z, m: a number or a formula"]
    amplitude: Annotated[float | None, Number(), "by which it is multiplied, where that is constant; or table"] = None
    table: Annotated[Signal | None, Table(columns=1, unit="1"), "time (s), what it is multiplied by"] = None

    @property
    def signal(self) -> Signal | None:
        """The multiple (1,) over time; None where it is to be given in Python."""
        return self.table or constant_signal(self.amplitude)


@dataclass(frozen=True)
class Pressure(Place):
    """An actuator: a chamber, or a hand."""

    LAW: ClassVar = Law(
        force="p along the inward normals of a surface; the input is p in Pa, or what p comes of: the volume or gas in "
        "m³, or the pressure in Pa of a supply behind a valve",
        stores="in its gas, if any",
        supplies="its work, or that of gas blown in",
        changing=("control", "gas", "valve"),
    )
    control: Annotated[
        str,
        Text(choices=("pressure", "volume", "gas", "valve")),
        '"pressure" (the input is in Pa), "volume" (it is in m³: by how much larger than at rest the chamber behind '
        'the surface is, as of a liquid; its pressure, of either sign, is found), "gas" (m³, at ambient pressure: what '
        'was blown in so far; 0 is a sealed chamber) or "valve" (Pa: gauge pressure of the supply)',
    ] = "pressure"
    gas: Annotated[ChamberGas | None, "of a chamber that holds some; {} unless given"] = None
    valve: Annotated[Valve | None, "through which it comes"] = None


@dataclass(frozen=True)
class Tendon:
    """An actuator: a cable that is pulled."""

    LAW: ClassVar = Law(
        force="a cable through points from its anchor on, without friction; the input is its tension in N, or the "
        "stroke in m (by how much it is pulled in) that its tension comes of",
        supplies="its work",
        changing=("control",),
    )
    points: Annotated[tuple[Point, ...], Items(at_least=2), "material points from the anchor to where it is pulled"]
    control: Annotated[
        str,
        Text(choices=("tension", "length")),
        '"tension" (the input is in N) or "length" (it is in m: by how much the cable is shorter than at rest; its '
        "tension is found, and where the body makes it shorter still, it is slack)",
    ] = "tension"


@dataclass(frozen=True)
class TendonFriction:
    """Dry friction of all tendons at their guides."""

    LAW: ClassVar = Law(
        force="at a guide where a tendon turns by α its tension falls by e^(-μα), against sliding",
        dissipates="the fall of tension times what is slid",
        needs=("tendon",),
        changing=("coefficient",),
    )
    coefficient: Annotated[float, Number(above=0.0), "μ"]


@dataclass(frozen=True, kw_only=True)
class DrivenSupport(Place):
    """An actuator: a support that is moved, as the clamp or the plate of a testing machine."""

    LAW: ClassVar = Law(
        force="that of a support that moves its nodes together along a direction; the input is how far it has moved, "
        "m, or its force, N",
        supplies="its work",
        changing=("control",),
    )
    direction: Annotated[Direction, "along which it moves; any length but zero"]
    sliding: Annotated[
        bool, Flag(), "whether its nodes slide across the direction, as on a smooth plate; else they are clamped to it"
    ] = False
    control: Annotated[
        str,
        Text(choices=("displacement", "force")),
        '"displacement" (the input is in m, and the force of either sign is found) or "force" (it is in N)',
    ] = "displacement"


@dataclass(frozen=True)
class Effects:
    """The effects that act, by their names in a scene file; what is not named is None, or has no entries."""

    inertia: Inertia | None = None
    damping: Damping | None = None
    viscoelasticity: Viscoelasticity | None = None
    springs: Mapping[Name, Spring] = field(default_factory=dict)
    membranes: Mapping[Name, Membrane] = field(default_factory=dict)
    cables: Mapping[Name, Cable] = field(default_factory=dict)
    point_masses: Mapping[Name, PointMass] = field(default_factory=dict)
    rigid_parts: Mapping[Name, RigidPart] = field(default_factory=dict)
    gravity: Gravity | None = None
    base_motion: Mapping[Name, BaseMotion] = field(default_factory=dict)
    base_path: RigidBase | None = None
    prescribed: Mapping[Name, PrescribedForce] = field(default_factory=dict)
    temperature: Mapping[Name, Temperature] = field(default_factory=dict)
    pressure: Mapping[Name, Pressure] = field(default_factory=dict)
    tendon: Mapping[Name, Tendon] = field(default_factory=dict)
    tendon_friction: TendonFriction | None = None
    driven_support: Mapping[Name, DrivenSupport] = field(default_factory=dict)
    large_deformation: LargeDeformation | None = None
    contact: Contact | None = None
    friction: Friction | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Those that act, in the order of the table of effects."""
        return tuple(field.name for field in fields(self) if getattr(self, field.name) not in (None, {}))

    @property
    def damped(self) -> Damping:
        """The damping; of nothing, α = β = 0, where none is named."""
        return self.damping or Damping()


def constant_signal(value: float | tuple[float, ...] | None) -> Signal | None:
    """A signal that stays; None where there is none."""
    return None if value is None else Signal(np.atleast_1d(np.array(value, dtype=float)))
