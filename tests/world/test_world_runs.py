"""Runs of worlds from their files: written, read, drawn, and told of what is wrong."""

from types import SimpleNamespace

import numpy as np
import pytest
from bodies import box_arrays, write_arrays

import fenics_rom as fr
from fenics_rom import world_run
from fenics_rom.cli.main import main
from fenics_rom.errors import FenicsRomError, SceneError
from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.scene.reference import WORLD_EXAMPLE
from fenics_rom.trajectory.elastic_part import deformation

WORLD = WORLD_EXAMPLE.read_text().replace("duration = 1.0", "duration = 0.2\nevery = 3\nsnapshots = 10")

POSES = "position.x,position.y,position.z,rotation.w,rotation.x,rotation.y,rotation.z"
TWISTS = "velocity.x,velocity.y,velocity.z,angular_velocity.x,angular_velocity.y,angular_velocity.z"
SINKS = f"time,{POSES},{TWISTS}\n0,0,0,-1,1,0,0,0,0,0,-0.5,0,0,0\n1,0,0,-1.5,1,0,0,0,0,0,-0.5,0,0,0\n"
THROWN = """
gravity = [0, 0, -9.81]
[bodies.floor]
shape = "half-space"
path = "floor.csv"
[bodies.ball]
shape = "sphere"
radius = 0.05
mass = 0.5
velocity = [2, 0, 0.5]
spin = [0, 3, 0]
[bodies.box]
shape = "box"
size = [0.1, 0.2, 0.3]
mass = 0.25
position = [0.25, 0.04, 0]
velocity = [0, 0, 0.5]
[run]
dt = 2e-3
duration = 0.2
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    file = tmp_path_factory.mktemp("world") / "world.toml"
    file.write_text(WORLD)
    return fr.simulate(str(file), rate=True)


def test_a_run_keeps_poses_forces_and_accounts(run):
    assert list(run.bodies) == ["ground", "lower", "upper"]
    assert run.steps == 100
    assert len(run.times) == 35  # every third, and the last
    assert run.balance_error < 1e-12
    weight = 9.81 * np.array([0.5 + 0.2, 0.2])
    np.testing.assert_allclose(run.forces["ground-lower"][-1], [0, 0, -weight[0]], atol=1e-9)
    np.testing.assert_allclose(run.forces["lower-upper"][-1], [0, 0, -weight[1]], atol=1e-9)
    lower = run.bodies["lower"]
    assert np.abs(lower.pose - lower.pose[0]).max() < 1e-12
    assert (run.nodes + run.snapshots[-1])[lower.nodes, 2].min() == pytest.approx(0, abs=1e-12)
    assert not deformation(run, run.snapshots).any()  # of rigid bodies
    gain = lower.energy - lower.energy[0] - lower.supplied - lower.exchanged + lower.dissipated
    assert np.abs(gain).max() < 1e-12


def test_tracks_of_bodies_that_fly_are_those_of_the_textbook(tmp_path):
    """A turning ball is thrown at a box, above a floor that sinks; without friction it keeps its spin."""
    (tmp_path / "floor.csv").write_text(SINKS)
    (tmp_path / "world.toml").write_text(THROWN)
    run = fr.simulate(tmp_path / "world.toml")
    ball, box, t = run.bodies["ball"], run.bodies["box"], run.times
    np.testing.assert_allclose(t, 2e-3 * np.arange(101), atol=1e-15)
    np.testing.assert_array_equal(ball.velocity[0], [2.0, 0.0, 0.5, 0.0, 3.0, 0.0])
    np.testing.assert_allclose(ball.velocity[:, 2], 0.5 - 9.81 * t, atol=1e-12)
    np.testing.assert_allclose(ball.velocity[:, 3:], [[0.0, 3.0, 0.0]] * len(t), atol=1e-4)  # hit where it was expected
    assert box.velocity[-1, 0] > 0.5  # it was hit, beside its middle,
    assert abs(box.velocity[-1, 5]) > 1  # and turns
    for body, mass in ((ball, 0.5), (box, 0.25)):
        fallen = body.pose[0, 2] - body.pose[:, 2]
        np.testing.assert_allclose(body.supplied, mass * 9.81 * fallen, atol=1e-13)
        np.testing.assert_allclose(body.energy - body.energy[0], body.supplied + body.exchanged, atol=1e-13)
        assert not body.dissipated.any()  # in itself
        assert run.node_mass[body.nodes].sum() == pytest.approx(mass, rel=1e-14)
        R = rotation_matrix(body.pose[-1, 3:])
        started = run.nodes[body.nodes] - body.pose[0, :3]
        ended = (run.nodes + run.snapshots[-1])[body.nodes] - body.pose[-1, :3]
        np.testing.assert_allclose(ended, started @ R.T, atol=1e-14)
    assert ball.exchanged[-1] < -0.1
    impulse = 2e-3 * run.forces["ball-box"].sum(axis=0)  # on the first
    np.testing.assert_allclose(impulse[:2], -0.25 * box.velocity[-1, :2], atol=1e-12)
    np.testing.assert_allclose(run.obstacle_motion["floor"][:, 2], -0.5 * run.snapshot_times, atol=1e-12)
    assert run.triangles[-1].min() >= box.nodes.start


def test_a_run_is_written_and_read(run, tmp_path):
    fr.write_trajectory(tmp_path / "run.h5", run)
    again = fr.read_trajectory(tmp_path / "run.h5")
    assert list(again.bodies) == list(run.bodies)
    for name, body in run.bodies.items():
        for key, value in vars(body).items():
            np.testing.assert_array_equal(getattr(again.bodies[name], key), value)
    np.testing.assert_array_equal(again.snapshots, run.snapshots)
    assert "bodies: ground, lower, upper" in repr(again)


def test_a_step_of_its_own_and_what_a_world_has_not(tmp_path):
    file = tmp_path / "world.toml"
    file.write_text(WORLD)
    assert fr.simulate(file, dt=0.01, every=1).times == pytest.approx(0.01 * np.arange(21), abs=1e-15)
    for given, said in (({"every": 0}, "every = 0: use"), ({"every": 1.5}, "every = 1.5"), ({"dt": 1.0}, "dt = 1.0")):
        with pytest.raises(SceneError, match=said):
            fr.simulate(file, **given)
    with pytest.raises(SceneError, match="stepper cannot be used with a WorldScene"):
        fr.simulate(file, stepper="newton")


def test_joints_of_a_file_hold_between_their_times(tmp_path):
    """A ball that is held in the air for 0.1 s, and falls on the lower box."""
    joint = '\n[[joints]]\nname = "hold"\nkind = "weld"\nfirst = "upper"\npoint = [0, 0, 0.2]\nstop = 0.1\n'
    (tmp_path / "world.toml").write_text(WORLD.replace("position = [0, 0, 0.14]", "position = [0, 0, 0.2]") + joint)
    run = fr.simulate(tmp_path / "world.toml", dt=1e-2, every=1)
    height = run.bodies["upper"].pose[:, 2]
    np.testing.assert_allclose(height[:11], 0.2, atol=1e-12)
    np.testing.assert_allclose(height[11:16], 0.2 - 9.81 * (0.01 * np.arange(1, 6)) ** 2 / 2, rtol=1e-12)


def test_inputs_are_those_of_the_middle_of_a_step(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(world_run, "inputs_at", lambda scene, time, world: asked.append(time) or {})
    (tmp_path / "world.toml").write_text(WORLD)
    fr.simulate(tmp_path / "world.toml", dt=0.05)
    assert asked == pytest.approx([0.025, 0.075, 0.125, 0.175], abs=1e-15)


STILL = """
[mesh]
file = "beam.msh"
degree = 1
[material]
young = 5e5
poisson = 0.4
density = 1100.0
[supports]
clamped = ["left"]
[contacts.bottom]
surface = "bottom"
[contacts.right]
surface = "right"
[effects.tendon.rope]
points = [[0.0, 0.015, 0.004], [0.15, 0.015, 0.004], [0.3, 0.015, 0.004]]
control = "length"
[effects.contact.obstacles.floor]
shape = "half-space"
point = [0.0, 0.0, -9.0]
normal = [0.0, 0.0, 1.0]
[reduction]
order = 6
"""
PRESSED = """
gravity = [0, 0, -9.81]
[contact]
friction = 0.5
[bodies.ground]
shape = "half-space"
position = [0, 0, -0.0315]
[bodies.box]
shape = "box"
size = [0.12, 0.06, 0.03]
density = 500
position = [0.26, 0.015, -0.0165]
[bodies.finger]
scene = "finger.toml"
[run]
dt = 0.01
duration = 0.3
[[run.input]]
body = "finger"
actuator = "rope"
table = "stroke.csv"
"""


def test_a_finger_without_inertia_presses_a_box_in_a_run_of_a_file(tmp_path):
    """Its stroke at the end of each step is that of the file then; what is pressed is borne, and the account closes."""
    write_arrays(tmp_path / "beam.msh", *box_arrays((0.3, 0.03, 0.02), (6, 1, 1)))
    (tmp_path / "finger.toml").write_text(STILL)
    (tmp_path / "stroke.csv").write_text("time,stroke\n0,0\n0.2,1.5e-3\n1,1.5e-3\n")
    (tmp_path / "world.toml").write_text(PRESSED)
    scene = fr.read_world(tmp_path / "world.toml")
    world = fr.make_world(scene)
    assert world_run.inputs_at(scene, 0.105, world) == {"finger": {"rope": pytest.approx(1.5e-3 * 0.11 / 0.2)}}
    with pytest.raises(SystemExit) as ended:
        main(["simulate", str(tmp_path / "world.toml"), "-o", str(tmp_path / "run.h5")])
    assert not ended.value.code
    run = fr.read_trajectory(tmp_path / "run.h5")
    pressed, borne = run.forces["box-finger"][-1], -run.forces["ground-box"][-1]
    assert pressed[2] < -0.01
    np.testing.assert_allclose(borne + pressed, [0, 0, 500 * 0.12 * 0.06 * 0.03 * 9.81], rtol=0, atol=1e-8)
    assert run.balance_error < 1e-12


def test_a_cable_of_a_soft_body_that_pushes_is_told(tmp_path, monkeypatch):
    environment = SimpleNamespace(is_pulled={"flexor"}.__contains__)
    monkeypatch.setattr(world_run, "_rom", lambda body, scene: SimpleNamespace(environment=environment))
    finger = '\n[bodies.finger]\nrom = "finger.h5"\nposition = [0, 0, 5]\n'
    pull = '[[run.input]]\nbody = "finger"\nactuator = "flexor"\nvalue = -2\n'
    (tmp_path / "world.toml").write_text(WORLD + pull + finger)
    with pytest.raises(
        SceneError, match=r"run.input\[0\]: actuator 'flexor': a tension of -2 N: a cable pulls and cannot"
    ):
        fr.simulate(tmp_path / "world.toml")


@pytest.mark.parametrize(
    ("there", "instead", "said"),
    [
        ("position = [0, 0, 0.14]", "position = [0, 0, 0.1]", "upper"),  # begins inside the lower one
        ("[run]\ndt = 2e-3\nduration = 0.2\nevery = 3\nsnapshots = 10", "", r"has no \[run\]"),
        ("[bodies.upper]", "[bodies.up-per]", "use a name without a hyphen"),
    ],
)
def test_what_cannot_begin_is_told(tmp_path, there, instead, said):
    assert there in WORLD
    text = WORLD.replace(there, instead)
    (tmp_path / "world.toml").write_text(text.replace('"upper"', '"up-per"') if "-" in instead[9:] else text)
    with pytest.raises(FenicsRomError, match=said):
        fr.simulate(tmp_path / "world.toml")


def test_the_command_line_runs_a_world_and_tells_of_it(tmp_path, capsys):
    (tmp_path / "world.toml").write_text(WORLD)
    command = ["simulate", str(tmp_path / "world.toml"), "-o", str(tmp_path / "run.h5")]
    with pytest.raises(SystemExit) as ended:
        main(command)
    assert not ended.value.code
    said = capsys.readouterr().out
    assert "largest force of lower-upper" in said
    assert "supplied by obstacles" in said
    with pytest.raises(SystemExit) as ended:
        main([*command, "--stepper", "newton"])
    assert ended.value.code
