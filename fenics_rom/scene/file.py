"""The scene file: TOML to a checked Scene.

The text and the force tables travel with the record (and with every ROM made from it), so that a ROM file can
be run without the scene file beside it.
"""

import csv
import itertools
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fenics_rom.errors import SceneError, unknown
from fenics_rom.mechanics.active_environment import obstacle
from fenics_rom.mechanics.environment import SWITCHINGS
from fenics_rom.scene.effects import ACTUATORS, ANY_SURFACE, EFFECTS, LOADS, POINT
from fenics_rom.scene.scene import (
    CUBATURE,
    LYAPUNOV,
    METHODS,
    ORDER,
    SHARE,
    TOLERANCE,
    WEIGHTINGS,
    Load,
    Material,
    Near,
    Output,
    Patch,
    Reduction,
    Run,
    Scene,
    check_order,
)
from fenics_rom.scene.schema import Many, Number, OneOf, Table, Text

_PLACE = ("surface", "near", "point")
LONGEST = 60_000  # bytes of a scene, which travels as an attribute of every ROM file

_MATERIAL = {
    "young": Number(above=0.0, unit="Pa"),
    "poisson": Number(above=-1.0, below=0.5),
    "density": Number(above=0.0, unit="kg/m3"),
}
_PATCH = Table(
    fields={
        **ANY_SURFACE,
        "force": Text(default="resultant", choices=("resultant", "normal", "nodal")),
    }
)
_LOAD = Table(
    fields={
        "contact": Text(default=None),
        "actuator": Text(default=None),
        "start": Number(default=0.0, at_least=0.0, unit="s"),
        "stop": Number(default=None, above=0.0, unit="s"),
        "force": Many(default=None, item=Number(unit="N"), at_least=1),
        "table": Text(default=None),
    }
)
SCENE = Table(
    fields={
        "name": Text(default="scene"),
        "mesh": Table(
            fields={
                "file": Text(),
                "degree": Number(default=1, at_least=1, at_most=2, integer=True),
                "groups": Table(default={}, each=Number(integer=True, at_least=0)),
            }
        ),
        "material": Table(default=None, fields=_MATERIAL),
        "materials": Table(default=None, each=Table(fields={**_MATERIAL, "cells": Text()})),
        "supports": Table(default={"clamped": ()}, fields={"clamped": Many(default=(), item=Text())}),
        "contacts": Table(each=_PATCH),
        "actuators": Table(default={}, each=_PATCH),
        "outputs": Table(
            default={},
            each=Table(fields={"points": Many(default=None, item=POINT, at_least=1), "surface": Text(default=None)}),
        ),
        "effects": Table(fields={name: effect.field for name, effect in EFFECTS.items()}),
        "reduction": Table(
            default={},
            fields={
                "method": Text(default=None, choices=METHODS),
                "switching": Text(default="energy", choices=SWITCHINGS),
                "order": OneOf(default=None, kinds=(ORDER, Table(each=ORDER))),
                "tolerance": replace(TOLERANCE, default=None),
                "weighting": Text(default="mass", choices=WEIGHTINGS),
                "lyapunov": Text(default="auto", choices=LYAPUNOV),
                "share": replace(SHARE, default=0.9999999),
                "cubature": replace(CUBATURE, default=0.01),
            },
        ),
        "run": Table(
            default=None,
            fields={
                "dt": Number(above=0.0, unit="s"),
                "duration": Number(above=0.0, unit="s"),
                "snapshots": Number(default=100, at_least=1, integer=True),
                "load": Many(default=(), item=_LOAD),
            },
        ),
    }
)


def read_scene(file: str | Path) -> Scene:
    """Reads a scene file and the force tables it names.

    Args:
        file: path of a TOML file; paths in it are relative to its folder.

    Raises:
        SceneError: the file cannot be read, or says something that is not allowed.

    Example:
        >>> fr.read_scene("plate.toml").run.duration  # s
        3.0
    """
    path = Path(file)
    try:
        with path.open(encoding="utf-8-sig") as stream:  # some editors on Windows begin a file with a mark
            text = stream.read(LONGEST + 1)  # no more: a device may have no end
    except (OSError, ValueError) as error:
        raise SceneError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    return parse_scene(text, folder=path.parent, source=str(path))


