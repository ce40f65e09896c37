"""What acts on a body in a run, as data: made from a scene, kept in the ROM file, read by the runtime.

Loads and obstacles have signals; how these drive a step is `mechanics.active_environment`.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from fenics_rom.errors import SceneError
from fenics_rom.mechanics.signals import Signal

if TYPE_CHECKING:
    from fenics_rom.mechanics.base_path import BasePath
    from fenics_rom.mechanics.contact import ContactLaw
    from fenics_rom.mechanics.gas import Gas
    from fenics_rom.mechanics.initial_state import InitialState
    from fenics_rom.mechanics.obstacles import Obstacle
    from fenics_rom.mechanics.viscoelasticity import PronySeries

# Part of the matrices: no run can leave them out.
PERMANENT_EFFECTS = ("springs", "membranes", "cables", "point_masses", "rigid_parts")
# Of what is given of an actuator in place of its force.
STROKE_UNITS = {"length": "m", "volume": "m3", "gas": "m3", "valve": "Pa", "displacement": "m"}
RIGID = "rigid"  # of a bar whose length stays, as that of a control
SWITCHINGS = ("energy", "oblique")  # energy-orthogonal, of any basis; of standard balanced truncation
FRAMES = ("fixed", "moving")  # a body stays near where it was made, or turns as far as it likes
DETAILS = ("full", "quasi-rigid")  # all terms of a moving frame, or the inertia of the rigid shape alone
FACES = "faces"
CONTACT_POINTS = ("nodes", "surface", FACES)  # what obstacles touch: nodes, fixed points between, or all of the surface
CONTACT_SWITCHINGS = ("automatic", "scene")  # the contact mode follows the obstacles, or the load history says


@dataclass(frozen=True)
class Load:
    """A load that acts by itself."""

    columns: int  # number of input columns
    signal: Signal | None  # what it does; None where that is to be given as a function of time


@dataclass(frozen=True)
class Guide:
    """Friction where a tendon turns."""

    tendon: str  # whose guide it is
    friction: float  # μ
    angle: float  # that it turns by at rest, rad


@dataclass(frozen=True)
class RigidMotion:
    """Poses and twists over time."""

    path: "BasePath | None"  # None where they are to be given as a function of time
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)  # the point whose position they say, m


@dataclass(frozen=True)
class MovingObstacle:
    """An obstacle, and its displacement (3,) from where the scene puts it, m; or, where it has one, its motion."""

    shape: "Obstacle"
    displacement: Signal
    motion: RigidMotion | None = None


@dataclass(frozen=True)
class AppliedLoad:
    """A force on a contact mode, or the input of an actuator, between two times."""

    contact: str | None  # by name; None where it is an actuator's
    actuator: str | None  # by name; None where it is a contact mode's
    start: float  # s
    stop: float  # s
    signal: Signal  # N (Pa of a pressure, m or m3 of a stroke), one number for each column


@dataclass(frozen=True)
class Run:
    """A load history."""

    dt: float  # time step, s
    duration: float  # s
    snapshots: int = 100  # how many whole shapes are kept, evenly spread
    loads: tuple[AppliedLoad, ...] = ()  # in the order in which they begin
    initial: "InitialState | None" = None  # where it begins; None: at rest
    every: int = 1  # steps from one instant that is kept to the next
    detail: str = "full"  # of a moving frame, one of DETAILS
    errors: bool = False  # whether a reduced run is to tell its error
    error_tolerance: float | None = None  # of its outputs, m: beyond it the run says so
    enrich: bool = False  # whether directions are added then


@dataclass(frozen=True)
class Environment:
    """What acts on a body.

    Attributes:
        effects: names of all effects that act, with their parameters in words.
        frame: "fixed", or "moving": the body turns as far as it likes, free or carried by a rigid base.
        base_path: of that base; None where it is given in Python, or there is none.
        has_inertia: whether the body has inertia; without it every step is an equilibrium.
        viscoelasticity: how its material relaxes; None: it is elastic. Equilibria are relaxed.
        loads: that act by signals of their own: gravity, base motions, prescribed forces; in the order of the columns.
        obstacles: by name.
        contact_law: how the body meets them; None where the scene names no contact.
        self_contact: contact modes whose surfaces touch one another and themselves.
        touches_faces: whether obstacles meet the faces between contact points, too.
        residual_compliance: whether contact points yield beyond a reduced basis, where its model knows how.
        contact_switching: "automatic" (the contact mode follows the obstacles) or "scene" (the load history says).
        guides: with friction, by the names of the loads that it is, those of each tendon from its anchor on.
        controls: of the actuators whose stroke is given, not their force: "length" of a tendon, "volume" of a chamber,
            "gas" or "valve" of one with gas; and "rigid" of bars, by the names of the loads that they are, whose
            strokes stay 0.
        gases: in these chambers, by name.
        chambers: volumes at rest behind those pressures whose surface encloses one, m³, which a mesh has.
        built_in: what a model made for this cannot do differently, by its place in the scene, as JSON; the mesh by the
            SHA-256 of its content.
        run: the load history; None where there is none.
        source: of the scene, for messages; empty of a model of matrices, which no scene stands behind.

    Example:
        >>> rom.environment.has_inertia, list(rom.environment.effects)
        (True, ['inertia', 'damping'])
        >>> from dataclasses import replace
        >>> undamped = replace(rom.environment, effects={"inertia": ""})
        >>> body = fr.Simulator(rom, dt=1e-3, scene=undamped)
    """

    effects: Mapping[str, str] = field(default_factory=dict)
    frame: str = "fixed"
    base_path: "BasePath | None" = None
    has_inertia: bool = True
    viscoelasticity: "PronySeries | None" = None
    loads: Mapping[str, Load] = field(default_factory=dict)
    obstacles: Mapping[str, MovingObstacle] = field(default_factory=dict)
    contact_law: "ContactLaw | None" = None
    self_contact: tuple[str, ...] = ()
    touches_faces: bool = False
    residual_compliance: bool = True
    contact_switching: str = "automatic"
    guides: Mapping[str, Guide] = field(default_factory=dict)
    controls: Mapping[str, str] = field(default_factory=dict)
    gases: "Mapping[str, Gas]" = field(default_factory=dict)
    chambers: Mapping[str, float] = field(default_factory=dict)
    built_in: Mapping[str, str] = field(default_factory=dict)
    run: Run | None = None
    source: str = ""

    @property
    def environment(self) -> "Environment":
        """Itself: an environment may stand wherever a scene may."""
        return self

    @property
    def is_of_scene(self) -> bool:
        """Whether a scene says what acts; of matrices nothing is known."""
        return bool(self.source)

    @property
    def is_moving(self) -> bool:
        """Whether the body turns as far as it likes."""
        return self.frame == "moving"

    @property
    def is_plain(self) -> bool:
        """Whether nothing acts but forces that are inputs, on an elastic body with inertia in a fixed frame."""
        found = self.contact_law is not None or self.finds_forces
        return self.has_inertia and not (self.is_moving or self.loads or found or self.viscoelasticity)

    @property
    def finds_forces(self) -> bool:
        """Whether forces of actuators are found in the step: by strokes, or friction at guides."""
        return bool(self.controls or self.guides)

    @property
    def turns_obstacles(self) -> bool:
        """Whether an obstacle is moved by poses."""
        return any(obstacle.motion is not None for obstacle in self.obstacles.values())

    @property
    def switches_itself(self) -> bool:
        """Whether the contact mode follows the obstacles."""
        return self.contact_law is not None and self.contact_switching == "automatic"

    @property
    def bars(self) -> tuple[str, ...]:
        """Names of the loads that are bars whose lengths stay: of surfaces that are rigid however far they turn."""
        return tuple(name for name, control in self.controls.items() if control == RIGID)

    @property
    def found_loads(self) -> tuple[str, ...]:
        """Names of the loads that are found in steps, at guides and in bars: they act within the body."""
        return (*self.guides, *self.bars)

    @property
    def inner_loads(self) -> tuple[str, ...]:
        """Names of the loads that act within the body, and turn with it: those that are found, and temperatures."""
        return (*self.found_loads, *self.temperatures)

    @property
    def temperatures(self) -> tuple[str, ...]:
        """Names of the loads that are temperatures."""
        return tuple(self.details("effects.temperature"))

    def with_chambers(self, volumes: Mapping[str, float]) -> "Environment":
        """The same with the volumes at rest of chambers; SceneError where one with gas has none."""
        gases = dict(self.gases)
        for name, gas in gases.items():
            if not gas.volume and name not in volumes:
                raise SceneError(
                    f"{self.source}: effects.pressure.{name}: its surface encloses no volume that is known, so that "
                    "gas in it has no pressure; use gas.volume, or a body reduced anew from this scene"
                )
            gases[name] = gas._replace(volume=gas.volume or volumes[name])
        return replace(self, gases=gases, chambers=volumes)

    def with_bars(self, names: Collection[str]) -> "Environment":
        """The same with bars of a body, which a mesh has, and no scene says."""
        loads, controls = dict.fromkeys(names, Load(1, NOTHING)), dict.fromkeys(names, RIGID)
        return replace(self, loads={**self.loads, **loads}, controls={**self.controls, **controls})

    def check_supports(self, rigid: int) -> None:
        """Checks that a body with so many rigid motions has an equilibrium, where it has no inertia.

        Raises:
            SceneError: it has none.
        """
        if not self.has_inertia and rigid:
            raise SceneError(
                f"{self.source}: effects: inertia is missing, and a body that nothing holds has no equilibrium"
            )

    def check_forces_given(self, what: str, *, may_rub: bool = False) -> None:
        """Checks that all forces of actuators are given, and none has to keep a surface rigid.

        Raises:
            SceneError: a stroke is, or a tendon rubs where it may not, and `what` needs forces.
        """
        if self.bars:
            raise SceneError(
                f"{self.source}: supports.rigid: {what} finds no forces that keep a surface rigid which turns far; "
                "use it without effects.large_deformation, or a part of a stiff material in its place"
            )
        if self.guides and not may_rub:
            raise SceneError(f"{self.source}: effects.tendon_friction: use tendons without friction in {what}")
        for name, control in self.controls.items():
            raise SceneError(
                f"{self.source}: actuator {name!r}: control = {control!r}: {what} needs forces as inputs; use "
                "an actuator that is given its force, and a ROM made so can be run by length or volume"
            )

    def details(self, place: str) -> dict[str, Any]:
        """What is built in at a place of the scene, such as "effects.tendon"; empty where there is nothing."""
        import json  # here: every import delays the runtime's start

        details: dict[str, Any] = json.loads(self.built_in.get(place, "{}"))
        return details

    @property
    def together(self) -> dict[str, tuple[str, ...]]:
        """Contact modes that are made of others, and of which: they have all their inputs, one after another."""
        parts = {name: tuple(patch.get("together") or ()) for name, patch in self.details("contacts").items()}
        return {name: of for name, of in parts.items() if of}

    def is_pulled(self, actuator: str) -> bool:
        """Whether it is a tendon whose tension is given."""
        return actuator in self.tendons and actuator not in self.controls

    @property
    def tendons(self) -> dict[str, np.ndarray]:
        """Points (K, 3) at rest that each tendon leads through, from its anchor to where it is pulled, m."""
        return {name: np.array(tendon["points"]) for name, tendon in self.details("effects.tendon").items()}

    @property
    def uniform_fields(self) -> dict[str, np.ndarray]:
        """Accelerations (3,), m/s², of 1 of each load that pulls all mass alike: gravity, and a base that is shaken."""
        gravity, fields = self.details("effects.gravity"), dict[str, np.ndarray]()
        if "gravity" in self.loads:
            fields["gravity"] = np.array(gravity.get("acceleration", np.zeros(3)), dtype=float)
        for name, motion in self.details("effects.base_motion").items():
            direction = np.array(motion["direction"], dtype=float)
            fields[name] = -direction / np.linalg.norm(direction)
        return fields

    @property
    def input_units(self) -> dict[str, str]:
        """Units of those inputs that are not N: pressures, gravity, base motions, and strokes."""
        units = self.force_units | {"gravity": "1"} | dict.fromkeys(self.details("effects.base_motion"), "m/s2")
        units |= dict.fromkeys(self.temperatures, "1")
        return units | {name: STROKE_UNITS.get(control, "m") for name, control in self.controls.items()}

    @property
    def force_units(self) -> dict[str, str]:
        """Units of what those actuators act with that do not act with N: pressures."""
        return dict.fromkeys(self.details("effects.pressure"), "Pa")

    def __repr__(self) -> str:
        lines = [f"Environment of {self.source or 'matrices'}: {', '.join(self.effects) or 'inputs alone'}"]
        acting = [
            f"{kind} {', '.join(names)}"
            for kind, names in (("loads", self.loads), ("obstacles", self.obstacles))
            if names
        ]
        if self.run is not None:
            acting.append(f"run of {self.run.duration:g} s at dt {self.run.dt:g} s")
        return "\n  ".join([*lines, *(["; ".join(acting)] if acting else [])])


class HasEnvironment(Protocol):
    """What a run may be told to take its environment from: a scene."""

    @property
    def environment(self) -> Environment:
        """What acts."""


def given_environment(scene: HasEnvironment) -> Environment:
    """That of what a caller gave as `scene`; SceneError where it has none."""
    environment = getattr(scene, "environment", None)
    if not isinstance(environment, Environment):
        raise SceneError(
            f"scene: something of type {type(scene).__name__} was given; use a Scene, as of "
            "fr.read_scene(file), and an Environment"
        )
    return environment


GRAVITY_SIGNAL = Signal(np.ones(1))  # multiples of the scene's acceleration
STANDS_STILL = Signal(np.zeros(3))  # an obstacle where the scene puts it, m
NOTHING = Signal(np.zeros(1))  # of a load that is found in the step
