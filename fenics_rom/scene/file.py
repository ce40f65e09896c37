"""The scene file: TOML to a checked Scene.

The text and the tables of signals travel with the record.
"""

import re
import tomllib
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from fenics_rom.arguments import path_in
from fenics_rom.errors import FileError, SceneError, did_you_mean, exactly, unknown
from fenics_rom.io.hdf5 import is_sealed
from fenics_rom.io.units import QUANTITIES
from fenics_rom.mechanics.environment import STROKE_UNITS, AppliedLoad, Run
from fenics_rom.mechanics.initial_state import ZERO, InitialState, Instant
from fenics_rom.mechanics.load_history import check_pull
from fenics_rom.mechanics.touch import TOUCH
from fenics_rom.scene.consistency import check_consistency, check_load, check_meshes, check_paths, check_pushes
from fenics_rom.scene.effect_table import ACTUATORS
from fenics_rom.scene.effects import Effects
from fenics_rom.scene.file_format import Initial, SceneFile
from fenics_rom.scene.scene import Material, Scene
from fenics_rom.scene.signal_tables import SignalTables, UnreadTables
from fenics_rom.scene.values import Refused, allowed_in, default_of, keys_of, part_of, refused, type_in
from fenics_rom.trajectory.comparison import SAME_TIME
from fenics_rom.trajectory.file import read_trajectory

LONGEST = 60_000  # bytes of a scene, which travels as an attribute of every ROM file
UNKNOWN_KEY = "unexpected_keyword_argument"  # pydantic's
_ADAPTER = TypeAdapter(SceneFile)


def read_scene(file: str | Path) -> Scene:
    """Reads a scene file and the tables it names.

    Args:
        file: path of a TOML file; paths in it are relative to its folder.

    Raises:
        SceneError: the file cannot be read, or says something that is not allowed.

    Example:
        >>> fr.read_scene("plate.toml").run.duration  # s
        3.0
    """
    path = path_in("read_scene", file, SceneError)
    text = text_of(path)
    scene = parse_scene(text, folder=path.parent, source=str(path))
    return replace(scene, read_files=(path, *scene.read_files))


def text_of(path: Path) -> str:
    """What is written in a scene file; SceneError where it cannot be read."""
    try:
        with path.open(encoding="utf-8-sig") as stream:  # some editors on Windows begin a file with a mark
            return stream.read(LONGEST + 1)  # no more: a device may have no end
    except FileNotFoundError as error:
        beside = sorted(map(str, path.parent.iterdir())) if path.parent.is_dir() else []
        same = [name for name in beside if Path(name).stem == path.stem]
        hint = f"; did you mean {same[0]!r}?" if same else did_you_mean(str(path), beside)
        raise SceneError(f"{path}: cannot be read: {error.strerror}{hint}") from error
    except (OSError, ValueError) as error:
        if isinstance(error, UnicodeDecodeError):
            what = "a ROM or a run, which info takes" if is_sealed(path) else f"no text in UTF-8, at byte {error.start}"
            raise SceneError(f"{path}: is {what}; use a scene file (TOML), saved as UTF-8") from error
        raise SceneError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error


def parse_scene(
    text: str, *, folder: Path = Path(), tables: Mapping[str, np.ndarray] | None = None, source: str = "scene"
) -> Scene:
    """Checks the text of a scene.

    Args:
        text: TOML.
        folder: what relative paths are relative to.
        tables: tables of signals by name, as they travel with a ROM; read from files below `folder` where this is None.
        source: name of the text in messages.

    Raises:
        SceneError: as `read_scene`.
    """
    raw = toml_of(text, source)
    if "bodies" in raw:
        raise SceneError(f"{source}: is a world, as it has bodies, which fr.read_world reads; use a scene")
    try:
        return _scene(raw, text, folder, tables, source)
    except ValidationError as error:
        raise SceneError(f"{source}: {mistake(error, SceneFile)}") from error
    except SceneError as error:
        raise SceneError(f"{source}: {error}") from error


