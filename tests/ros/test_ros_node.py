"""The node's lines, under stand-ins for rclpy and launch that take what these take; and what colcon is told."""

import inspect
import runpy
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType, SimpleNamespace
from xml.etree import ElementTree

import pytest
from fenics_rom_ros import bridge
from ros_types import STORE, joints, make

import fenics_rom as fr

FOLDER = Path(__file__).parents[2] / "ros"
ROM = Path(__file__).parents[1] / "data" / "rom-1.0.h5"
SENSOR_DATA, SECOND = object(), 10**9


def message_type(name):
    """A class as rosidl makes it: its fields are named, and of the types of its definition."""
    return type(name, (), {"kind": name, "__new__": lambda cls, **fields: make(name, **fields)})


class Publisher:
    def __init__(self, kind, topic, queue):
        self.kind, self.topic, self.queue, self.sent = kind.kind, topic, queue, []

    def publish(self, message):
        assert message.__msgtype__ == self.kind
        self.sent.append(message)


class Logger:
    def __init__(self):
        self.said = []

    def info(self, text):
        self.said.append(("info", text))

    def warning(self, text):
        self.said.append(("warning", text))

    def error(self, text, *, throttle_duration_sec):
        self.said.append(("error", text))


class Node:
    """What the node asks of its base class, by the names and arguments of rclpy's."""

    given: dict  # parameters

    def __init__(self, node_name):
        self.name, self.now, self.logger = node_name, 100 * SECOND, Logger()
        self.publishers_made, self.subscribed, self.timers_made = {}, {}, []

    def declare_parameter(self, name, value):
        assert type(self.given.get(name, value)) is type(value)  # as rclpy insists
        return SimpleNamespace(value=self.given.get(name, value))

    def create_publisher(self, msg_type, topic, qos_profile):
        self.publishers_made[topic] = Publisher(msg_type, topic, qos_profile)
        return self.publishers_made[topic]

    def create_subscription(self, msg_type, topic, callback, qos_profile):
        self.subscribed[topic] = msg_type.kind, callback, qos_profile

    def create_timer(self, timer_period_sec, callback):
        self.timers_made.append((timer_period_sec, callback))

    def get_clock(self):
        return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=self.now))

    def get_logger(self):
        return self.logger


class ExternalShutdownException(Exception):
    pass


@pytest.fixture
def ros(monkeypatch):
    """Stand-ins in place of ROS; `spin` is to be given."""

    def module(name, **has):
        made = ModuleType(name)
        vars(made).update(has)
        monkeypatch.setitem(sys.modules, name, made)
        return made

    ended = []
    rclpy = module("rclpy", init=lambda *, args=None: None, spin=None, try_shutdown=lambda: ended.append(True))
    module("rclpy.executors", ExternalShutdownException=ExternalShutdownException)
    module("rclpy.node", Node=Node)
    module("rclpy.qos", qos_profile_sensor_data=SENSOR_DATA)
    module("rosidl_runtime_py")
    module("rosidl_runtime_py.utilities", get_message=message_type)
    monkeypatch.delitem(sys.modules, "fenics_rom_ros.node", raising=False)
    monkeypatch.setattr(Node, "given", {"file": str(ROM)}, raising=False)
    yield rclpy
    assert ended
    sys.modules.pop("fenics_rom_ros.node", None)