def parse_scene(
    text: str,
    *,
    folder: Path = Path(),
    tables: Mapping[str, np.ndarray] | None = None,
    source: str = "scene",
) -> Scene:
    """Checks the text of a scene.

    Args:
        text: TOML.
        folder: what relative paths are relative to.
        tables: force tables by name, as they travel with a ROM; read from files below `folder` where this is None.
        source: name of the text in messages.

    Raises:
        SceneError: as `read_scene`.
    """
    if len(text.encode(errors="replace")) > LONGEST:
        raise SceneError(f"{source}: is too long: bytes allowed are {LONGEST}; long force histories belong in tables")
    try:
        raw = tomllib.loads(text)
    except ValueError as error:  # TOMLDecodeError, and what Python says of numbers with thousands of digits
        raise SceneError(f"{source}: is not TOML: {error}") from error
    except RecursionError as error:
        raise SceneError(f"{source}: is nested too deeply") from error
    try:
        return _scene(SCENE.check(raw, ""), text, folder, tables, source)
    except SceneError as error:
        raise SceneError(f"{source}: {error}") from error


def _scene(t: dict[str, Any], text: str, folder: Path, tables: Mapping[str, np.ndarray] | None, source: str) -> Scene:
    contacts = {name: _patch(p, f"contacts.{name}") for name, p in t["contacts"].items()}
    if not contacts:
        raise SceneError("contacts: at least one contact mode is needed, as [contacts.NAME]")
    actuators = {name: _patch(p, f"actuators.{name}") for name, p in t["actuators"].items()}
    effects = {name: _given(value) for name, value in t["effects"].items() if value is not None}
    inputs = [*actuators, *(name for kind in ACTUATORS for name in effects.get(kind, ()))]
    _check_effects(effects, actuators)
    run = _run(t["run"], contacts, inputs) if t["run"] is not None else None
    if run and effects.get("contact", {}).get("switching") == "automatic" and any(load.contact for load in run.loads):
        raise SceneError(
            "effects.contact.switching = 'automatic': the contact mode follows the obstacles, so run.load can push "
            "with actuators only; allowed beside contacts in run.load is 'scene'"
        )
    columns = _tables_of_effects(effects)
    names = sorted({load.table for load in run.loads if load.table} | columns.keys()) if run else sorted(columns)
    if tables is None:
        tables = {name: _read_table(folder / name) for name in names}
    for name in names:
        _check_table(tables, name, columns.get(name))
    return Scene(
        name=t["name"],
        mesh_file=folder / t["mesh"]["file"],
        degree=t["mesh"]["degree"],
        mesh_groups=t["mesh"]["groups"],
        materials=_materials(t["material"], t["materials"]),
        clamped=t["supports"]["clamped"],
        contacts=contacts,
        actuators=actuators,
        outputs={name: _output(o, f"outputs.{name}") for name, o in t["outputs"].items()},
        effects=effects,
        reduction=_reduction(t["reduction"], contacts),
        run=run,
        text=text,
        tables=tables,
        source=source,
    )


def _exactly_one(table: Mapping[str, Any], keys: tuple[str, ...], where: str) -> None:
    given = [key for key in keys if table.get(key) is not None]
    if len(given) != 1:
        raise SceneError(f"{where}: give exactly one of {', '.join(keys)}; given: {', '.join(given) or 'none'}")


def _materials(single: dict[str, Any] | None, several: dict[str, Any] | None) -> dict[str, Material]:
    if (single is None) == (several is None):
        raise SceneError("give either [material] or [materials.NAME]")
    if single is not None:
        return {"material": Material(**single)}
    if not several:
        raise SceneError("materials: at least one [materials.NAME] is needed")
    return {name: Material(**m) for name, m in several.items()}


