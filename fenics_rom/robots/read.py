"""Reads a robot from a URDF or MJCF file, as bodies and joints of a world."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fenics_rom.arguments import is_number, path_in
from fenics_rom.errors import MissingPackageError, SceneError, check_known, shown
from fenics_rom.mechanics.base_path import checked_base
from fenics_rom.robots.mujoco_model import MujocoModel
from fenics_rom.robots.records import Robot
from fenics_rom.robots.urdf import Urdf
from fenics_rom.robots.xml_lines import read_elements
from fenics_rom.world.drives import Motor
from fenics_rom.world.records import STILL, UPRIGHT, Vector


def read_robot(
    file: str | Path,
    name: str | None = None,
    *,
    position: Vector = STILL,
    rotation: Vector = UPRIGHT,
    positions: Mapping[str, float] | None = None,
    motors: Motor | Mapping[str, Motor] | None = None,
    touches_itself: bool = False,
) -> Robot:
    """Reads a robot from a URDF or MJCF file, by MuJoCo; pip install fenics-rom[robots].

    Args:
        file: .urdf or .xml.
        name: what names of its bodies and joints begin with; None: the name of the file.
        position, rotation: where the axes of its base are put, m and a unit quaternion w x y z.
        positions: of joints by name, rad or m, where it begins; of others that of the file.
        motors: of all joints that move, or by name, where "all" is of those that are not named. Those of an MJCF file
            are known. None pushes more than the file says that its joint bears.
        touches_itself: whether its links touch one another, but those that are joined.

    Raises:
        SceneError: the file cannot be read, or says something that is not allowed: with the line.
        MissingPackageError: MuJoCo is not installed.

    Example:
        >>> from fenics_rom.world.drives import Motor
        >>> robot = fr.read_robot("arm.urdf", motors=Motor("position", gain=100.0, damping=5.0))
        >>> world = fr.World(robot.bodies, 2e-3, joints=robot.joints, apart=robot.apart, gravity=(0, 0, -9.81))
        >>> world.step({"arm.j4": {"target": 0.5}})
        >>> world.joint_state("arm.j4").by_motor  # N m, by as much as its file says at most
        46.85...
    """
    path = path_in("read_robot", file, SceneError)
    try:
        text = path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(f"{path}: cannot be read: {error}") from error
    root, urdf = read_elements(text, str(path)), None
    if root.tag == "robot":
        urdf = Urdf(root, path.parent, str(path))
    elif root.tag != "mujoco":
        raise SceneError(f"{path}, line {root.line}: begins with <{root.tag}>: use <robot> (URDF), <mujoco> (MJCF)")
    try:
        import mujoco
    except ImportError as error:
        raise MissingPackageError("read_robot needs MuJoCo: pip install 'fenics-rom[robots]'") from error
    base = checked_base((position, rotation, STILL, STILL), "read_robot")
    model = MujocoModel(mujoco, path, root, urdf, (base.position, base.rotation))
    model.put(_positions(positions, model.joint_names))
    by_name = _motors(motors, model.moving_joints)
    return model.robot(path.stem if name is None else name, by_name, touches_itself)


def _positions(positions: Mapping[str, float] | None, known: Sequence[str]) -> dict[str, float]:
    given: dict[str, Any] = dict(positions or {})
    for name, value in given.items():
        check_known("joint", name, known, SceneError, "read_robot: positions: ")
        if not is_number(value):
            raise SceneError(f"read_robot: positions: {name!r} = {shown(value)}: use a finite number, rad or m")
    return given


def _motors(motors: Motor | Mapping[str, Motor] | None, names: Sequence[str]) -> dict[str, Motor]:
    if motors is None:
        return {}
    if isinstance(motors, Motor):
        return dict.fromkeys(names, motors)
    motors = dict(motors)
    if "all" in motors and "all" not in names:
        motors = dict.fromkeys(names, motors.pop("all")) | motors
    for name, motor in motors.items():
        check_known("joint", name, names, SceneError, "read_robot: motors: ")
        if not isinstance(motor, Motor):
            raise SceneError(f"read_robot: motors: {name!r}: use a Motor (got {shown(motor)})")
    return motors
