"""The scene file: TOML to a checked Scene.

The text and the tables of signals travel with the record.
"""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from fenics_rom.errors import FileError, SceneError, unknown
from fenics_rom.mechanics.environment import AppliedLoad, Run
from fenics_rom.mechanics.initial_state import ZERO, InitialState, Instant
from fenics_rom.scene.consistency import check_consistency, check_load, check_pushes
from fenics_rom.scene.effect_table import ACTUATORS
from fenics_rom.scene.effects import Effects
from fenics_rom.scene.file_format import Initial, SceneFile
from fenics_rom.scene.scene import Material, Scene
from fenics_rom.scene.signal_tables import SignalTables, unread_signal
from fenics_rom.scene.values import Refused, keys_of, part_of, refused, type_in
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
        tables: tables of signals by name, as they travel with a ROM; read from files below `folder` where this is None.
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
        return _scene(raw, text, folder, tables, source)
    except ValidationError as error:
        raise SceneError(f"{source}: {_mistake(error)}") from error
    except SceneError as error:
        raise SceneError(f"{source}: {error}") from error


def _scene(raw: dict[str, Any], text: str, folder: Path, given: Mapping[str, np.ndarray] | None, source: str) -> Scene:
    """Checks what the text says before any table is read, and makes the scene with the tables' signals."""
    file = _ADAPTER.validate_python(raw, context=unread_signal)
    check_consistency(file)
    _run(file, None)
    tables = SignalTables(folder, given)
    file = _ADAPTER.validate_python(raw, context=tables.signal)
    materials = {"material": file.material} if file.materials is None else file.materials
    return Scene(
        name=file.name,
        mesh_file=folder / file.mesh.file,
        degree=file.mesh.degree,
        mesh_groups=file.mesh.groups,
        mesh_scale=file.mesh.scale,
        materials={name: Material(**vars(material)) for name, material in materials.items()},
        clamped=file.supports.clamped,
        held=file.supports.held,
        contacts=file.contacts,
        actuators=file.actuators,
        outputs=file.outputs,
        readings=file.readings,
        effects=file.effects,
        reduction=file.reduction,
        run=_run(file, folder),
        text=text,
        tables=dict(sorted(tables.found.items())),
        source=source,
    )


def _run(file: SceneFile, folder: Path | None) -> Run | None:
    """The load history, checked; files of trajectories are read where a folder is given."""
    run = file.run
    if run is None:
        return None
    if run.dt > run.duration:
        raise SceneError(f"run.dt = {run.dt:g}: allowed is at most the duration, {run.duration:g} s")
    actuators = [*file.actuators, *(name for kind in ACTUATORS for name in getattr(file.effects, kind))]
    loads = []
    for k, load in enumerate(run.load):
        check_load(load, f"run.load[{k}]", run.duration, file.contacts, actuators)
        stop = run.duration if load.stop is None else load.stop
        loads.append(AppliedLoad(load.contact, load.actuator, load.start, stop, load.signal))
    check_pushes(loads, file.effects)
    loads.sort(key=lambda load: load.start)
    initial = None if run.initial is None else _initial(run.initial, file.effects, folder)
    return Run(run.dt, run.duration, run.snapshots, tuple(loads), initial)


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
        raise SceneError(f"{where}: {file} has no velocities; allowed is a run of this release")
    k = len(run.snapshot_times) - 1 if time is None else int(np.abs(run.snapshot_times - time).argmin())
    if time is not None and abs(run.snapshot_times[k] - time) > SAME_TIME * run.times[-1]:
        raise SceneError(
            f"run.initial.time = {time:g}: {file} has no snapshot then; the nearest is at {run.snapshot_times[k]:.9g} s"
        )
    return Instant(run.nodes, run.snapshots[k], run.velocities[k])


def _mistake(error: ValidationError) -> str:
    """The first mistake; a key that does not exist comes first, as it may be why another one is missing."""
    details = error.errors(include_url=False)
    detail = next((detail for detail in details if detail["type"] == UNKNOWN_KEY), details[0])
    *table, key = detail["loc"]
    if detail["type"] == UNKNOWN_KEY:
        record = SceneFile
        for part in table:
            record = part_of(record, part)
        return f"{_begun(table)}{unknown('key', str(key), keys_of(type_in(record)))}"
    if detail["type"] == "missing":
        return f"{_begun(table)}{key} is missing"
    refusal = detail.get("ctx", {}).get("error")
    if not isinstance(refusal, Refused):  # all that pydantic checks by itself is whether something is a table
        refusal = refused(detail["input"], "a table")
    return f"{_path(table[:-1] if key == '[key]' else detail['loc'])}{refusal}"


def _begun(table: list[int | str]) -> str:
    """The beginning of a sentence about a table; none of the whole file."""
    return f"{_path(table)}: " if table else ""


def _path(keys: list[int | str] | tuple[int | str, ...]) -> str:
    """Keys as TOML writes them, with numbers of list items in brackets."""
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys)[1:]
