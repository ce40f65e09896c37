"""A body or a world between messages: what comes in drives it, each cycle takes steps, and what it feels goes out.

Nothing here imports ROS: messages are objects with the fields of their definitions, made by what is given.
"""

import re
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy import ndarray as Array

import fenics_rom as fr
from fenics_rom.arguments import is_number
from fenics_rom.errors import StepError, check_known, shown
from fenics_rom.mechanics.base_path import BASE_PATH, given_base
from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.mechanics.touch import TouchReading
from fenics_rom.world.soft import Soft
from fenics_rom_ros import messages
from fenics_rom_ros.follower import Follower
from fenics_rom_ros.messages import SECOND, Make, MessageError

PARAMETERS: dict[str, Any] = {  # of the node, with their defaults
    "file": "",  # a ROM, or a world (.toml)
    "base_frame": "world",  # the frame that poses come in, and clouds and transforms go out
    "rate": 100.0,  # Hz, of cycles
    "dt": 0.0,  # s, of a step; 0: that of the file's run
    "surface": "",  # that clouds have: a contact mode; empty: the whole skin
    "speed": 2.0,  # m/s, at most, of a body that follows poses
    "turning": 10.0,  # rad/s
}
JOINTS = "joint_states"
BODY, BASE = "body", "base"  # of a ROM: its own name, and that of what carries it
MOST_CYCLES = 2  # that one call makes up for; later ones are left out
FIELD_OF = {"position": "position", "velocity": "velocity", "torque": "effort"}  # of JointState, by the kind of motor


