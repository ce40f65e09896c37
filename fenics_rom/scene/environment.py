"""Scene to environment: what acts in a run, compiled once, so that no model has to read a scene."""

import json
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from fenics_rom.errors import SceneError
from fenics_rom.mechanics.contact import ContactLaw
from fenics_rom.mechanics.environment import GRAVITY_SIGNAL, STANDS_STILL, Environment, Load, MovingObstacle
from fenics_rom.mechanics.obstacles import SHAPES, Obstacle
from fenics_rom.mechanics.signals import Signal
from fenics_rom.scene.effects import EFFECTS
from fenics_rom.scene.scene import Scene


def environment_of(scene: Scene) -> Environment:
    """What acts in the runs of a scene.

    Raises:
        SceneError: an obstacle is not of its shape.
    """
    effects = scene.effects
    contact, law = effects.get("contact"), None
    if contact is not None:
        law = ContactLaw(
            restitution=contact["restitution"],
            friction=effects.get("friction", {"coefficient": 0.0})["coefficient"],
            stiffness=contact.get("stiffness"),
            damping=contact.get("damping", 0.0),
        )
    described = {} if contact is None else contact["obstacles"]
    return Environment(
        effects={name: words(name, said) for name, said in effects.items()},
        loads=(
            ({"gravity": Load(1, GRAVITY_SIGNAL)} if "gravity" in effects else {})
            | {n: Load(1, _signal(scene, one, "acceleration")) for n, one in effects.get("base_motion", {}).items()}
            | {n: Load(3, _signal(scene, one, "force")) for n, one in effects.get("prescribed", {}).items()}
        ),
        obstacles={
            name: MovingObstacle(
                obstacle_of(one, f"effects.contact.obstacles.{name}"), _signal(scene, one, "") or STANDS_STILL
            )
            for name, one in described.items()
        },
        contact_law=law,
        contact_switching="automatic" if contact is None else contact["switching"],
        built_in={f"effects.{name}": built_in(name, said) for name, said in effects.items()},
        run=scene.run,
        source=scene.source,
    )


def built_in(name: str, said: Mapping[str, Any]) -> str:
    """What a model has built in of an effect, as a text that is the same for the same model."""
    effect = EFFECTS[name]

    def kept(one: Mapping[str, Any]) -> dict[str, Any]:
        return {key: value for key, value in one.items() if key not in effect.changing and value not in (None, {})}

    return json.dumps({n: kept(one) for n, one in said.items()} if effect.several else kept(said), sort_keys=True)


def words(name: str, said: Mapping[str, Any]) -> str:
    """Parameters of an effect that are numbers, with their units."""
    numbers = EFFECTS[name].numbers
    shown = []
    for key, (unit, _) in numbers.items():
        if said.get(key) is not None:
            value = said[key]
            text = f"{value:g}" if isinstance(value, float) else f"({', '.join(f'{part:g}' for part in value)})"
            shown.append(f"{key} {text}" + (f" {unit}" if unit != "1" else ""))
    return ", ".join(shown)


def _signal(scene: Scene, one: Mapping[str, Any], key: str) -> Signal | None:
    """The signal that the scene gives: a constant, a table, or none."""
    if "table" in one:
        table = scene.tables[one["table"]]
        return Signal(table[:, 1:].copy(), table[:, 0].copy())
    value = one.get(key)
    return None if value is None else Signal(np.atleast_1d(np.array(value, dtype=float)))


def obstacle_of(given: Mapping[str, Any], where: str) -> Obstacle:
    """The obstacle that a scene describes.

    Raises:
        SceneError: what the shape needs is missing, or something is given that it does not have.
    """
    shape = SHAPES[given["shape"]]
    known = [field.name for field in fields(shape) if field.init]
    dimensions = {key: value for key, value in given.items() if key not in ("shape", "table")}
    for key in dimensions:
        if key not in known:
            raise SceneError(f"{where}: a {given['shape']} has {', '.join(known)}, but no {key}")
    try:
        made: Obstacle = shape(**dimensions)
    except (SceneError, TypeError) as error:
        missing = [key for key in known if key not in dimensions and key != "rotation"]
        raise SceneError(f"{where}: {f'{missing[0]} is missing' if missing else error}") from error
    return made
