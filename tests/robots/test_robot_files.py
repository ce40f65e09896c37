"""Robots from URDF and MJCF: they are, and swing, as MuJoCo says; bad files are named with the line."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fenics_rom as fr
from fenics_rom import world_run
from fenics_rom.errors import SceneError
from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.scene.world_file import files_of_world
from fenics_rom.world.drives import Motor
from fenics_rom.world.shapes import Box, Cylinder, HalfSpace, Hull

mujoco = pytest.importorskip("mujoco")
ARM = Path(__file__).parents[1] / "data" / "robots" / "arm.urdf"
G = (0.0, 0.0, -9.81)
HINGES = {"j1": 0.3, "j2": 0.8, "j3": -0.4, "j4": 0.9, "j5": 0.5, "j6": -0.7, "j7": 0.2}

MJCF = """<mujoco model="cart">
  <compiler angle="radian"/>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 0.1"/>
    <body name="cart" pos="0 0 0.5">
      <joint name="rail" type="slide" axis="1 0 0" damping="0.3" armature="0.2" frictionloss="0.1" range="-1 1"/>
      <geom type="box" size="0.1 0.05 0.04" mass="1.5"/>
      <body name="rod" pos="0.1 0 0">
        <joint name="pin" axis="0 1 0" stiffness="2" springref="0.4" damping="0.01"/>
        <geom type="capsule" fromto="0 0 0 0.1 0 -0.3" size="0.02" density="1200"/>
        <geom type="sphere" pos="0.1 0 -0.3" size="0.04" density="800"/>
        <body name="bob" pos="0.1 0 -0.3">
          <joint name="ball" type="ball"/>
          <geom type="ellipsoid" size="0.03 0.05 0.08" pos="0 0 -0.08" density="900"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><position name="drive" joint="rail" kp="40" kv="6" forcerange="-20 20"/></actuator>
</mujoco>
"""


def mujoco_positions(model, start, end, ctrl=(), step=1e-4):
    """Of all joints, by name, after a time, s, by Runge and Kutta's method."""
    model.opt.integrator, model.opt.timestep = mujoco.mjtIntegrator.mjINT_RK4, step
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    data = mujoco.MjData(model)
    for name, value in start.items():
        data.joint(name).qpos[0] = value
    data.ctrl[:] = ctrl
    for _ in range(round(end / step)):
        mujoco.mj_step(model, data)
    return {model.joint(j).name: data.joint(j).qpos.copy() for j in range(model.njnt)}


@pytest.fixture
def folder(tmp_path):
    for name in ("arm.urdf", "plate.obj"):
        (tmp_path / name).write_text((ARM.parent / name).read_text())
    return tmp_path


def with_absolute_meshes(file):
    """What MuJoCo alone reads of a URDF whose meshes are of a package."""
    text = file.read_text().replace("package://robots/", f"{file.parent}/")
    return text.replace('<robot name="arm">', '<robot name="arm"><mujoco><compiler strippath="false"/></mujoco>')


def test_a_urdf_becomes_bodies_joints_and_frames():
    """Each link has its mass and inertia, where MuJoCo has them; a link without is a frame of the one that holds it."""
    robot = fr.read_robot(ARM, positions=HINGES, position=(0.1, 0.2, 0.3), rotation=(0.6, 0, 0.8, 0))
    model = mujoco.MjModel.from_xml_string(with_absolute_meshes(ARM))
    data = mujoco.MjData(model)
    for name, value in HINGES.items():
        data.joint(name).qpos[0] = value
    mujoco.mj_forward(model, data)
    turn = rotation_matrix((0.6, 0, 0.8, 0))
    for b in range(1, model.nbody):
        body = robot.bodies[f"arm.{model.body(b).name}"]
        assert body.mass == pytest.approx(model.body_mass[b], rel=1e-12)
        np.testing.assert_allclose(body.position, (0.1, 0.2, 0.3) + turn @ data.xipos[b], atol=1e-12)
        R, axes = rotation_matrix(body.rotation), turn @ data.ximat[b].reshape(3, 3)
        np.testing.assert_allclose(R @ body.inertia @ R.T, (axes * model.body_inertia[b]) @ axes.T, atol=1e-12)
    assert robot.frames["tool"].body == "arm.hand"
    assert isinstance(robot.bodies["arm.base"].shape, Cylinder)
    assert robot.bodies["arm.base"].is_driven
    assert isinstance(robot.bodies["arm.upper"].shape, Box)
    assert robot.bodies["arm.turn"].shape is None
    assert isinstance(robot.bodies["arm.hand"].shape, Hull)
    hand = robot.bodies["arm.hand"].shape
    np.testing.assert_allclose(np.ptp(hand.vertices, axis=0), (0.06, 0.1, 0.012), atol=1e-9)
    np.testing.assert_allclose(robot.visuals["arm.hand"][0].vertices.max(axis=0), (0.03, 0.05, 0.006), atol=1e-8)
    drives = {joint.name: joint.drive for joint in robot.joints}
    assert drives["arm.j2"].limits == (-2.1, 2.1)
    assert drives["arm.also"].follows == ("arm.close", 1.0, 0.0)
    assert drives["arm.j1"].limits is None


