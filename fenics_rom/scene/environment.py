"""Effects to environment: what acts in a run, compiled once, so that no model has to read a scene."""

import json
from collections.abc import Collection, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from fenics_rom.errors import SceneError
from fenics_rom.mechanics.contact import ContactLaw
from fenics_rom.mechanics.environment import (
    FACES,
    GRAVITY_SIGNAL,
    NOTHING,
    STANDS_STILL,
    STROKE_UNITS,
    Environment,
    Guide,
    Load,
    MovingObstacle,
    RigidMotion,
    Run,
)
from fenics_rom.mechanics.gas import GAS_CONTROLS, Gas
from fenics_rom.mechanics.obstacles import SHAPES, Obstacle, dimensions_of
from fenics_rom.mechanics.tendon import turning_angles
from fenics_rom.mechanics.viscoelasticity import PronySeries
from fenics_rom.scene.chambers import ChamberGas
from fenics_rom.scene.contact import RigidObstacle
from fenics_rom.scene.effect_table import ACTUATORS, EFFECTS, numbers_of
from fenics_rom.scene.effects import Effects
from fenics_rom.scene.values import default_of

MESH_KEYS = ("file", "scale", "position", "rotation", "open")
OPTIONAL = MESH_KEYS[1:]  # and of a box its rotation
MOVING = ("shape", "table", "motion")  # keys that describe no shape, or say which


def environment_of(effects: Effects, frame: str, run: Run | None, source: str) -> Environment:
    """What acts in the runs of a scene of that frame and source; SceneError where an obstacle is not of its shape."""
    contact, viscous, numbers = effects.contact, effects.viscoelasticity, numbers_of(effects)
    obstacles = {} if contact is None else contact.obstacles
    return Environment(
        effects={name: words(name, numbers[name]) for name in effects.names},
        frame=frame,
        base_path=None if effects.base_path is None else effects.base_path.table,
        has_inertia=effects.inertia is not None,
        viscoelasticity=None if viscous is None else PronySeries(viscous.ratios, viscous.times),
        loads=(
            ({} if effects.gravity is None else {"gravity": Load(1, GRAVITY_SIGNAL)})
            | {name: Load(1, motion.signal) for name, motion in effects.base_motion.items()}
            | {name: Load(3, force.signal) for name, force in effects.prescribed.items()}
            | {name: Load(1, temperature.signal) for name, temperature in effects.temperature.items()}
            | {name: Load(1, NOTHING) for name in guides_of(effects)}
        ),
        obstacles={
            name: MovingObstacle(
                obstacle_of(described, f"effects.contact.obstacles.{name}"),
                described.table or STANDS_STILL,
                None if described.motion is None else RigidMotion(described.motion.table, described.motion.origin),
            )
            for name, described in obstacles.items()
        },
        contact_law=None if contact is None else _contact_law(effects),
        self_contact=() if contact is None else contact.self_contact,
        touches_faces=contact is not None and contact.points == FACES,
        residual_compliance=contact is None or contact.residual_compliance,
        contact_switching="automatic" if contact is None else contact.switching,
        guides=guides_of(effects),
        controls={
            name: actuator.control
            for kind in ACTUATORS
            for name, actuator in getattr(effects, kind).items()
            if actuator.control in STROKE_UNITS
        },
        gases=gases_of(effects),
        built_in={f"effects.{name}": built_in(name, getattr(effects, name)) for name in effects.names},
        run=run,
        source=source,
    )


def gases_of(effects: Effects) -> dict[str, Gas]:
    """What chambers are filled with, by name."""
    gases = dict[str, Gas]()
    for name, pressure in effects.pressure.items():
        if pressure.control in GAS_CONTROLS:
            of, valve = pressure.gas or ChamberGas(), pressure.valve
            through = () if valve is None else (valve.area * valve.discharge, valve.temperature)
            gases[name] = Gas(of.volume or 0.0, of.exponent, of.ambient, *through)
    return gases


def guides_of(effects: Effects) -> dict[str, Guide]:
    """Guides with friction, by the names of their loads; those of each tendon from its anchor on."""
    if effects.tendon_friction is None:
        return {}
    μ = effects.tendon_friction.coefficient
    return {
        f"{name}-guide-{number}": Guide(name, μ, float(angle))
        for name, tendon in effects.tendon.items()
        for number, angle in enumerate(turning_angles(np.array(tendon.points)), start=1)
    }


def _contact_law(effects: Effects) -> ContactLaw:
    contact, friction = effects.contact, effects.friction
    assert contact is not None
    return ContactLaw(
        restitution=contact.restitution,
        friction=0.0 if friction is None else friction.coefficient,
        stiffness=contact.stiffness,
        damping=contact.damping or 0.0,
    )


def built_in(name: str, effect: Any) -> str:
    """What a model has built in of an effect, as a text that is the same for the same model."""
    return as_text(effect, EFFECTS[name].law.changing)


def as_text(record: Any, changing: Collection[str] = ()) -> str:
    """What a record says, but for what may change and for defaults: JSON that is the same for the same record."""

    def given(value: Any) -> Any:
        if is_dataclass(value):
            parts = {field.name: getattr(value, field.name) for field in fields(value)}
            usual = {field.name: default_of(field) for field in fields(value)}
            return {key: given(part) for key, part in parts.items() if key not in changing and part != usual[key]}
        if isinstance(value, Mapping):
            return {key: given(part) for key, part in value.items()}
        return [given(part) for part in value] if isinstance(value, list | tuple) else value

    return json.dumps(given(record), sort_keys=True)


def words(name: str, numbers: Mapping[str, Any]) -> str:
    """Parameters of an effect that are numbers, with their units."""
    shown = []
    for key, value in numbers.items():
        unit, _ = EFFECTS[name].numbers[key]
        text = f"{value:g}" if isinstance(value, float) else f"({', '.join(f'{part:g}' for part in value)})"
        shown.append(f"{key} {text}" + (f" {unit}" if unit != "1" else ""))
    return ", ".join(shown)


def obstacle_of(described: RigidObstacle, where: str) -> Obstacle:
    """The obstacle described; SceneError where something is missing, or is given that the shape does not have."""
    known = MESH_KEYS if described.shape == "mesh" else tuple(dimensions_of(described.shape))
    given = {field.name: getattr(described, field.name) for field in fields(described)}
    dimensions = {key: value for key, value in given.items() if key not in MOVING and value is not None}
    for key in dimensions:
        if key not in known:
            raise SceneError(f"{where}: a {described.shape} has {', '.join(known)}, but no {key}")
    missing = [key for key in known if key not in dimensions and key not in OPTIONAL]
    if missing:
        raise SceneError(f"{where}: {missing[0]} is missing")
    if described.shape == "mesh":
        vertices, triangles = dimensions.pop("file").joined(dimensions.pop("scale", 1.0))
        dimensions |= {"vertices": vertices, "triangles": triangles}
    try:
        obstacle: Obstacle = SHAPES[described.shape](**dimensions)
    except SceneError as error:
        raise SceneError(f"{where}: {error}") from error
    return obstacle
