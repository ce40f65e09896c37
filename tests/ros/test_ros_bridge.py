"""A recorded bag plays to the bridge, and what comes out is a bag: each field is what the world says."""

import shutil
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import ros_types
from fenics_rom_ros.bridge import Bridge, topic_of
from fenics_rom_ros.follower import Follower
from fenics_rom_ros.messages import MessageError, cloud
from pads import RUBS, L, pad_scene
from ros_types import joints, make, pose

import fenics_rom as fr
from fenics_rom.errors import FenicsRomError
from fenics_rom.mechanics.frame_motion import quaternion_of_vector, rotation_matrix
from fenics_rom.mechanics.touch import TOUCH

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
CARRIED = {"supports": 'clamped = ["bottom"]', "effects.base_path": "origin = [0.02, 0.0, 0.0]"}
DATA = Path(__file__).parents[1] / "data"
CYCLE, FIRST = 10_000_000, 1_700_000_000 * 10**9  # ns
ABOVE, RADIUS, SPEED = 21.0001 * L, 20.0 * L, 2.0 * L  # of a ball: m, m, m/s
AT, TURN = np.array([0.3, -0.2, 0.1]), np.array([0.0, 0.0, np.pi / 2])  # of the pad's axes: m, rad
WORLD = f"""
[bodies.pad]
rom = "pad.h5"
position = {AT.tolist()}
rotation = {TURN.tolist()}
[bodies.ball]
shape = "sphere"
radius = {RADIUS}
position = [{AT[0] - 2 * L}, {AT[1] + 2 * L}, {AT[2] + ABOVE}]
[contact]
friction = 0.4
[run]
dt = 1e-3
duration = 1.0
"""


def ball_at(seconds):
    """m."""
    return AT + np.array((-2 * L, 2 * L, ABOVE - SPEED * seconds))


@pytest.fixture(scope="module")
def rom(tmp_path_factory):
    felt = f'quantity = "{TOUCH}"\nsurface = "top"\ntaxels = {{ rows = 4, columns = 5 }}\n'
    ball = f'shape = "sphere", center = [{2 * L}, {2 * L}, {ABOVE}], radius = {RADIUS}, motion = {{}}'
    pin = f"obstacles.pin = {{ {ball} }}"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = pad_scene(tmp_path_factory.mktemp("ros"), pin, points="nodes", **RUBS, **{"outputs.skin": felt})
        return fr.reduce(fr.assemble(scene), order=10)


@pytest.fixture
def folder(rom, tmp_path):
    fr.write_rom(tmp_path / "pad.h5", rom)
    (tmp_path / "world.toml").write_text(WORLD)
    return tmp_path


def numbers(vector):
    return np.array([vector.x, vector.y, vector.z])