def test_an_arm_swings_as_mujoco_says(folder):
    """Seven hinges that hang, free of motors and limits: to the square of the step, and 1e-6 rad extrapolated."""
    file = folder / "arm.urdf"
    parts = [f'  <link name="{link}">.*?</link>\n' for link in ("left", "right")]
    parts += [f'  <joint name="{joint}".*?</joint>\n' for joint in ("close", "also")]
    file.write_text(re.sub("|".join(parts), "", ARM.read_text(), flags=re.S))
    start = dict.fromkeys(HINGES, 0.3)
    model = mujoco.MjModel.from_xml_string(with_absolute_meshes(file))
    model.opt.gravity[:] = 0, 0, 9.81
    found, end = [], 0.3
    exact = mujoco_positions(model, start, end)
    exact = np.array([exact[name][0] for name in HINGES])
    for dt in (6e-3, 3e-3):
        robot = fr.read_robot(file, positions=start, rotation=(0, 1, 0, 0))
        joints = [replace(joint, drive=replace(joint.drive, limits=None)) for joint in robot.joints]
        world = fr.World(robot.bodies, dt, joints=joints, apart=robot.apart, gravity=G)
        energy = world.energy
        for _ in range(round(end / dt)):
            world.step()
        found.append(np.array([world.joint_state(f"arm.{name}").position for name in HINGES]))
        ledger = world.ledger
        assert world.energy - ledger.supplied + ledger.dissipated == pytest.approx(energy, abs=1e-13)
        assert abs(ledger.numerical) < 1e-12
    errors = [np.abs(q - exact).max() for q in (*found, (4 * found[1] - found[0]) / 3)]
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.05)
    assert errors[2] < 1e-6


def test_a_cart_of_mjcf_goes_as_mujoco_says(tmp_path):
    """Slider with motor, friction, damping and rotor, hinge with a spring, ball: to the square of the step."""
    file = tmp_path / "cart.xml"
    file.write_text(MJCF)
    exact = mujoco_positions(mujoco.MjModel.from_xml_string(MJCF), {}, 0.3, ctrl=[0.3])
    errors = []
    for dt in (5e-3, 2.5e-3):
        robot = fr.read_robot(file)
        world = fr.World(robot.bodies, dt, joints=robot.joints, apart=robot.apart, gravity=G)
        start = world.energy
        for _ in range(round(0.3 / dt)):
            world.step({"cart.rail": {"target": 0.3}})
        errors.append([abs(world.joint_state(f"cart.{name}").position - exact[name][0]) for name in ("rail", "pin")])
        ledger = world.ledger
        assert world.energy - ledger.supplied + ledger.dissipated == pytest.approx(start, abs=1e-13)
    assert robot.warnings[0].startswith("cart.rod: touches by the hull of its 2 shapes")
    assert isinstance(robot.bodies["cart.ground"].shape, HalfSpace)
    first, second = np.array(errors)
    assert (first < 2e-3).all()
    assert (first / second > 2.5).all()


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ('<mass value="0.8"/>', '<mass value="-0.8"/>', 26, "mass = -0.8 kg: use a number > 0"),
        ('izz="0.0011"', 'izz="0.011"', 26, "none larger than the sum of the others"),
        (
            '<parent link="roll"/><child link="wrist"/>',
            '<parent link="roll"/><child link="fore"/>',
            61,
            "closes a loop",
        ),
        ("package://robots/plate.obj", "package://robots/other.obj", 31, "there is no such file"),
        ('<mimic joint="close"', '<mimic joint="open"', 79, "there is no such joint"),
        ('<mimic joint="close"', '<mimic joint="also"', 79, "use a chain without a circle"),
        ('scale="0.001 0.001 0.001"', 'scale="1 1 1"', 30, "its mesh is"),
        ('<origin xyz="0 0 0.26"/>', '<origin xyz="0 0 260"/>', 50, "its unit is m, not mm"),
        ('<joint name="j6" type="revolute">', '<joint name="j6" type="planar">', 61, "use one of revolute"),
        ("</robot>", "", 82, "no XML"),
    ],
)
def test_bad_urdf_is_named_with_the_line(tmp_path, old, new, line, said):
    text = ARM.read_text()
    assert old in text
    (tmp_path / "plate.obj").write_text((ARM.parent / "plate.obj").read_text())
    file = tmp_path / "arm.urdf"
    file.write_text(text.replace(old, new))
    with pytest.raises(SceneError, match=f"line {line}: .*{said}"):
        fr.read_robot(file)