def _patch(t: dict[str, Any], where: str) -> Patch:
    _exactly_one(t, ("surface", "near"), where)
    return Patch(t["surface"], Near(**t["near"]) if t["near"] else None, t["force"])


def _output(t: dict[str, Any], where: str) -> Output:
    _exactly_one(t, ("points", "surface"), where)
    return Output(t["points"], t["surface"])


def _given(value: dict[str, Any]) -> dict[str, Any]:
    """What was said of an effect, defaults included; what stands for nothing is left out."""
    return {key: _given(item) if isinstance(item, dict) else item for key, item in value.items() if item is not None}


def _check_effects(effects: Mapping[str, Mapping[str, Any]], actuators: Mapping[str, Patch]) -> None:
    """What holds for several parameters, or for several effects, together."""
    for name in effects:
        for needed in EFFECTS[name].needs:
            if needed not in effects:
                raise SceneError(f"effects.{name}: means nothing without {needed}; name effects.{needed} as well")
    taken = dict.fromkeys(actuators, "actuators") | {"gravity": "effects"}
    for kind in (*LOADS, *ACTUATORS):
        for name in effects.get(kind, ()) if EFFECTS[kind].several else ():
            if name in taken:
                raise SceneError(f"effects.{kind}.{name}: the name is taken by {taken[name]}.{name}")
            taken[name] = f"effects.{kind}"
    for kind, keys in (("springs", _PLACE[:2]), ("pressure", _PLACE[:2]), ("prescribed", _PLACE)):
        for name, one in effects.get(kind, {}).items():
            _exactly_one(one, keys, f"effects.{kind}.{name}")
    for name, one in effects.get("damping", {}).get("dashpots", {}).items():
        _exactly_one(one, _PLACE[:2], f"effects.damping.dashpots.{name}")
    for kind, key in (("prescribed", "force"), ("base_motion", "acceleration")):
        for name, one in effects.get(kind, {}).items():
            if key in one and "table" in one:
                raise SceneError(f"effects.{kind}.{name}: give {key} or table, not both")
    for name, one in effects.get("base_motion", {}).items():
        if not any(one["direction"]):
            raise SceneError(f"effects.base_motion.{name}.direction: allowed is any but zero")
    if "contact" in effects:
        _check_contact(effects)


def _check_contact(effects: Mapping[str, Mapping[str, Any]]) -> None:
    contact = effects["contact"]
    if not contact["obstacles"]:
        raise SceneError("effects.contact.obstacles: at least one is needed, as [effects.contact.obstacles.NAME]")
    for name, one in contact["obstacles"].items():
        obstacle(one, f"effects.contact.obstacles.{name}")
    penalty = contact["method"] == "penalty"
    if penalty and "stiffness" not in contact:
        raise SceneError("effects.contact.stiffness is missing: the spring of method = 'penalty' at every point, N/m")
    for key in ("stiffness", "damping"):
        if key in contact and not penalty:
            raise SceneError(f"effects.contact.{key}: goes with method = 'penalty'; a rigid obstacle has none")
    if contact["restitution"] and (penalty or "inertia" not in effects):
        raise SceneError("effects.contact.restitution: goes with inertia and method = 'complementarity'")


def _tables_of_effects(effects: Mapping[str, Mapping[str, Any]]) -> dict[str, int]:
    """Tables that effects name, with the number of columns beside the time."""
    columns: dict[str, int] = {}
    of_kinds = [(kind, effects.get(kind, {}), width) for kind, width in (("prescribed", 3), ("base_motion", 1))]
    for kind, several, width in (*of_kinds, ("obstacles", effects.get("contact", {}).get("obstacles", {}), 3)):
        for name, one in several.items():
            table = one.get("table")
            if table is not None and columns.setdefault(table, width) != width:
                raise SceneError(f"effects: table {table} of {kind}.{name} is used with other columns elsewhere")
    return columns