class Bridge:
    """One body or world at real time.

    Args:
        make: makes a message of the name of its type and its fields.
        others: see PARAMETERS.

    Attributes:
        world: what is stepped.
        inputs: of each topic the type, and what takes its messages, which raises MessageError.
        outputs: of each topic the type.
        late: how many calls came a cycle or more too late.
        left_out: time that was not simulated, as calls came too late, s.
        told: what the user should know, since it was last emptied.

    Raises:
        FenicsRomError: a file that cannot be read, or parameters that do not fit it.
    """

    def __init__(
        self,
        file: str,
        *,
        make: Make,
        base_frame: str = "world",
        rate: float = 100.0,
        dt: float = 0.0,
        surface: str = "",
        speed: float = 2.0,
        turning: float = 10.0,
    ):
        if not file:
            raise MessageError("file: use the name of a ROM, or of a world that ends in .toml (got none)")
        for name, value in {"rate": rate, "speed": speed, "turning": turning}.items():
            if not (is_number(value) and value > 0):
                raise MessageError(f"{name}: use a finite number > 0 (got {shown(value)})")
        if not re.fullmatch(r"[^/\s]\S*", base_frame):
            raise MessageError(f"base_frame: use a name that does not begin with a slash (got {shown(base_frame)})")
        self._make, self._frame, self._fastest = make, base_frame, (speed, turning)
        read = _read_world if file.endswith(".toml") else _read_rom
        self.world, self._followers = read(file, dt)
        self._steps = round(1 / (rate * self.world.dt))
        self._cycle = self._steps * self.world.dt
        if not self._steps or abs(self._cycle * rate - 1) > 1e-9:
            fits = 1 / (max(self._steps, 1) * self.world.dt)
            text = f"a cycle is a whole number of steps of {self.world.dt:g} s"
            raise MessageError(f"rate: {text}; use {fits:.9g} Hz (got {rate:g})")
        soft = [name for name, record in self.world.bodies.items() if isinstance(record, fr.SoftBody)]
        self._soft = {name: self.world.simulator(name) for name in soft}
        self._nodes = {name: _surface_nodes(name, body, surface) for name, body in self._soft.items()}
        self._senses = {
            (name, sense): topic_of(f"{name}/taxels/{sense}")
            for name, body in self._soft.items()
            for sense, reading in body.rom.readings.items()
            if isinstance(reading, TouchReading) and reading.map.grid.all()
        }
        self._targets = _targets(self.world, self._soft)
        self._given: dict[str, dict[str, float]] = {}
        self._stamps: dict[Any, int] = {}
        self._start: int | None = None  # ns, when the world's time was 0, if it had kept up
        self._cycles, self._heard = 0, set[str]()
        self.late, self.left_out, self.told = 0, 0.0, list[str]()
        self.inputs: dict[str, tuple[str, Callable[[Any], None]]] = {
            topic_of(f"{name}/pose"): ("geometry_msgs/msg/PoseStamped", partial(self.take_pose, name))
            for name in self._followers
        }
        if self._targets:
            self.inputs[JOINTS] = "sensor_msgs/msg/JointState", self.take_joints
        self.outputs = {"/tf": "tf2_msgs/msg/TFMessage"}
        for name in self._soft:
            self.outputs[topic_of(f"{name}/wrench")] = "geometry_msgs/msg/WrenchStamped"
            self.outputs[topic_of(f"{name}/points")] = "sensor_msgs/msg/PointCloud2"
        self.outputs |= dict.fromkeys(self._senses.values(), "sensor_msgs/msg/Image")

    def take_joints(self, message: Any) -> None:
        """Takes targets of motors and inputs of actuators from a sensor_msgs/JointState, until the next one.

        A motor has its position, velocity or effort, as its kind is; an actuator its effort, N or Pa, or of one whose
        stroke is given its position, m or m³.
        """
        names = list(message.name)
        self._check_stamp(message, JOINTS, (JOINTS, *names))
        given: list[tuple[str, str, float]] = []
        for number, name in enumerate(names):
            where = f"{JOINTS}: {name!r}"
            check_known("joint or actuator", name, self._targets, MessageError, f"{JOINTS}: ")
            target = self._targets[name]
            if target is None:
                self._tell(f"{where} has no motor: what is said of it is not used")
                continue
            of, key, field = target
            values = getattr(message, field)
            if len(values) != len(names) or not is_number(value := float(values[number])):
                raise MessageError(f"{where}: {field}: use a finite number for each name (got {shown(list(values))})")
            given.append((of, key, value))
        for of, key, value in given:
            self._given.setdefault(of, {})[key] = value

    def take_pose(self, name: str, message: Any) -> None:
        """Has a body that is driven, a base or an obstacle, follow a geometry_msgs/PoseStamped."""
        check_known("body that is driven", name, self._followers, MessageError)
        if message.header.frame_id != self._frame:
            raise MessageError(
                f"{name}: frame_id: use {self._frame!r}, the base_frame (got {message.header.frame_id!r})"
            )
        pose = messages.pose_from(message, name)
        self._followers[name].take(pose, self._check_stamp(message, name, name))

    def cycle(self, now: int) -> list[tuple[str, Any]]:
        """Takes the steps that are due at a time, ns, and tells what to publish: topics and messages.

        The first call begins. A call that is too early has none. One that is late makes up for one cycle; later ones
        are left out, so that the body is behind the clock by that from then on. `told` has the numbers.

        Raises:
            MessageError: time went back.
            StepError: a step could not be taken.
        """
        span = round(self._cycle * SECOND)
        if self._start is None:
            self._start = now - span
        due = round((now - self._start) / span) - self._cycles
        if due < -1:
            raise MessageError(f"clock: it went back by {-due * self._cycle:g} s; start the node anew")
        if due < 1:
            return []
        if due > 1:
            self.late += 1
        if (out := due - MOST_CYCLES) > 0:
            self._start += out * span
            self.left_out += out * self._cycle
            self.told.append(
                f"a call came {(due - 1) * self._cycle:.4g} s late: {out * self._cycle:.4g} s are left out; "
                f"{self.late} calls were late so far, and the body is {self.left_out:.4g} s behind the clock"
            )
        for _ in range(min(due, MOST_CYCLES)):
            for name, follower in self._followers.items():
                gap, angle = follower.plan(self.world.time, self._cycle, *self._fastest)
                if gap or angle:
                    away = f"{gap:.3g} m and {angle:.3g} rad from its pose"
                    self._tell(f"{name} is {away}: it goes there at the largest speed, or turning")
            self.world.step(self._given, self._steps)
            self._cycles += 1
        if self._cycles % max(1, round(1 / self._cycle)) == 0:
            for text in self.world.warnings:
                self._tell(text)
        return list(self._published(self._start + self._cycles * span))

    def _published(self, stamp: int) -> Iterator[tuple[str, Any]]:
        """Topics and messages of now."""
        make = self._make
        poses = {name: self.world.pose(name) for name in self.world.names if "." not in name or name in self._soft}
        frames = {name: (pose.position, pose.rotation) for name, pose in poses.items()}
        yield "/tf", messages.transforms(make, stamp, self._frame, frames)
        for name, body in self._soft.items():
            places, columns = body.node_places(), {}
            force, torque = np.zeros(3), np.zeros(3)
            if (contact := body.nodal_contact) is not None:
                R = rotation_matrix(poses[name].rotation)
                arms = places[contact.nodes] - poses[name].position
                force, torque = contact.forces.sum(axis=0) @ R, np.cross(arms, contact.forces).sum(axis=0) @ R
                columns["pressure"] = body.contact_pressure()[self._nodes[name]]
            yield topic_of(f"{name}/wrench"), messages.wrench(make, stamp, name, force, torque)
            columns = dict(zip("xyz", places[self._nodes[name]].T, strict=True)) | columns
            yield topic_of(f"{name}/points"), messages.cloud(make, stamp, self._frame, columns)
        for (name, sense), topic in self._senses.items():
            yield topic, messages.image(make, stamp, name, self._soft[name].touch(sense).pressures)

    def _check_stamp(self, message: Any, where: str, of: Any) -> int:
        """The stamp of a message, ns, which is not before that of the one before."""
        stamp = messages.nanoseconds(message.header)
        if stamp < (last := self._stamps.get(of, stamp)):
            raise MessageError(
                f"{where}: stamps go back; use one from {last / SECOND:.9f} s on (got {stamp / SECOND:.9f})"
            )
        self._stamps[of] = stamp
        return stamp

    def _tell(self, text: str) -> None:
        """Once, but for numbers."""
        if (words := re.sub(r"\d[-+.\de]*", "", text)) not in self._heard:
            self._heard.add(words)
            self.told.append(text)


