"""A world of its file: the bodies in motion, and a run of them."""

import warnings
from collections.abc import Mapping
from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np

from fenics_rom.errors import FenicsRomWarning, SceneError, check_known, check_type
from fenics_rom.io.progress import Report, silent
from fenics_rom.lazy_import import load
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.contact import ContactLaw
from fenics_rom.mechanics.frame_motion import quaternion_of_vector, rotation_matrix
from fenics_rom.mechanics.load_history import check_pull, count_steps
from fenics_rom.robots.records import Robot
from fenics_rom.rom.rom import Rom
from fenics_rom.scene.world_file import check_whole_steps
from fenics_rom.scene.world_format import JointEntry, WorldBody, WorldScene
from fenics_rom.trajectory.trajectory import Trajectory
from fenics_rom.world import joints, shapes
from fenics_rom.world.driven import mounted
from fenics_rom.world.drives import Motor
from fenics_rom.world.recorder import WorldRecorder
from fenics_rom.world.records import RigidBody, SoftBody
from fenics_rom.world.world import World

SHAPES: dict[str, Any] = {
    "half-space": shapes.HalfSpace,
    "box": shapes.Box,
    "sphere": shapes.Sphere,
    "capsule": shapes.Capsule,
    "cylinder": shapes.Cylinder,
    "hull": shapes.Hull,
    "mesh": shapes.Mesh,
}
REPORTS = 100  # of a run


def make_world(scene: WorldScene, dt: float | None = None, roms: Mapping[str, Rom] | None = None) -> World:
    """The bodies of a world file where they begin.

    Args:
        scene: as `read_world` gives it.
        dt: time step instead of that of its run, s.
        roms: of soft bodies by name, instead of those that the file names.

    Raises:
        SceneError: a ROM that cannot be read or touched, a joint that cannot be closed.
        StepError: bodies begin inside each other.

    Example:
        >>> fr.make_world(fr.read_world("stack.toml")).names
        ('ground', 'lower', 'upper')
    """
    check_type("make_world", scene, WorldScene, "fr.read_world(file)")
    file = scene.file
    if dt is None and file.run is None:
        raise SceneError(f"{scene.source}: has no [run], so there is no time step; add one, or give dt")
    step = file.run.dt if dt is None and file.run is not None else dt
    assert step is not None
    laws = {pair.bodies: ContactLaw(pair.restitution, pair.friction) for pair in file.pairs}
    roms = {} if roms is None else roms
    robots = {name: _robot(name, body, scene) for name, body in file.bodies.items() if body.robot is not None}
    bodies, held = dict[str, RigidBody | SoftBody](), list[joints.AnyJoint]()
    for name, body in file.bodies.items():
        if name in robots:
            bodies |= robots[name].bodies
            held += robots[name].joints
            continue
        bodies[name] = of = _body(name, body, scene, roms.get(name))
        if body.surface is not None and isinstance(of, SoftBody):
            bodies[name], joint = _mounted(name, body, of, robots, scene.source)
            held.append(joint)
    try:
        return World(
            bodies,
            step,
            joints=[*held, *(_joint(joint) for joint in file.joints)],
            gravity=file.gravity,
            friction=file.contact.friction,
            restitution=file.contact.restitution,
            pairs=laws,
            apart=[*file.apart, *(group for robot in robots.values() for group in robot.apart)],
        )
    except SceneError as error:
        raise SceneError(f"{scene.source}: {error}") from error