def test_a_recorded_bag_plays_to_the_bridge_and_its_messages_are_a_bag(folder):
    """Two poses a cycle come in. What goes out is read back, and is what the world said at the same time."""
    steps = [FIRST + k * CYCLE // 2 for k in range(16)]
    recorded = [("/ball/pose", now, pose(now, ball_at((now - FIRST) / 1e9))) for now in steps]
    ros_types.write_bag(folder / "in", recorded)
    bridge, sent, seen, due = Bridge(f"{folder}/world.toml", make=make), [], [], FIRST
    kind, take = bridge.inputs["ball/pose"]
    for topic, time, message in ros_types.read_bag(folder / "in"):
        while time > due:
            sent += [(topic, due, message) for topic, message in bridge.cycle(due)]
            body, world = bridge.world.simulator("pad"), bridge.world
            told = [world.force_between("pad", "ball"), body.touch("skin"), body.node_places(), world.pose("ball")]
            seen.append((*told, body.contact_pressure()))
            due += CYCLE
        assert (topic, message.__msgtype__) == ("/ball/pose", kind)
        take(message)
    ros_types.write_bag(folder / "out", sent)
    read = ros_types.read_bag(folder / "out")
    assert len(read) == len(sent)
    played = {}
    for topic, time, message in read:
        played.setdefault(topic, []).append((time, message))
    assert set(played) == {"/tf", "pad/wrench", "pad/points", "pad/taxels/skin"}
    assert bridge.outputs == {topic: said[0][1].__msgtype__ for topic, said in played.items()}
    assert np.linalg.norm(seen[-1][0]) > 0.01  # N
    sense = body.rom.readings["skin"]
    R, skin = rotation_matrix(quaternion_of_vector(TURN)), np.unique(body.rom.triangles)
    for k, (force, touch, places, ball, pressure) in enumerate(seen):
        of = {topic: said[k][1] for topic, said in played.items()}
        stamped = [m.header.stamp for topic, m in of.items() if topic != "/tf"] + [of["/tf"].transforms[0].header.stamp]
        assert {said[k][0] for said in played.values()} == {FIRST + k * CYCLE}
        assert {stamp.sec * 10**9 + stamp.nanosec for stamp in stamped} == {FIRST + k * CYCLE}
        wrench, image, points = of["pad/wrench"], of["pad/taxels/skin"], of["pad/points"]
        assert (wrench.header.frame_id, image.header.frame_id, points.header.frame_id) == ("pad", "pad", "world")
        np.testing.assert_allclose(R @ numbers(wrench.wrench.force), force, atol=1e-13)
        about = sense._origin_at(places[sense.nodes]) - AT
        moment = touch.torque + np.cross(about, force)
        np.testing.assert_allclose(R @ numbers(wrench.wrench.torque), moment, atol=1e-14)
        assert (image.height, image.width, image.encoding, image.step, image.is_bigendian) == (4, 5, "32FC1", 20, 0)
        np.testing.assert_array_equal(image.data.view("<f4").reshape(4, 5), touch.pressures.astype("f4"))
        assert [(f.name, f.offset, f.datatype, f.count) for f in points.fields] == [
            ("x", 0, 7, 1),
            ("y", 4, 7, 1),
            ("z", 8, 7, 1),
            ("pressure", 12, 7, 1),
        ]
        assert (points.height, points.width, points.point_step) == (1, len(skin), 16)
        assert (points.row_step, len(points.data)) == (16 * len(skin),) * 2
        assert (points.is_dense, points.is_bigendian) == (True, False)
        table = points.data.view("<f4").reshape(-1, 4)
        np.testing.assert_array_equal(table, np.column_stack([places, pressure])[skin].astype("f4"))
        frames = {each.child_frame_id: each for each in of["/tf"].transforms}
        assert set(frames) == {"pad", "ball"}
        assert {each.header.frame_id for each in frames.values()} == {"world"}
        np.testing.assert_array_equal(numbers(frames["ball"].transform.translation), ball.position)
        turn = frames["pad"].transform.rotation
        np.testing.assert_allclose([turn.x, turn.y, turn.z, turn.w], [0, 0, np.sqrt(0.5), np.sqrt(0.5)], atol=1e-15)


def test_a_body_follows_poses_as_they_went_and_stops_where_they_stop():
    """Along a cubic in time, turning: after two poses it is one cycle behind, to the square of the cycle; positions and
    velocities are continuous, and without poses it comes to rest at the last one."""
    h, follower, errors = 0.01, Follower(lambda t: at(0.0)), []

    def at(t):
        turn = quaternion_of_vector([0.0, 0.3 * t**2, 2.0 * t])
        return fr.BaseState(np.array([t, t**2, -(t**3)]), turn, np.zeros(3), np.zeros(3))

    for k in range(20):
        follower.take(tuple(at(k * h))[:2], k * 10**7)
        before = follower(k * h)
        assert follower.plan(k * h, h, 5.0, 10.0) == (0.0, 0.0)
        np.testing.assert_allclose(np.concatenate(follower(k * h)), np.concatenate(before), atol=1e-14)
        if k > 2:
            errors += [np.abs(follower((k + s) * h).position - at((k - 1 + s) * h).position).max() for s in (0.3, 0.7)]
            np.testing.assert_allclose(follower((k + 1) * h).rotation, at(k * h).rotation, atol=1e-14)
    assert max(errors) < h**2 / 2  # the velocity of two poses is that of their middle
    np.testing.assert_allclose(follower(20 * h).velocity, [1.0, (0.19**2 - 0.18**2) / h, -(0.19**3 - 0.18**3) / h])
    for k in range(20, 23):
        follower.plan(k * h, h, 5.0, 10.0)
    np.testing.assert_allclose(follower(0.23)[2:], 0.0, atol=1e-14)
    np.testing.assert_allclose(follower(0.23).position, at(0.19).position, atol=1e-15)


def test_a_body_far_from_its_pose_goes_there_no_faster_than_it_may():
    still = fr.BaseState(np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))
    follower, turned = Follower(lambda t: still), quaternion_of_vector([0, 0, 1.0])
    follower.take((np.array([0.1, 0.0, 0.0]), turned), 0)
    behind = [follower.plan(k * 0.01, 0.01, 2.0, 100.0) for k in range(6)]
    left = np.array([4, 3, 2, 1, 0, 0])
    np.testing.assert_allclose(behind, np.column_stack([0.02 * left, 0.2 * left]), atol=1e-14)
    np.testing.assert_allclose(follower(0.06).position, [0.1, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(follower(0.06).rotation, turned, atol=1e-15)


def test_late_calls_are_made_up_for_by_a_cycle_and_the_rest_is_left_out_and_told(folder):
    bridge = Bridge(f"{folder}/world.toml", make=make)

    def called(milliseconds):
        """Stamp, ms after the first call, and time of the world, ms."""
        sent = bridge.cycle(FIRST + round(milliseconds * 1e6))
        stamp = sent and sent[0][1].transforms[0].header.stamp
        return sent and (stamp.sec * 10**9 + stamp.nanosec - FIRST) / 1e6, round(bridge.world.time * 1e3)

    assert [called(t) for t in (0.0, 10.3, 12.0, 19.6)] == [(0.0, 10), (10.0, 20), ([], 20), (20.0, 30)]
    assert (bridge.late, bridge.told) == (0, [])
    assert called(40.0) == (40.0, 50)
    assert (bridge.late, bridge.told) == (1, [])
    assert called(100.0) == (100.0, 70)
    assert (bridge.late, bridge.left_out) == (2, pytest.approx(0.04))
    (told,) = bridge.told
    assert told.startswith("a call came 0.05 s late: 0.04 s are left out; 2 calls were late so far")
    assert told.endswith("0.04 s behind the clock")
    assert called(110.0) == (110.0, 80)
    with pytest.raises(MessageError, match=r"clock: it went back by 0\.08 s"):
        called(30.0)


def test_a_rom_by_itself_takes_what_its_actuators_get_and_its_obstacles_poses(folder):
    """Obstacles with a motion follow; forces are efforts; a bare name stands for one that is alone."""
    bridge = Bridge(f"{folder}/pad.h5", make=make, dt=1e-3, surface="top")
    assert set(bridge.inputs) == {"pin/pose"}
    for k in range(10):
        bridge.take_pose("pin", pose(k * CYCLE, ball_at(k / 100) - ball_at(0.0)))
        sent = dict(bridge.cycle(FIRST + k * CYCLE))
    force = bridge.world.simulator("body").contact_forces("pin")
    assert force[2] < -0.01
    np.testing.assert_allclose(numbers(sent["body/wrench"].wrench.force), force, atol=1e-13)
    assert sent["body/points"].width == len(bridge.world.simulator("body").rom.contact_surfaces["top"])
    pulled = Bridge(str(DATA / "rom-1.0.h5"), make=make)
    for name, stamp in (("body.pull", 1), ("pull", 2)):
        pulled.take_joints(joints(stamp, [name], effort=[3.0]))
    sent = dict(pulled.cycle(FIRST))
    body = fr.Simulator(DATA / "rom-1.0.h5", dt=0.01)
    body.step(pull=3.0)
    table = sent["body/points"].data.view("<f4").reshape(-1, 3)  # nothing can touch it
    np.testing.assert_array_equal(table, body.node_places()[np.unique(body.rom.triangles)].astype("f4"))
    assert not numbers(sent["body/wrench"].wrench.force).any()


@pytest.mark.parametrize("supports", [CARRIED, {"supports": None}], ids=["carried", "free"])
def test_a_body_in_a_moving_frame_begins_where_its_scene_puts_it_and_goes_with_its_base(tmp_path, supports):
    """The base is driven as a Simulator is by the same poses; a free body has none."""
    scene = pad_scene(tmp_path, None, frame="moving", **{"effects.contact": None} | supports)
    rom = fr.reduce(fr.assemble(scene), order=10)
    fr.write_rom(tmp_path / "rom.h5", rom)
    bridge, single = Bridge(f"{tmp_path}/rom.h5", make=make, dt=2e-3), fr.Simulator(rom, 2e-3)
    begins, is_carried = single.pose.position, rom.moving_frame.carried
    assert set(bridge.inputs) == ({"base/pose"} if is_carried else set())
    follower = Follower(lambda time: single.pose)
    for k in range(6):
        place = begins + np.array((0.0, 0.5 * (k / 100) ** 2, 0.0)), quaternion_of_vector([0.0, 0.0, 0.02 * k])
        if is_carried:
            bridge.take_pose("base", pose(k * CYCLE, *place))
            follower.take(place, k * CYCLE)
            follower.plan(k * 0.01, 0.01, 2.0, 10.0)
        sent = dict(bridge.cycle(FIRST + k * CYCLE))
        for step in range(5):
            single.step(base=follower(k * 0.01 + (step + 1) * 2e-3)) if is_carried else single.step()
    (frame,) = sent["/tf"].transforms
    if is_carried:
        np.testing.assert_allclose(numbers(frame.transform.translation), place[0], atol=1e-15)
        assert single.energy > 0
    else:
        np.testing.assert_allclose(numbers(frame.transform.translation), begins, atol=1e-15)
    places = bridge.world.simulator("body").node_places()
    np.testing.assert_allclose(places, single.node_places(), atol=1e-13)


def test_actuators_whose_stroke_is_given_get_positions(tmp_path):
    rom = fr.read_rom(DATA / "rom-2.8.h5")
    fr.write_rom(tmp_path / "rom.h5", replace(rom, environment=replace(rom.environment, controls={"cable": "length"})))
    bridge, body = Bridge(f"{tmp_path}/rom.h5", make=make, rate=500.0), fr.Simulator(tmp_path / "rom.h5", dt=2e-3)
    bridge.take_joints(joints(1, ["cable", "air"], position=[1e-4, 9.0], effort=[9.0, 100.0]))
    bridge.cycle(FIRST)
    body.step(cable=1e-4, air=100.0)
    assert body.displacement().any()
    np.testing.assert_allclose(bridge.world.simulator("body").displacement(), body.displacement(), atol=1e-15)


def test_motors_of_a_robot_get_what_their_kind_goes_by(tmp_path):
    pytest.importorskip("mujoco")
    for name in ("arm.urdf", "plate.obj"):
        shutil.copy(DATA / "robots" / name, tmp_path)
    (tmp_path / "arm.toml").write_text("""
        [bodies.arm]
        robot = "arm.urdf"
        motors.all = { kind = "position", gain = 300.0, damping = 20.0 }
        motors.j1 = { kind = "velocity", gain = 20.0 }
        motors.j3 = { kind = "torque" }
        [run]
        dt = 5e-3
        duration = 1.0
    """)
    bridge = Bridge(f"{tmp_path}/arm.toml", make=make)
    names = ["j1", "arm.j2", "j3", "also"]
    stated = {"position": [9.0, 0.3, 9.0, 0.0], "velocity": [0.5, 9.0, 9.0, 9.0], "effort": [9.0, 9.0, 0.2, 9.0]}
    bridge.take_joints(joints(1, names, **stated))
    assert bridge.told == ["joint_states: 'also' has no motor: what is said of it is not used"]
    bridge.cycle(FIRST)
    assert [bridge.world.joint_state(f"arm.{name}").target for name in ("j1", "j2", "j3")] == [0.5, 0.3, 0.2]
    with pytest.raises(MessageError, match=r"joint_states: 'arm\.j2': position: use a finite number for each name"):
        bridge.take_joints(joints(2, ["arm.j2"], velocity=[0.0]))
    with pytest.raises(MessageError, match=r"joint_states: no joint or actuator 'j9'"):
        bridge.take_joints(joints(2, ["j2", "j9"], position=[0.7, 0.0]))
    bridge.cycle(FIRST + CYCLE)
    assert bridge.world.joint_state("arm.j2").target == 0.3  # nothing of a message that is refused is taken


def test_bad_messages_are_named_and_change_nothing(folder):
    bridge = Bridge(f"{folder}/world.toml", make=make)
    bridge.take_pose("ball", pose(5 * CYCLE, ball_at(0.0)))
    bad = {
        r"ball: stamps go back; use one from 0\.050000000 s on \(got 0\.040000000\)": {"stamp": 4 * CYCLE},
        r"ball: frame_id: use 'world', the base_frame \(got 'map'\)": {"frame": "map"},
        r"ball: orientation: use a unit quaternion \(got x y z w = 0\.0, 0\.0, 0\.0, 0\.0\)": {
            "rotation": (0, 0, 0, 0)
        },
        r"ball: position: use finite numbers": {"position": (np.nan, 0, 0)},
    }
    for said, given in bad.items():
        with pytest.raises(MessageError, match=said):
            bridge.take_pose("ball", pose(**{"stamp": 6 * CYCLE, "position": (9, 9, 9)} | given))
    with pytest.raises(MessageError, match="no body that is driven 'bal'; there is ball; did you mean 'ball'"):
        bridge.take_pose("bal", pose(0, (0, 0, 0)))
    bridge.take_pose("ball", pose(6 * CYCLE, ball_at(0.0), (0.8, 0.0, 0.0, 0.6)))
    for k in range(20):
        bridge.cycle(FIRST + k * CYCLE)
    np.testing.assert_allclose(bridge.world.pose("ball").position, ball_at(0.0), atol=1e-15)
    np.testing.assert_allclose(bridge.world.pose("ball").rotation, [0.8, 0.0, 0.0, 0.6], atol=1e-14)
    assert [text[:8] for text in bridge.told] == ["ball is "]  # farther than it may turn in a cycle


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"file": "none.h5"}, "none.h5"),
        ({"file": "none.toml"}, "none.toml"),
        ({"rate": 0.0}, r"rate: use a finite number > 0 \(got 0.0\)"),
        ({"rate": 300.0}, r"rate: a cycle is a whole number of steps of 0\.001 s; use 333\.3+ Hz \(got 300\)"),
        ({"base_frame": "/world"}, "base_frame: use a name that does not begin with a slash"),
        ({"surface": "tip"}, "surface: body 'pad': no surface 'tip'; there is top"),
        ({"file": "pad.h5", "dt": 0.0}, "dt: .*pad.h5 has no run that says it"),
    ],
)
def test_bad_parameters_are_named(folder, given, said):
    file = folder / given.pop("file", "world.toml")
    with pytest.raises(FenicsRomError, match=said):
        Bridge(str(file), make=make, **given)


def test_names_are_topics_that_ros_allows():
    assert [topic_of(name) for name in ("arm.hand/pose", "left finger/pose", "2nd")] == [
        "arm/hand/pose",
        "left_finger/pose",
        "_2nd",
    ]


def test_a_cloud_with_a_place_that_is_none_says_so():
    columns = dict(zip("xyz", np.array([[0.0, 1.0], [0.0, np.nan], [0.0, 1.0]]), strict=True))
    assert not cloud(make, 0, "world", columns).is_dense