def toml_of(text: str, source: str) -> dict[str, Any]:
    """The tables of a text; SceneError where it is no TOML, or too long."""
    if len(text.encode(errors="replace")) > LONGEST:
        raise SceneError(f"{source}: is too long; use at most {LONGEST} bytes; long force histories belong in tables")
    try:
        return tomllib.loads(text)
    except ValueError as error:  # TOMLDecodeError, and what Python says of numbers with thousands of digits
        raise SceneError(f"{source}: {_not_toml(text, str(error))}") from error
    except RecursionError as error:
        raise SceneError(f"{source}: is nested too deeply") from error


def _scene(raw: dict[str, Any], text: str, folder: Path, given: Mapping[str, np.ndarray] | None, source: str) -> Scene:
    """Checks what the text says before any table is read, and makes the scene with the tables' signals."""
    file = _ADAPTER.validate_python(raw, context=UnreadTables())
    check_consistency(file)
    _run(file, None)
    tables = SignalTables(folder, given, _load_units(raw, file))
    file = _ADAPTER.validate_python(raw, context=tables)
    check_paths(file)
    check_meshes(file)
    read = [*tables.found] if given is None else []
    if file.run is not None and file.run.initial is not None and file.run.initial.trajectory is not None:
        read.append(file.run.initial.trajectory)
    materials = {"material": file.material} if file.materials is None else file.materials
    return Scene(
        name=file.name,
        mesh_file=folder / file.mesh.file,
        degree=file.mesh.degree,
        integration=file.mesh.integration,
        mesh_groups=file.mesh.groups,
        mesh_scale=file.mesh.scale,
        materials={name: Material(**vars(material)) for name, material in materials.items()},
        frame=file.frame,
        clamped=file.supports.clamped,
        held=file.supports.held,
        rigid=file.supports.rigid,
        contacts={name: patch.joined(file.contacts) for name, patch in file.contacts.items()},
        actuators=file.actuators,
        outputs={name: entry.displacement for name, entry in file.outputs.items() if entry.quantity != TOUCH},
        readings={**file.readings, **{name: entry for name, entry in file.outputs.items() if entry.quantity == TOUCH}},
        effects=file.effects,
        reduction=file.reduction,
        run=_run(file, folder),
        text=text,
        tables=dict(sorted(tables.found.items())),
        source=source,
        read_files=tuple(folder / name for name in read),
    )


def _load_units(raw: dict[str, Any], file: SceneFile) -> dict[str, set[str]]:
    """Units of the numbers of tables that loads of the run name: of what is controlled, such as a pressure."""
    actuators = {name: actuator for kind in ACTUATORS for name, actuator in getattr(file.effects, kind).items()}
    units: dict[str, set[str]] = {}
    for given, load in zip(raw.get("run", {}).get("load", ()), () if file.run is None else file.run.load, strict=True):
        what = actuators[load.actuator].control if load.actuator in actuators else "force"
        units.setdefault(given.get("table", ""), set()).add(STROKE_UNITS.get(what) or QUANTITIES[what])
    return units


def _run(file: SceneFile, folder: Path | None) -> Run | None:
    """The load history, checked; files of trajectories are read where a folder is given."""
    run = file.run
    if run is None:
        return None
    if run.dt > run.duration:
        raise SceneError(f"run.dt = {exactly(run.dt)}: use at most the duration, {exactly(run.duration)} s")
    actuators = [*file.actuators, *(name for kind in ACTUATORS for name in getattr(file.effects, kind))]
    loads = []
    for k, load in enumerate(run.load):
        check_load(load, f"run.load[{k}]", run.duration, file.contacts, actuators)
        tendon = file.effects.tendon.get(load.actuator or "")
        if tendon is not None and tendon.control == "tension":
            check_pull(load.signal, f"run.load[{k}]: actuator {load.actuator!r}")
        stop = run.duration if load.stop is None else load.stop
        loads.append(AppliedLoad(load.contact, load.actuator, load.start, stop, load.signal))
    together = {name: patch.together for name, patch in file.contacts.items() if patch.together is not None}
    check_pushes(loads, file.effects, together)
    loads.sort(key=lambda load: load.start)
    initial = None if run.initial is None else _initial(run.initial, file.effects, folder)
    told: dict[str, Any] = {"errors": run.errors, "error_tolerance": run.error_tolerance, "enrich": run.enrich}
    return Run(run.dt, run.duration, run.snapshots, tuple(loads), initial, run.every, run.detail, **told)