def _reduction(t: dict[str, Any], contacts: Mapping[str, Patch]) -> Reduction:
    if t.get("order") is not None and t.get("tolerance") is not None:
        raise SceneError("reduction: give order or tolerance, not both")
    check_order(t.get("order"), contacts, "reduction.order")
    return Reduction(**t)


def _run(t: dict[str, Any], contacts: Mapping[str, Patch], actuators: Sequence[str]) -> Run:
    if t["dt"] > t["duration"]:
        raise SceneError(f"run.dt = {t['dt']:g}: allowed is at most the duration, {t['duration']:g} s")
    loads = [_load(load, k, t["duration"], contacts, actuators) for k, load in enumerate(t["load"])]
    pushes = sorted((load for load in loads if load.contact), key=lambda load: load.start)
    for first, second in itertools.combinations(pushes, 2):
        if second.start < first.stop and second.contact != first.contact:
            raise SceneError(
                f"run.load: {first.contact!r} acts until {first.stop:g} s and {second.contact!r} from "
                f"{second.start:g} s, but one contact mode acts at a time; make a contact mode of both surfaces"
            )
    return Run(t["dt"], t["duration"], t["snapshots"], tuple(sorted(loads, key=lambda load: load.start)))


def _load(
    t: dict[str, Any],
    k: int,
    duration: float,
    contacts: Mapping[str, Patch],
    actuators: Sequence[str],
) -> Load:
    where = f"run.load[{k}]"
    _exactly_one(t, ("contact", "actuator"), where)
    _exactly_one(t, ("force", "table"), where)
    if t["contact"] is not None and t["contact"] not in contacts:
        raise SceneError(f"{where}.contact: {unknown('contact mode', t['contact'], contacts)}")
    if t["actuator"] is not None and t["actuator"] not in actuators:
        raise SceneError(f"{where}.actuator: {unknown('actuator', t['actuator'], list(actuators))}")
    if t["start"] >= duration:
        raise SceneError(f"{where}.start = {t['start']:g}: allowed is less than the run's duration, {duration:g} s")
    load = Load(**{**t, "stop": duration if t["stop"] is None else t["stop"]})
    if load.stop <= load.start:
        raise SceneError(f"{where}.stop = {load.stop:g}: allowed is more than start, {load.start:g} s")
    return load


def _read_table(file: Path) -> np.ndarray:
    """Times and forces from a CSV file whose first row names the columns."""
    try:
        if file.exists() and not file.is_file():  # a device may have no end, a pipe no beginning
            raise SceneError(f"force table {file}: cannot be read: is a folder or a device")
        with file.open(newline="", encoding="utf-8-sig") as stream:
            rows = [row for row in csv.reader(stream) if row]
    except (OSError, ValueError, csv.Error) as error:
        raise SceneError(f"force table {file}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    if not rows or all(_is_number(cell) for cell in rows[0]):
        raise SceneError(f"force table {file}: its first row must name the columns, such as: time, x, y, z")
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(rows[0]):
            raise SceneError(f"force table {file}: row {number} has {len(row)} columns, the first has {len(rows[0])}")
        for cell in row:
            if not _is_number(cell):
                raise SceneError(f"force table {file}: row {number}: {cell!r} is not a number")
    return np.array([[float(cell) for cell in row] for row in rows[1:]], dtype=float)


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _check_table(tables: Mapping[str, np.ndarray], name: str, columns: int | None) -> None:
    if name not in tables:
        raise SceneError(f"force table {name}: did not come with the scene")
    table = tables[name]
    if table.ndim != 2 or table.shape[0] < 2 or table.shape[1] < 2:
        raise SceneError(f"force table {name}: allowed are two or more rows: time in s, forces in N")
    if not np.isfinite(table).all() or (np.diff(table[:, 0]) <= 0).any():
        raise SceneError(f"force table {name}: allowed are finite numbers and strictly increasing times")
    if columns is not None and table.shape[1] != 1 + columns:
        raise SceneError(
            f"table {name}: columns beside the time: given {table.shape[1] - 1}, allowed {columns} for what uses it"
        )
