"""ROM files of format 1.x, made ones of this release's format in memory.

They hold the text of their scene where files of today hold what follows from it. It was checked when it was written.
"""

import json
import re
import tomllib
from collections.abc import Mapping
from typing import Any

import h5py
import numpy as np

from fenics_rom.errors import FileError
from fenics_rom.io.hdf5 import get_text, put_text, rename_all
from fenics_rom.mechanics.contact import ContactLaw
from fenics_rom.mechanics.environment import (
    GRAVITY_SIGNAL,
    STANDS_STILL,
    AppliedLoad,
    Environment,
    Load,
    MovingObstacle,
    Run,
)
from fenics_rom.mechanics.obstacles import SHAPES
from fenics_rom.mechanics.signals import Signal
from fenics_rom.rom.environment_file import put_environment

NAMES = {
    "modes": "contact_models",
    "deformation/drag": "deformation/external_damping",
    "deformation/reach": "deformation/training_radius",
}
EFFECTS = (  # in the order of the table of effects
    *("inertia", "damping", "springs", "gravity", "base_motion", "prescribed", "pressure", "tendon"),
    *("large_deformation", "contact", "friction"),
)
SEVERAL = ("springs", "base_motion", "prescribed", "pressure", "tendon")  # that a scene names each
CHANGING = {  # what a run may have different from what a ROM was made with
    "base_motion": ("acceleration", "table"),
    "prescribed": ("force", "table"),
    "contact": ("restitution", "method", "stiffness", "damping", "switching", "obstacles"),
    "friction": ("coefficient",),
}
DEFAULTS: dict[str, dict[str, Any]] = {
    "damping": {"alpha": 0.0, "beta": 0.0},
    "large_deformation": {"material": "st_venant_kirchhoff"},
}
UNITS = {"alpha": "1/s", "beta": "s", "acceleration": "m/s2", "stiffness": "N/m", "damping": "N s/m"}

Said = Mapping[str, Any]


def upgrade(h5: h5py.File) -> None:
    """Gives everything its name of today, and the scene's environment its own place."""
    rename_all(h5, NAMES)
    text = re.sub(r"^(\s*)shapes(\s*=)", r"\1snapshots\2", get_text(h5, "scene"), flags=re.MULTILINE)
    if get_text(h5, "switching") == "modal":
        text = re.sub(r"^\s*method\s*=.*\n", "", text, flags=re.MULTILINE)
        text = re.sub(r"^(\s*)switching\s*=.*$", r'\1method = "eigenvector-selection"', text, flags=re.MULTILINE)
        put_text(h5, switching="energy", method="eigenvector-selection")
    put_text(h5, scene=text)
    try:
        scene: Said = tomllib.loads(text)
    except ValueError as error:
        raise FileError(f"its scene is not TOML: {error}") from error
    tables = {get_text(rows, "file"): rows[()] for rows in h5["tables"].values()}
    source = f"scene of ROM {get_text(h5, 'name')!r}" if scene else ""
    put_environment(h5, _environment(scene, tables, source))
    surfaces = h5.create_group("contact_surfaces", track_order=True)
    for name, model in h5["contact_models"].items():
        contact: Said = scene.get("contacts", {}).get(name, {})
        data = surfaces.create_dataset(name, data=_surface(h5, model, contact))
        put_text(data, unit="1")
    for group in ("effects", "tables"):
        del h5[group]