def _initial(table: Initial, effects: Effects, folder: Path | None) -> InitialState:
    """Where a run begins, checked."""
    if table.time is not None and table.trajectory is None:
        raise SceneError("run.initial.time: goes with run.initial.trajectory")
    if effects.inertia is None:
        raise SceneError("run.initial: means nothing without inertia; name effects.inertia as well")
    motions = {name: getattr(table, name) or ZERO for name in ("translation", "rotation", "velocity", "spin")}
    instant = None
    if table.trajectory is not None and folder is not None:
        instant = _instant(folder / table.trajectory, table.time)
    return InitialState(table.shape == "equilibrium", instant, **motions)


def _instant(file: Path, time: float | None) -> Instant:
    """What a trajectory has at a snapshot."""
    where = "run.initial.trajectory"
    try:
        run = read_trajectory(file)
    except FileError as error:
        raise SceneError(f"{where}: {error}") from error
    if run.velocities is None:
        raise SceneError(f"{where}: {file} has no velocities; use a run of this release")
    k = len(run.snapshot_times) - 1 if time is None else int(np.abs(run.snapshot_times - time).argmin())
    if time is not None and abs(run.snapshot_times[k] - time) > SAME_TIME * run.times[-1]:
        raise SceneError(
            f"run.initial.time = {time:g}: {file} has no snapshot then; the nearest is at {run.snapshot_times[k]:.9g} s"
        )
    return Instant(run.nodes, run.snapshots[k], run.velocities[k])


def mistake(error: ValidationError, whole: type) -> str:
    """The first mistake in a file that a record describes.

    A key that does not exist comes first, as it may be why another one is missing.
    """
    details = error.errors(include_url=False)
    detail = next((detail for detail in details if detail["type"] == UNKNOWN_KEY), details[0])
    *table, key = detail["loc"]
    if detail["type"] == UNKNOWN_KEY:
        record = whole
        for part in table:
            record = part_of(record, part)
        return f"{_begun(table)}{unknown('key', str(key), keys_of(type_in(record)))}"
    if detail["type"] == "missing":
        return f"{_begun(table)}{key} is missing"
    refusal = detail.get("ctx", {}).get("error")
    if not isinstance(refusal, Refused):  # all that pydantic checks by itself is whether something is a table
        annotation: Any = whole
        for part in detail["loc"]:
            annotation = part_of(annotation, part)
        refusal = refused(detail["input"], _table_words(annotation, _path(detail["loc"])))
    return f"{_path(table[:-1] if key == '[key]' else detail['loc'])}{refusal}"


def _not_toml(text: str, error: str) -> str:
    """What is wrong with a text that is no TOML."""
    if text.startswith("$MeshFormat"):
        return "is a mesh; use a scene file (TOML), which names it as mesh.file"
    line = re.match(r"Cannot (?:declare|mutate) .*\(at line (\d+),", error)  # also where braces have closed a table
    header = text.split("\n")[int(line[1]) - 1].strip() if line else ""
    *keys, _ = header.strip("[]").split(".")
    for k, key in enumerate(keys, start=1):
        if line and re.search(rf"^\s*{re.escape(key)}\s*=\s*\{{", text, flags=re.M):
            closed = ".".join(keys[:k])
            return (
                f"line {line[1]}: {header} adds to {closed} = {{ ... }}, which is closed; write its keys in [{closed}]"
            )
    return f"is not TOML: {error}"


def _table_words(annotation: Any, where: str) -> str:
    """What a table holds, at least."""
    if not is_dataclass(type_in(annotation)):
        return f"a table for each name, [{where}.NAME]"
    keys = keys_of(type_in(annotation))
    needed = [field.name for field in fields(type_in(annotation)) if default_of(field) is MISSING] or [*keys]
    words = ", ".join(f"{key} ({allowed_in(keys[key])})" for key in needed)
    return f"a table, [{where}], of {words}" if words else "a table without keys, {}"


def _begun(table: list[int | str]) -> str:
    """The beginning of a sentence about a table; none of the whole file."""
    return f"{_path(table)}: " if table else ""


def _path(keys: list[int | str] | tuple[int | str, ...]) -> str:
    """Keys as TOML writes them, with numbers of list items in brackets."""
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys)[1:]