def topic_of(name: str) -> str:
    """A name as a topic: of letters, digits and _, as ROS allows; a dot begins a part."""
    parts = re.sub(r"[^A-Za-z0-9_/]", "_", name.replace(".", "/")).split("/")
    return "/".join(part if not part[:1].isdigit() else f"_{part}" for part in parts)


def _read_world(file: str, dt: float) -> tuple[fr.World, dict[str, Follower]]:
    """A world of its file, and what follows poses in it: bodies that are driven, or stand still."""
    world = fr.make_world(fr.read_world(file), dt or None)
    followers = {}
    for name, record in world.bodies.items():
        if isinstance(record, fr.RigidBody) and record.is_driven:
            motion = record.pose(name) if record.motion is None else record.motion
            followers[name] = Follower(given_base(motion, name))
            world.drive(name, followers[name])
    return world, followers


def _read_rom(file: str, dt: float) -> tuple[fr.World, dict[str, Follower]]:
    """A world of one body, among the obstacles of its scene: those with a motion, and its base, follow poses."""
    rom = fr.read_rom(file)
    acting = rom.environment
    step = dt or (0.0 if acting.run is None else acting.run.dt)
    if not step:
        raise MessageError(f"dt: {file} has no run that says it; use a time step, s (got 0)")
    motions = {name: each.motion for name, each in acting.obstacles.items() if each.motion is not None}
    moved: dict[str, Any] = {name: motion.path or _still(motion.origin) for name, motion in motions.items()}
    placed, begins = dict[str, Any](), fr.Simulator(rom, step, signals=moved).pose
    if begins is not None:
        placed = {"position": begins.position, "rotation": begins.rotation}
        if rom.moving_frame is not None and rom.moving_frame.carried:
            moved[BASE_PATH] = acting.base_path or begins
    followers = {name: Follower(given_base(motion, name)) for name, motion in moved.items()}
    world = fr.World({BODY: fr.SoftBody(rom, signals=followers, **placed)}, step)
    return world, {BASE if name == BASE_PATH else name: follower for name, follower in followers.items()}


def _still(position: Any) -> fr.BaseState:
    return fr.BaseState(np.array(position, dtype=float), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3))


def _targets(world: fr.World, soft: dict[str, Soft]) -> dict[str, tuple[str, str, str] | None]:
    """What a joint or actuator of a name is given: body or joint, input, field of JointState; None: no motor."""
    targets: dict[str, tuple[str, str, str] | None] = dict.fromkeys(world.joints)
    targets |= {name: (name, "target", FIELD_OF[motor.kind]) for name, motor in world.motors.items()}
    for name, body in soft.items():
        controls = body.rom.environment.controls
        for actuator, columns in body.rom.actuators.items():
            if columns == 1:
                targets[f"{name}.{actuator}"] = name, actuator, "position" if actuator in controls else "effort"
    ends = [name.rpartition(".")[2] for name in targets]
    return targets | {end: targets[name] for name, end in zip(list(targets), ends, strict=True) if ends.count(end) == 1}


def _surface_nodes(name: str, body: Soft, surface: str) -> Array:
    """Nodes that a cloud has."""
    if not surface:
        return np.unique(body.rom.triangles)
    check_known("surface", surface, body.rom.contact_surfaces, StepError, f"surface: body {name!r}: ")
    nodes: Array = body.rom.contact_surfaces[surface]
    return nodes