def run_world(
    scene: WorldScene, dt: float | None = None, every: int | None = None, rate: bool = False, report: Report = silent
) -> Trajectory:
    """Runs a world file through its load history, as `simulate` does."""
    run = scene.file.run
    if run is None:
        raise SceneError(f"{scene.source}: has no [run], so there is no load history to simulate; add one")
    every = run.every if every is None else every
    steps = count_steps(run.duration, run.dt if dt is None else dt, every)
    check_whole_steps(run.duration, run.dt if dt is None else dt, scene.source)
    world = make_world(scene, dt)
    recorder = WorldRecorder(world, steps, snapshots=run.snapshots, every=every)
    seconds, step, told = 0.0, 0, max(1, steps // REPORTS)
    while step < steps:
        inputs, count = inputs_at(scene, (step + 0.5) * world.dt, world), 1
        if not run.input:
            count = recorder.steps_to_sample(step)
        begin = perf_counter()
        world.step(inputs, count)
        seconds += perf_counter() - begin
        if -step % told < count:
            report("steps", step, steps)
        recorder.sample(step := step + count)
    report("steps", steps, steps)
    return recorder.record(scene.file.name, {"seconds": seconds} if rate else None)


def inputs_at(scene: WorldScene, time: float, world: World) -> dict[str, dict[str, float]]:
    """What the load history of a world file applies in a step with its middle at a time, s, by body, by actuator.

    Forces are those of the middle of the step, strokes those of its end.
    """
    run = scene.file.run
    inputs: dict[str, dict[str, float]] = {}
    if run is None:
        return inputs
    for each in run.input:
        if each.start <= time < (run.duration if each.stop is None else each.stop):
            if each.joint is not None:
                of_joint = inputs.setdefault(each.joint, {"target": 0.0})
                of_joint["target"] += float(each.signal(time)[0])
                continue
            assert each.body is not None
            assert each.actuator is not None
            of_body = inputs.setdefault(each.body, {})
            is_stroke = each.actuator in world.simulator(each.body).rom.environment.controls
            late = world.dt / 2 if is_stroke else 0.0
            of_body[each.actuator] = of_body.get(each.actuator, 0.0) + float(each.signal(time + late)[0])
    return inputs


def _body(name: str, body: WorldBody, scene: WorldScene, rom: Rom | None) -> RigidBody | SoftBody:
    rotation = quaternion_of_vector(body.rotation)
    if body.shape is None:
        rom = _rom(body, scene) if rom is None else rom
        for k, each in enumerate(scene.file.run.input if scene.file.run else ()):
            if each.body == name and each.actuator is not None and rom.environment.is_pulled(each.actuator):
                check_pull(each.signal, f"run.input[{k}]: actuator {each.actuator!r}")
        return SoftBody(
            rom,
            position=body.position,
            rotation=rotation,
            velocity=body.velocity,
            angular_velocity=body.spin,
            on=body.on,
        )
    keys = ("size", "radius", "length", "points", "open")
    given = {key: getattr(body, key) for key in keys if getattr(body, key) is not None}
    if body.file is not None:
        given["vertices"], given["triangles"] = body.file.joined(1.0 if body.scale is None else body.scale)
    try:
        shape = SHAPES[body.shape](**given)
    except SceneError as error:
        raise SceneError(f"{scene.source}: bodies.{name}: {error}") from error
    position = np.array(body.position)
    if isinstance(shape, shapes.Hull):  # whose points are in axes of their own
        position = position + rotation_matrix(rotation) @ shape.shift
    if body.path is not None:
        return RigidBody(shape, motion=body.path)
    return RigidBody(
        shape,
        density=body.density,
        mass=body.mass,
        position=position,
        rotation=rotation,
        velocity=body.velocity,
        angular_velocity=body.spin,
    )


def _robot(name: str, body: WorldBody, scene: WorldScene) -> Robot:
    """Of its file."""
    assert body.robot is not None
    motors = {
        of: Motor(each.kind, each.gain, each.damping, np.inf if each.most is None else each.most)
        for of, each in body.motors.items()
    }
    try:
        robot: Robot = load("robots.read", "read_robot")(
            scene.folder / body.robot,
            name,
            position=body.position,
            rotation=quaternion_of_vector(body.rotation),
            positions=body.positions,
            motors=motors,
        )
    except SceneError as error:
        raise SceneError(f"{scene.source}: bodies.{name}: {error}") from error
    for text in robot.warnings:
        warnings.warn(f"{scene.source}: bodies.{name}: {text}", FenicsRomWarning, stacklevel=3)
    return robot


def _mounted(
    name: str, body: WorldBody, soft: SoftBody, robots: Mapping[str, Robot], source: str
) -> tuple[SoftBody, joints.SurfaceJoint]:
    """A free soft body on a link of a robot, whose axes its place counts from, and the weld that holds it."""
    assert body.on is not None
    assert body.surface is not None
    of, _, link = body.on.partition(".")
    check_known("link", link, robots[of].frames, SceneError, f"{source}: bodies.{name}.on: ")
    frame = robots[of].frames[link]
    place = mounted(
        BaseState(frame.position, frame.rotation, np.zeros(3), np.zeros(3)),
        BaseState(np.array(body.position), np.array(soft.rotation), np.zeros(3), np.zeros(3)),
    )
    there = replace(soft, on=None, position=place.position, rotation=place.rotation)
    return there, joints.SurfaceJoint(name, frame.body, body.surface, name=f"{name}.mount")


def _rom(body: WorldBody, scene: WorldScene) -> Rom:
    """Of a soft body: read, or made of its scene."""
    if body.rom is not None:
        rom: Rom = load("rom.file", "read_rom")(scene.folder / body.rom)
        return rom
    assert body.scene is not None
    system = load("fem.assemble", "assemble")(load("scene.file", "read_scene")(scene.folder / body.scene))
    reduced: Rom = load("reduction.reduce", "reduce")(system)
    return reduced


def _joint(joint: JointEntry) -> joints.AnyJoint:
    when: dict[str, Any] = {"name": joint.name, "start": joint.start, "stop": joint.stop}
    if joint.surface is not None:
        return joints.SurfaceJoint(joint.first, joint.second, joint.surface, joint.kind, joint.axis, **when)
    assert joint.point is not None
    if joint.axis is not None:
        return joints.hinge(joint.first, joint.second, joint.point, joint.axis, **when)
    return {"ball": joints.ball, "weld": joints.weld}[joint.kind](joint.first, joint.second, joint.point, **when)
