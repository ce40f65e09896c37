"""The world file: TOML to a checked WorldScene."""

import math
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from fenics_rom.arguments import path_in
from fenics_rom.errors import SceneError, check_known, exactly
from fenics_rom.mechanics.load_history import is_whole
from fenics_rom.scene.certificate_checks import check_certificate_table
from fenics_rom.scene.consistency import check_choices
from fenics_rom.scene.file import mistake, read_scene, text_of, toml_of
from fenics_rom.scene.signal_tables import SignalTables, UnreadTables
from fenics_rom.scene.world_format import STANDS_STILL, WORLD_SHAPES, WorldBody, WorldFile, WorldScene

DIMENSIONS = {
    "half-space": (),
    "box": ("size",),
    "sphere": ("radius",),
    "capsule": ("radius", "length"),
    "cylinder": ("radius", "length"),
    "hull": ("points",),
    "mesh": ("file",),
}
OF_MESH = ("scale", "open")  # beside its file
MASSLESS = {"half-space": "a half-space", "mesh": "a mesh"}
OF_RIGID = ("density", "mass", "path", *OF_MESH, *sorted({key for keys in DIMENSIONS.values() for key in keys}))
_ADAPTER = TypeAdapter(WorldFile)
assert tuple(DIMENSIONS) == WORLD_SHAPES


def read_world(file: str | Path) -> WorldScene:
    """Reads a world file and the tables it names.

    Args:
        file: path of a TOML file; paths in it are relative to its folder.

    Raises:
        SceneError: the file cannot be read, or says something that is not allowed.

    Example:
        >>> fr.read_world("stack.toml").file.run.duration  # s
        1.0
    """
    path = path_in("read_world", file, SceneError)
    source = str(path)
    raw = toml_of(text_of(path), source)
    if "mesh" in raw and "bodies" not in raw:
        raise SceneError(f"{source}: is a scene, as it has a mesh, which fr.read_scene reads; use a world")
    return parse_world(raw, source, path.parent)


def parse_world(
    raw: Mapping[str, Any], source: str, folder: Path, given: Mapping[str, np.ndarray] | None = None
) -> WorldScene:
    """A world from the tables of its file; `given` are what the tables that it names hold, else they are read."""
    try:
        parsed = _ADAPTER.validate_python(raw, context=UnreadTables())
        _check(parsed)
        units = {each.get("table", ""): {"N"} for each in raw.get("run", {}).get("input", ())}
        tables = SignalTables(folder, given, units)
        parsed = _ADAPTER.validate_python(raw, context=tables)
    except ValidationError as error:
        raise SceneError(f"{source}: {mistake(error, WorldFile)}") from error
    except SceneError as error:
        raise SceneError(f"{source}: {error}") from error
    return WorldScene(parsed, folder, source, raw, tables.found)


def files_of_world(scene: WorldScene) -> tuple[Path, ...]:
    """All files that a world is read from, with those of its bodies; SceneError where a body's scene cannot be read."""
    bodies = scene.file.bodies.values()
    robots = [scene.folder / body.robot for body in bodies if body.robot is not None]
    roms = [scene.folder / body.rom for body in bodies if body.rom is not None]
    scenes = [read_scene(scene.folder / body.scene).files for body in bodies if body.scene is not None]
    certificate = scene.file.certificate
    limits = () if certificate is None or certificate.limits is None else (certificate.limits,)
    tables = [scene.folder / name for name in (*scene.tables, *limits)]
    return (Path(scene.source), *tables, *robots, *roms, *(file for files in scenes for file in files))