def test_a_link_without_inertia_is_named(tmp_path):
    lines = [line for line in ARM.read_text().splitlines() if 'value="1.2"' not in line]
    file = tmp_path / "arm.urdf"
    (tmp_path / "plate.obj").write_text((ARM.parent / "plate.obj").read_text())
    file.write_text("\n".join(lines))
    with pytest.raises(SceneError, match="line 22: link 'roll': has no <inertial>, and joint 'j5' moves it"):
        fr.read_robot(file)


def test_bad_mjcf_is_refused(tmp_path):
    file = tmp_path / "cart.xml"
    for old, new, said in (
        ('axis="0 1 0" stiff', 'axs="0 1 0" stiff', "unrecognized attribute"),
        ('type="ball"/>', 'type="ball" damping="1"/>', "line 13: joint 'ball' is a ball or free, with damping"),
        ('<joint name="pin"', '<joint name="more" axis="1 0 0"/><joint name="pin"', "line 8: body 'rod' has 2 joints"),
    ):
        file.write_text(MJCF.replace(old, new))
        with pytest.raises(SceneError, match=said):
            fr.read_robot(file)
    with pytest.raises(SceneError, match="motors: "):
        fr.read_robot(ARM, motors={"elbow": Motor("torque")})
    file.write_text("<scene/>")
    with pytest.raises(SceneError, match="line 1: begins with <scene>"):
        fr.read_robot(file)


TOML = """
gravity = [0, 0, -9.81]
[bodies.arm]
robot = "arm.urdf"
positions = { j2 = 0.4, j4 = 0.6 }
[bodies.arm.motors]
all = { kind = "position", gain = 400.0, damping = 30.0 }
j1 = { kind = "velocity", gain = 20.0 }
[bodies.ball]
shape = "sphere"
radius = 0.03
mass = 0.2
position = [0.6, 0, 0.5]
[run]
dt = 4e-3
duration = 0.04
input = [
  { joint = "arm.j1", value = 0.5 },
  { joint = "arm.j2", value = 0.4 }, { joint = "arm.j4", value = 0.6 }, { joint = "arm.j2", value = 0.1, start = 0.02 },
]
"""


def test_a_world_file_has_a_robot(folder):
    """Its bodies are there beside others, its motors get their targets, and a run of it closes its account."""
    (folder / "world.toml").write_text(TOML)
    scene = fr.read_world(folder / "world.toml")
    run = fr.simulate(str(folder / "world.toml"))
    assert {"arm.base", "arm.upper", "arm.hand", "ball"} < set(run.bodies)
    assert run.balance_error < 1e-12
    world = fr.make_world(scene)
    for step in range(10):
        world.step(world_run.inputs_at(scene, (step + 0.5) * 4e-3, world))
    assert world.joint_state("arm.j2").target == 0.5
    assert world.joint_state("arm.j1").target == 0.5
    assert world.joint_state("arm.j1").speed > 0.1
    assert abs(world.joint_state("arm.j6").position) < 0.02
    assert any(str(file).endswith("arm.urdf") for file in files_of_world(scene))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("j1 = {", "j9 = {", "motors: no joint 'j9'"),
        ("j4 = 0.6 }\n", "j9 = 0.6 }\n", "positions: no joint 'j9'"),
        ('joint = "arm.j1"', 'joint = "leg.j1"', "input.0..joint: no robot 'leg'"),
        ('kind = "velocity"', 'kind = "speed"', "no choice 'speed'"),
        ('robot = "arm.urdf"', 'robot = "arm.urdf"\nmass = 1.0', "bodies.arm.mass: is of a body, and this is a robot"),
        ('shape = "sphere"', 'shape = "sphere"\npositions = { j1 = 1 }', "bodies.ball.positions: is of a robot"),
        ('robot = "arm.urdf"', 'robot = "none.urdf"', "cannot be read"),
    ],
)
def test_bad_robots_of_a_world_file_are_refused(folder, old, new, said):
    assert old in TOML
    (folder / "world.toml").write_text(TOML.replace(old, new))
    with pytest.raises(SceneError, match=said):
        fr.make_world(fr.read_world(folder / "world.toml"))
