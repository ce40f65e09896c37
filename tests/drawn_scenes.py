"""Draws a scene from a seed: a small box with any parts that bodies are made of, and how it is moved."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from bodies import box_arrays, write_arrays

from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.frame_motion import quaternion_of_vector

Array = np.ndarray

FRAMES = ("held", "carried", "free")
MATERIALS = ("st_venant_kirchhoff", "neo_hookean", "mooney_rivlin", "yeoh", "ogden")
CONSTANTS = {"mooney_rivlin": [0.8, 0.2], "yeoh": [1.0, 0.1, 0.02], "ogden": [0.7, 1.5, 0.3, -2.0]}
LAWS = ("linear", "relaxing", "large", "large, relaxing")
ACTUATORS = ("nothing", "tendon", "stroke", "guides", "pressure", "volume")
CONTACTS = ("nothing", "nothing", "smooth", "rough", "bouncing", "springs", "without residual compliance")
SHAPES = ("floor", "ceiling", "ball", "rod", "block")
STEPS = 20


@dataclass(frozen=True)
class Drawn:
    """A scene, and what moves it.

    Attributes:
        seed, frame, law, contact: what was drawn.
        text: of the scene.
        is_alone: whether nothing from outside acts on a free body.
        dt: s.
        has_inertia: whether the body has.
        stepper: of large deformation; None: the one that suits dt.
        pushes, pulls: of each step, (STEPS, 3) N on the contact mode and (STEPS, a) of actuators.
        modulus: Young's, times the volume, J.
        start: of a free body.
        speed: of the slowest eigenvectors when it starts, m/s.
        signals: of loads, obstacles and the base.
    """

    seed: int
    frame: str
    law: str
    contact: str
    text: str
    is_alone: bool
    dt: float
    has_inertia: bool
    stepper: str | None
    pushes: Array
    pulls: Array
    modulus: float
    start: BaseState | None
    speed: float
    signals: dict[str, Callable[[float], Array] | Array | float]

    @property
    def touches(self) -> bool:
        """Whether there are obstacles."""
        return self.contact != "nothing"


def drawn(seed: int, folder: Path) -> Drawn:
    """The scene of a seed; its mesh is written to a folder."""
    return _Draw(np.random.default_rng(seed), np.random.default_rng([seed, 1]), folder).scene(seed)


class _Draw:
    """Draws one scene; what came later is drawn beside, so that seeds keep their scenes."""

    def __init__(self, random: np.random.Generator, beside: np.random.Generator, folder: Path):
        self.random, self.beside, self.signals, self.effects = random, beside, {}, {}
        self.frame, self.law = self.one_of(FRAMES), self.one_of(LAWS)
        length = 10 ** random.uniform(-1.3, -0.5)
        # m, of numbers that TOML knows: arrays give others.
        self.size = [length, length * random.uniform(0.1, 0.5), length * random.uniform(0.06, 0.3)]
        long = random.integers(2, 4 if "large" in self.law else 5)
        bricks = (long, 1, 1) if "large" in self.law or self.chance(0.5) else (long, 1, 2)
        self.mesh = write_arrays(folder / "box.msh", *box_arrays(tuple(self.size), bricks, shake=0.2))
        self.young, self.density = 10 ** random.uniform(4.5, 6.5), random.uniform(500, 2000)
        self.inertia = self.law == "relaxing" or self.frame == "free" or self.chance(0.85)
        self.dt = 10 ** random.uniform(-5.0, np.log10(3e-2))
        self.duration = STEPS * self.dt
        self.force = (
            3 * self.young * self.size[1] * self.size[2] ** 3 / 12 / length**2 * 10 ** random.uniform(-2.5, -0.5)
        )
        self.speed = 0.3 * random.uniform() if self.inertia and self.chance(0.7) else 0.0
        self.reach = min(0.02 * length, 0.5 * self.duration)  # m, that obstacles and strokes may go in a run

    def chance(self, share: float) -> bool:
        return bool(self.random.uniform() < share)

    def one_of(self, names):
        return names[self.random.integers(len(names))]

    def vector(self, size: float) -> Array:
        return size * self.random.uniform(-1, 1, 3)

    def point(self, *shares: float) -> list[float]:
        """Within the box, by shares of its sides."""
        return np.multiply(self.size, shares).tolist()

    def scene(self, seed: int) -> Drawn:
        is_alone = self.frame == "free" and self.chance(0.4)
        contact = "nothing" if is_alone else self.one_of(CONTACTS)
        if not self.inertia and contact == "bouncing":
            contact = "rough"  # what has no speed does not bounce
        self.material_parts()
        self.inner_parts()
        if not is_alone:
            self.outer_parts()
        actuators = self.actuator_parts(is_alone)
        if contact != "nothing":
            self.contact_parts(contact)
        if self.frame == "carried" and self.chance(0.8):
            self.signals["base_path"] = partial(
                _whipped, self.vector(3 * self.reach), self.vector(min(0.3, 10 * self.duration)), 6 / self.duration
            )
        if "large" in self.law and not actuators and contact != "nothing":
            self.effects["gravity"] = f"acceleration = {self.vector(10.0).tolist()}"  # as training wants loads
        at = np.arange(1, STEPS + 1) / STEPS
        pulls = np.array([size * np.sin(np.pi / 2 * at) ** 2 for size in actuators]).T.reshape(STEPS, -1)
        pushes = np.zeros((STEPS, 3))
        if not is_alone and contact == "nothing":
            pushes = self.vector(self.force) * np.sin(2 * np.pi * self.random.uniform(0.2, 3) * at)[:, None]
        return Drawn(
            seed,
            self.frame,
            self.law,
            contact,
            self.text(contact, actuators),
            is_alone,
            self.dt,
            self.inertia,
            self.one_of((None, "newton", "linearly-implicit")) if "large" in self.law and self.inertia else None,
            pushes,
            pulls,
            self.young * float(np.prod(self.size)),
            self.thrown(contact) if self.frame == "free" else None,
            self.speed,
            self.signals,
        )

    def thrown(self, contact: str) -> BaseState:
        """Where a free body begins, with velocities that move it by its own thickness at most where it may touch."""
        spin = self.vector(min(0.3 / self.dt, 10.0))
        if contact != "nothing":
            spin *= min(1.0, self.size[2] / self.size[0] / (np.linalg.norm(spin) * self.duration + 1e-30))
        return BaseState(np.zeros(3), np.array([1.0, 0, 0, 0]), self.vector(0.5), spin)

    def material_parts(self) -> None:
        """Inertia, damping, and what the material does beside."""
        alpha, beta = self.random.uniform(0, 2) * self.chance(0.7), 10 ** self.random.uniform(-5, -2.5)
        if self.inertia:
            self.effects["inertia"] = ""
            self.effects["damping"] = f"alpha = {alpha}\nbeta = {beta}"
        if "relaxing" in self.law and self.inertia:
            ratios, times = self.random.uniform(0.1, 1, 2).tolist(), (10 ** self.random.uniform(-3, 0, 2)).tolist()
            self.effects["viscoelasticity"] = f"ratios = {ratios}\ntimes = {times}"
        if "large" in self.law:
            law = self.one_of(MATERIALS)
            constants = f"\nconstants = {CONSTANTS[law]}" if law in CONSTANTS else ""
            self.effects["large_deformation"] = f'material = "{law}"{constants}'

    def inner_parts(self) -> None:
        """What belongs to the body."""
        mass = self.density * np.prod(self.size)
        if self.inertia and self.chance(0.2):
            part = f"point = {self.point(1, 1, 1)}\nmass = {mass * self.random.uniform(0.05, 0.5)}"
            self.effects["point_masses.weight"] = part
        if self.inertia and self.chance(0.2):
            turns = f"\ninertia = {(mass * self.size[1] ** 2 * np.array([0.1, 0.12, 0.15])).tolist()}"
            place = f'surface = "right"\ncenter = {self.point(1.1, 0.5, 0.5)}'
            part = f"{place}\nmass = {mass * self.random.uniform(0.05, 0.5)}"
            self.effects["rigid_parts.plate"] = part + turns * self.chance(0.5)

    def outer_parts(self) -> None:
        """What acts on the body from outside, beside obstacles."""
        stiff = self.force / (0.1 * self.size[0])
        if self.chance(0.5):
            self.effects["gravity"] = f"acceleration = {self.vector(10.0).tolist()}"
        if self.chance(0.2):
            self.effects["springs.bed"] = f'surface = "{self.one_of(("top", "right"))}"\nstiffness = {stiff}'
        if self.inertia and self.chance(0.2):
            self.effects["damping.dashpots.oil"] = f'surface = "right"\ncoefficient = {0.03 * stiff}'
        if self.chance(0.3):
            self.effects["prescribed.push"] = f"point = {self.point(1, 1, 1)}\nforce = {[0.5 * self.force] * 3}"
            self.signals["push"] = partial(_swung, self.vector(0.5 * self.force), 5 / self.duration)
        if self.frame == "held" and self.chance(0.2) and self.inertia:
            self.effects["base_motion.quake"] = "direction = [1, 2, 0.5]\nacceleration = 5.0"
            self.signals["quake"] = partial(_swung, np.array(5.0), 8 / self.duration)

    def actuator_parts(self, is_alone: bool) -> list[float]:
        """Largest inputs of what was drawn, in the order of the system's."""
        kind = self.one_of(ACTUATORS[:4] if is_alone else ACTUATORS)  # pressure on a surface that is open is a push
        if kind == "nothing":
            return []
        area = self.size[0] * self.size[1]
        if kind in ("pressure", "volume"):
            held = self.frame != "free" and kind == "volume"  # a free body's volume is that of a closed chamber
            self.effects["pressure.air"] = 'surface = "top"' + '\ncontrol = "volume"' * held
            return [0.05 * self.reach * area if held else self.force / area]
        high = self.random.uniform(0, 1)
        points = [self.point(0, 0.5, high), self.point(0.5, 0.5, 1 - high), self.point(1, 0.5, high)]
        control = '\ncontrol = "length"' if kind == "stroke" else ""
        self.effects["tendon.rope"] = f"points = {points}{control}"
        if kind == "guides":
            self.effects["tendon_friction"] = f"coefficient = {self.random.uniform(0.05, 0.6)}"
        return [0.1 * self.reach if control else 3 * self.force]

    def contact_parts(self, kind: str) -> None:
        """Obstacles at most as far as the body may go; some of them move."""
        lines = {"bouncing": f"restitution = {self.random.uniform(0.1, 1)}"}
        lines["springs"] = f'method = "penalty"\nstiffness = {30 * self.force / self.size[0]}\ndamping = 1e-4'
        lines["without residual compliance"] = "residual_compliance = false"
        self.effects["contact"] = lines.get(kind, "")
        if kind != "smooth":
            self.effects["friction"] = f"coefficient = {self.random.uniform(0.05, 1)}"
        for name in self.random.permutation(SHAPES)[: self.random.integers(1, 4)]:
            gap = self.reach * self.one_of((0.0, 0.1, 0.5))
            self.effects[f"contact.obstacles.{name}"] = self.obstacle(name, gap)
            if self.chance(0.4):
                along = np.array([0.0, 0.0, -1.0 if name == "ceiling" else 1.0])
                self.signals[name] = partial(_approaching, self.reach * along, 4 / self.duration)

    def obstacle(self, name: str, gap: float) -> str:
        """Of a shape at a gap from the body."""
        long, wide, high = self.size
        middle, radius = [0.7 * long, 0.5 * wide], 0.3 * long
        if name == "ceiling":
            return f'shape = "half-space"\npoint = [0, 0, {high + gap}]\nnormal = [0, 0, -1]'
        if name == "floor":
            return f'shape = "half-space"\npoint = [0, 0, {-gap}]\nnormal = [0, 0, 1]'
        if name == "ball":
            return f'shape = "sphere"\ncenter = {[*middle, -gap - radius]}\nradius = {radius}'
        if name == "rod":
            ends = [[0.9 * long, end * wide, -gap - radius] for end in (-1, 2)]
            return f'shape = "capsule"\nstart = {ends[0]}\nend = {ends[1]}\nradius = {radius}'
        return f'shape = "box"\ncenter = {[*middle, -gap - radius / 2]}\nsize = {[radius] * 3}'

    def supports(self) -> str:
        """What holds the body; also rollers, and of small strains a plate that is glued to its end."""
        parts, share = ['clamped = ["left"]'] * (self.frame != "free"), self.beside.uniform(size=2)
        if "large" not in self.law:
            parts += ['rigid = ["right"]'] * bool(share[0] < 0.2)
        if self.frame != "free" and share[0] > 0.2 and share[1] < 0.2:
            parts += ['held = [{ surface = "front", normal = [0, 1, 0] }]']
        return "\n".join(parts)

    def text(self, contact: str, actuators: list[float]) -> str:
        """Of the scene, with the loads that it is trained by."""
        tables = {
            "mesh": f'file = "{self.mesh}"',
            "material": f"young = {self.young}\npoisson = {self.random.uniform(0.1, 0.45)}\ndensity = {self.density}",
            "supports": self.supports(),
            "contacts.tip": 'surface = "right"',
            "contacts.under": 'surface = "bottom"',
            "outputs.end": f"points = [{self.point(1, 1, 1)}]",
        } | {f"effects.{name}": text for name, text in self.effects.items()}
        loads = [f'actuator = "{"air" if "pressure.air" in self.effects else "rope"}"\nforce = {actuators}'] * bool(
            actuators
        )
        if contact == "nothing":
            loads.append(f'contact = "tip"\nforce = {[self.force] * 3}')
        tables["run"] = "\n[[run.load]]\n".join([f"dt = {self.dt}\nduration = {self.duration}", *loads])
        parts = [f"[{name}]\n{text}" for name, text in tables.items()]
        return "\n".join(['frame = "moving"' * (self.frame != "held"), *parts])


def _swung(size: Array, rate: float, time: float) -> Array:
    return size * np.sin(rate * time)


def _approaching(way: Array, rate: float, time: float) -> Array:
    return way * np.sin(rate * time / 2) ** 2


def _whipped(way: Array, turn: Array, rate: float, time: float) -> BaseState:
    """A base that goes and turns to and fro, and begins at rest."""
    there, speed = np.sin(rate * time / 2) ** 2, rate / 2 * np.sin(rate * time)
    return BaseState(there * way, quaternion_of_vector(there * turn), speed * way, speed * turn)