def _check(file: WorldFile) -> None:
    """What holds for several keys together."""
    check_choices(file, "")
    if not file.bodies:
        raise SceneError("bodies: at least one is needed, as [bodies.NAME]")
    for name, body in file.bodies.items():
        _check_body(name, body, file)
    soft = [name for name, body in file.bodies.items() if body.shape is body.robot is None]
    robots = [name for name, body in file.bodies.items() if body.robot is not None]
    for k, pair in enumerate(file.pairs):
        _check_names(set(pair.bodies), file.bodies, f"pairs[{k}].bodies")
    for k, group in enumerate(file.apart):
        _check_names(group, file.bodies, f"apart[{k}]")
    _check_pairs(file)
    for k, joint in enumerate(file.joints):
        where = f"joints[{k}]"
        _check_names((joint.first, joint.second), (*file.bodies, STANDS_STILL), where)
        if (joint.axis is not None) != (joint.kind == "hinge"):
            raise SceneError(f"{where}.axis: a hinge has one, and no other joint; this is a {joint.kind}")
        if joint.axis is not None and not any(joint.axis):
            raise SceneError(f"{where}.axis: use any direction but zero")
        if joint.surface is not None and joint.first not in soft:
            raise SceneError(
                f"{where}.surface = {joint.surface!r}: use that of a soft body, as the first "
                f"(got {joint.first!r}, which is rigid)"
            )
    _check_joint_times(file)
    if file.certificate is not None:
        check_certificate_table(file)
    if file.run is None:
        return
    if file.run.dt > file.run.duration:
        raise SceneError(f"run.dt = {exactly(file.run.dt)}: use at most the duration, {exactly(file.run.duration)} s")
    check_whole_steps(file.run.duration, file.run.dt, "run")
    for k, each in enumerate(file.run.input):
        if each.joint is not None:
            check_known("robot", each.joint.partition(".")[0], robots, SceneError, f"run.input[{k}].joint: ")
            if each.table is not None:
                raise SceneError(f"run.input[{k}].table: use a value for a joint; give an entry for each time")
        else:
            check_known("soft body", str(each.body), soft, SceneError, f"run.input[{k}].body: ")
        if (each.actuator is None) != (each.joint is not None):
            raise SceneError(f"run.input[{k}].actuator: goes with a body, and not with a joint")
        if each.stop is not None and each.stop <= each.start:
            raise SceneError(f"run.input[{k}].stop = {exactly(each.stop)}: use one after its start")


def check_whole_steps(duration: float, dt: float, where: str) -> None:
    """A SceneError where a run of `duration`, s, is no whole number of steps of dt, s."""
    if not is_whole(duration, dt):
        below = math.floor(duration / dt)
        ends = f"{below * dt:.9g} s" if below else "0 s"
        raise SceneError(
            f"{where}: a duration of {exactly(duration)} s is no whole number of steps of {exactly(dt)} s: {below} "
            f"end at {ends}, {below + 1} at {(below + 1) * dt:.9g} s; use one of these, or dt = "
            f"{duration / (below + 1):.9g}"
        )


def _check_joint_times(file: WorldFile) -> None:
    names = set[str]()
    for k, joint in enumerate(file.joints):
        if joint.name in names:
            raise SceneError(f"joints[{k}].name = {joint.name!r}: is that of another one: use a name of its own")
        if joint.name is not None:
            names.add(joint.name)
        if joint.stop is not None and joint.stop <= joint.start:
            raise SceneError(f"joints[{k}].stop = {exactly(joint.stop)}: use one after its start")
        if file.run is not None and joint.start >= file.run.duration:
            raise SceneError(
                f"joints[{k}].start = {exactly(joint.start)}: use one before the end of the run, "
                f"{exactly(file.run.duration)} s"
            )


def _check_pairs(file: WorldFile) -> None:
    """What laws of two bodies have no effect, or say two things."""
    named = dict[frozenset[str], int]()
    for k, pair in enumerate(file.pairs):
        where, bodies = f"pairs[{k}].bodies: {' and '.join(pair.bodies)}", frozenset(pair.bodies)
        if bodies in named:
            raise SceneError(f"{where}: are named in pairs[{named[bodies]}], too: use one law of two bodies")
        named[bodies] = k
        if len(bodies) == 1:
            if pair.bodies[0] not in file.bodies or file.bodies[pair.bodies[0]].shape is not None:
                raise SceneError(f"{where}: is rigid: use two bodies, or a soft one twice")
            continue
        for j, group in enumerate(file.apart):
            if bodies <= set(group):
                raise SceneError(f"{where}: do not touch one another, as apart[{j}] says: use one of both")
        for j, joint in enumerate(file.joints):
            if bodies == {joint.first, joint.second} and not joint.start and joint.stop is None:
                raise SceneError(f"{where}: are joined by joints[{j}], and what is joined does not touch: leave it out")
        if not any(name not in file.bodies or _moves(file.bodies[name]) for name in pair.bodies):
            raise SceneError(f"{where}: both stand still or follow a path, and do not push one another: leave it out")