def _environment(scene: Said, tables: Mapping[str, np.ndarray], source: str) -> Environment:
    said = scene.get("effects", {})
    effects = {name: said[name] for name in EFFECTS if name in said}
    contact = effects.get("contact", {})
    materials: Said = {"body": scene["material"]} if "material" in scene else scene.get("materials", {})

    def signal(one: Said, key: str) -> Signal | None:
        if "table" in one:
            rows = tables[one["table"]]
            return Signal(rows[:, 1:].copy(), rows[:, 0].copy())
        return Signal(np.atleast_1d(np.array(one[key], dtype=float))) if key in one else None

    law = None
    if contact:
        law = ContactLaw(
            restitution=float(contact.get("restitution", 0.0)),
            friction=float(effects.get("friction", {}).get("coefficient", 0.0)),
            stiffness=contact.get("stiffness"),
            damping=float(contact.get("damping", 0.0)),
        )
    return Environment(
        effects={name: _words(one) for name, one in effects.items()},
        has_inertia="inertia" in effects or not scene,
        loads=(
            ({"gravity": Load(1, GRAVITY_SIGNAL)} if "gravity" in effects else {})
            | {name: Load(1, signal(one, "acceleration")) for name, one in effects.get("base_motion", {}).items()}
            | {name: Load(3, signal(one, "force")) for name, one in effects.get("prescribed", {}).items()}
        ),
        obstacles={
            name: MovingObstacle(_obstacle(one), signal(one, "") or STANDS_STILL)
            for name, one in contact.get("obstacles", {}).items()
        },
        contact_law=law,
        contact_switching=contact.get("switching", "automatic"),
        built_in={f"effects.{name}": _built_in(name, one) for name, one in effects.items()}
        | {f"materials.{name}": json.dumps(_plain(one), sort_keys=True) for name, one in materials.items()},
        run=_run(scene["run"], signal) if "run" in scene else None,
        source=source,
    )


def _run(run: Said, signal: Any) -> Run:
    loads = [
        AppliedLoad(
            contact=load.get("contact"),
            actuator=load.get("actuator"),
            start=float(load.get("start", 0.0)),
            stop=float(load.get("stop", run["duration"])),
            signal=signal(load, "force"),
        )
        for load in run.get("load", ())
    ]
    ordered = tuple(sorted(loads, key=lambda load: load.start))
    return Run(float(run["dt"]), float(run["duration"]), int(run.get("snapshots", 100)), ordered)


def _obstacle(one: Said) -> Any:
    dimensions = {key: value for key, value in one.items() if key not in ("shape", "table")}
    return SHAPES[one["shape"]](**{k: tuple(v) if isinstance(v, list) else v for k, v in dimensions.items()})


def _built_in(name: str, said: Said) -> str:
    """As scene.environment writes it."""

    def kept(one: Said) -> dict[str, Any]:
        defaults: Said = DEFAULTS.get(name, {})
        given = {key: _plain(value) for key, value in one.items() if key not in CHANGING.get(name, ())}
        return {key: value for key, value in given.items() if value != {} and defaults.get(key) != value}

    return json.dumps({n: kept(one) for n, one in said.items()} if name in SEVERAL else kept(said), sort_keys=True)


def _plain(value: Any) -> Any:
    """With all numbers as floats."""
    if isinstance(value, Mapping):
        return {key: _plain(part) for key, part in value.items()}
    if isinstance(value, list):
        return [_plain(part) for part in value]
    return float(value) if isinstance(value, int) else value


def _words(said: Said) -> str:
    """Parameters that are numbers, with their units."""
    numbers = {key: value for key, value in said.items() if isinstance(value, int | float | list) and key in UNITS}
    return ", ".join(
        f"{key} {value:g} {UNITS[key]}"
        if isinstance(value, int | float)
        else f"{key} ({', '.join(f'{part:g}' for part in value)}) {UNITS[key]}"
        for key, value in numbers.items()
    )


def _surface(h5: h5py.File, model: h5py.Group, contact: Said) -> np.ndarray:
    """Nodes of a contact mode's surface, as far as the file knows them."""
    if "contact_points" in model:
        return np.asarray(model["contact_points"][()], dtype=np.int64)
    near = contact.get("near")
    if near is None or not len(h5["nodes"]):
        return np.empty(0, dtype=np.int64)
    nodes, triangles = h5["nodes"][()], h5["triangles"][()]
    distance = np.linalg.norm(nodes[triangles].mean(axis=1) - near["point"], axis=1)
    return np.unique(triangles[distance <= near["radius"]]).astype(np.int64)