def test_the_node_hands_messages_to_the_bridge_and_publishes_what_it_tells(ros):
    def spin(node):
        period, cycle = node.timers_made[0]
        assert (node.name, period) == ("body", 0.01)
        kind, take, quality = node.subscribed["joint_states"]
        assert (kind, quality) == ("sensor_msgs/msg/JointState", SENSOR_DATA)
        assert {sender.queue for sender in node.publishers_made.values()} == {10}
        cycle()
        take(joints(1, ["pull"], effort=[2.0]))
        take(joints(2, ["push"], effort=[2.0]))
        node.now += SECOND
        cycle()
        assert [len(sender.sent) for sender in node.publishers_made.values()] == [2, 2, 2]
        (_, begins), (level, error), (late, told) = node.logger.said
        assert begins.endswith("listens to joint_states")
        assert (level, error.startswith("joint_states: no joint or actuator 'push'")) == ("error", True)
        assert (late, told.startswith("a call came 0.99 s late")) == ("warning", True)
        stamps = [sent.header.stamp.sec for sent in node.publishers_made["body/wrench"].sent]
        assert stamps == [100, 101]
        raise KeyboardInterrupt

    ros.spin = spin
    import_module("fenics_rom_ros.node").main()


def test_the_node_ends_as_it_is_told_and_names_what_ends_it(ros, monkeypatch):
    def spin(node):
        raise ExternalShutdownException

    ros.spin = spin
    node = import_module("fenics_rom_ros.node")
    node.main([])
    monkeypatch.setattr(Node, "given", {})
    with pytest.raises(SystemExit, match="fenics_rom: file: use the name of a ROM"):
        node.main()
    monkeypatch.setattr(Node, "given", {"file": "none.h5"})
    with pytest.raises(SystemExit, match=r"fenics_rom: .*none\.h5"):
        node.main()


def test_the_launch_file_has_an_argument_for_each_parameter(monkeypatch):
    class Said(SimpleNamespace):
        def __init__(self, *given, **named):
            super().__init__(given=given, **named)

    for name, has in {
        "launch": ["LaunchDescription"],
        "launch.actions": ["DeclareLaunchArgument"],
        "launch.substitutions": ["LaunchConfiguration"],
        "launch_ros": [],
        "launch_ros.actions": ["Node"],
        "launch_ros.parameter_descriptions": ["ParameterValue"],
    }.items():
        module = ModuleType(name)
        vars(module).update(dict.fromkeys(has, Said))
        monkeypatch.setitem(sys.modules, name, module)
    (said,) = runpy.run_path(FOLDER / "launch" / "body.launch.py")["generate_launch_description"]().given
    *arguments, node = said
    defaults = {each.given[0]: each.default_value for each in arguments}
    assert defaults == {name: str(value) for name, value in bridge.PARAMETERS.items()}
    (given,) = node.parameters
    assert {name: value.value_type for name, value in given.items()} == {
        name: type(value) for name, value in bridge.PARAMETERS.items()
    }
    assert (node.package, node.executable) == ("fenics_rom_ros", "body")
    keywords = inspect.signature(bridge.Bridge).parameters
    assert {name: keywords[name].default for name in keywords if name not in ("file", "make")} == {
        name: value for name, value in bridge.PARAMETERS.items() if name != "file"
    }


def test_colcon_is_told_what_there_is(monkeypatch):
    told = {}
    monkeypatch.chdir(FOLDER)
    monkeypatch.setitem(sys.modules, "setuptools", SimpleNamespace(setup=told.update))
    runpy.run_path("setup.py")
    package = ElementTree.parse("package.xml")
    assert package.findtext("export/build_type") == "ament_python"
    assert package.findtext("name") == told["name"] == told["packages"][0]
    assert package.findtext("version") == told["version"] == fr.__version__
    assert all(Path(file).is_file() for _, files in told["data_files"] for file in files)
    assert Path("setup.cfg").read_text().count(f"lib/{told['name']}\n") == 2
    assert told["entry_points"] == {"console_scripts": ["body = fenics_rom_ros.node:main"]}
    code = "".join(file.read_text() for file in Path("fenics_rom_ros").glob("*.py"))
    of_messages = {name for name in {kind.split("/")[0] for kind in STORE.types} if f'"{name}/msg' in code}
    needed = {each.text for each in package.findall("exec_depend")}
    assert needed == of_messages | {"rclpy", "rosidl_runtime_py", "launch", "launch_ros"}