def _moves(body: WorldBody) -> bool:
    return body.shape is None or body.robot is not None or body.density is not None or body.mass is not None


def _check_names(names: Collection[str], known: Collection[str], where: str) -> None:
    for name in names:
        if name.partition(".")[0] not in known:  # links of robots are looked at when these are read
            check_known("body", name, known, SceneError, f"{where}: ")
    if len(set(names)) < len(names):
        raise SceneError(f"{where}: use different bodies (got {', '.join(names)})")


def _check_body(name: str, body: WorldBody, file: WorldFile) -> None:
    where = f"bodies.{name}"
    if name == STANDS_STILL:
        raise SceneError(f"{where}: use any other name, as this is of what stands still")
    if body.robot is None and (body.positions or body.motors):
        raise SceneError(f"{where}.{'positions' if body.positions else 'motors'}: is of a robot, which this is not")
    if body.surface is not None and (body.on is None or body.shape is not None or body.robot is not None):
        raise SceneError(f"{where}.surface: is of a soft body that is on a link of a robot, by `on`")
    if body.robot is not None:
        if given := [key for key in (*OF_RIGID, "on") if getattr(body, key) is not None]:
            raise SceneError(f"{where}.{given[0]}: is of a body, and this is a robot, whose file says it")
        if any(body.velocity) or any(body.spin):
            raise SceneError(f"{where}: a robot begins at rest: leave out velocity and spin")
        return
    if body.shape is None:
        given = [key for key in OF_RIGID if getattr(body, key) is not None]
        if given:
            raise SceneError(
                f"{where}.{given[0]}: is of a rigid body, and this is a soft one; give it to one with a shape"
            )
        if body.on is not None:
            robot, dot, _ = body.on.partition(".")
            if dot and robot in file.bodies and file.bodies[robot].robot is not None:
                if body.surface is None:
                    raise SceneError(f"{where}.surface: is missing: which contact mode is welded to {body.on!r}")
                return
            check_known("body", body.on, file.bodies, SceneError, f"{where}.on: ")
            _check_carrier(name, body.on, file)
            if body.surface is not None:
                raise SceneError(f"{where}.surface: {body.on!r} is no link of a robot, and carries it by its supports")
        return
    if body.on is not None:
        raise SceneError(f"{where}.on: use what carries a soft body; a rigid one is joined, as [[joints]]")
    for key in OF_MESH:
        if body.shape != "mesh" and getattr(body, key) is not None:
            raise SceneError(f"{where}.{key}: a {body.shape} has none; give it to a mesh")
    for key in ("size", "radius", "length", "points", "file"):
        has, needs = getattr(body, key) is not None, key in DIMENSIONS[body.shape]
        if has != needs:
            allowed = ", ".join(DIMENSIONS[body.shape]) or "none"
            said = "is missing" if needs else f"a {body.shape} has none"
            raise SceneError(f"{where}.{key}: {said}; dimensions of a {body.shape}: {allowed}")
    has_mass = body.density is not None or body.mass is not None
    if has_mass and (body.path is not None or body.shape in MASSLESS):
        what = MASSLESS.get(body.shape, "a body that is moved along a path")
        raise SceneError(f"{where}.{'mass' if body.density is None else 'density'}: means nothing of {what}")
    if body.path is not None and (any(body.position) or any(body.rotation)):
        key = "position" if any(body.position) else "rotation"
        raise SceneError(f"{where}.{key}: has no effect beside a path, which says where the body is: leave it out")
    if not has_mass and (any(body.velocity) or any(body.spin)):
        raise SceneError(f"{where}: stands still or follows its path; velocity and spin go with density or mass")


def _check_carrier(name: str, on: str, file: WorldFile) -> None:
    chain, carrier = [name], on
    while carrier in file.bodies:
        chain.append(carrier)
        if carrier in chain[:-1]:
            raise SceneError(f"bodies.{name}.on: {' is on '.join(chain)}: use a chain without a circle")
        following = file.bodies[carrier].on
        if following is None:
            break
        carrier = following
    carrying = file.bodies[on]
    if carrying.shape is None or carrying.density is not None or carrying.mass is not None:
        raise SceneError(
            f"bodies.{name}.on = {on!r}: use a rigid body that stands still or follows a path, without mass; to "
            "others a free soft body is joined, as [[joints]]"
        )
