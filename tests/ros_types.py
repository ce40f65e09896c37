"""Messages of ROS 2 without ROS: made of their definitions, as strictly as rclpy makes them, and kept in bags."""

from array import array

import numpy as np
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
BASE, NAME, SEQUENCE = 1, 2, 4  # kinds of fields, as rosbags numbers them
CODES = {"float64": "d", "float32": "f", "uint8": "B"}
WHOLE = {"uint8": (0, 2**8), "int32": (-(2**31), 2**31), "uint32": (0, 2**32)}


def fits(value, kind):
    """Whether rclpy's setter of a field of a kind takes a value."""
    node, of = kind
    if node == NAME:
        return value.__msgtype__ == of
    if node == SEQUENCE:
        (inner, name), _ = of
        if inner == BASE and name[0] in CODES:
            return isinstance(value, array) and value.typecode == CODES[name[0]]
        return isinstance(value, list) and all(fits(each, of[0]) for each in value)
    name, _ = of
    if name in WHOLE:
        return type(value) is int and WHOLE[name][0] <= value < WHOLE[name][1]
    return isinstance(value, {"string": str, "bool": bool, "float64": float, "float32": float}[name])


def make(name, /, **fields):
    """A message; AssertionError where a field is missing, unknown, or of another type than its definition says."""
    defined = dict(STORE.get_msgdef(name).fields)
    assert fields.keys() == defined.keys(), name
    for field, value in fields.items():
        assert fits(value, defined[field]), (name, field, value)
    arrays = {field: np.frombuffer(v, v.typecode) for field, v in fields.items() if isinstance(v, array)}
    return STORE.types[name](**fields | arrays)


def write_bag(folder, messages):
    """Writes (topic, time in ns, message) to a bag of the kind that Jazzy records."""
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        known = {}
        for topic, time, message in messages:
            kind = message.__msgtype__
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(known[topic], time, STORE.serialize_cdr(message, kind))


def read_bag(folder):
    """What a bag has, as it was written, by the definitions that the bag itself has."""
    with Reader(folder) as reader:
        return [
            (connection.topic, time, STORE.deserialize_cdr(raw, connection.msgtype))
            for connection, time, raw in reader.messages()
        ]


def header(stamp, frame=""):
    """Of a stamp in ns."""
    time = make("builtin_interfaces/msg/Time", sec=stamp // 10**9, nanosec=stamp % 10**9)
    return make("std_msgs/msg/Header", stamp=time, frame_id=frame)


def pose(stamp, position, rotation=(1.0, 0.0, 0.0, 0.0), frame="world"):
    """A PoseStamped; the quaternion is w x y z."""
    w, *turn = map(float, rotation)
    at = make("geometry_msgs/msg/Point", **dict(zip("xyz", map(float, position), strict=True)))
    turned = make("geometry_msgs/msg/Quaternion", w=w, **dict(zip("xyz", turn, strict=True)))
    both = make("geometry_msgs/msg/Pose", position=at, orientation=turned)
    return make("geometry_msgs/msg/PoseStamped", header=header(stamp, frame), pose=both)


def joints(stamp, names, **values):
    """A JointState."""
    numbers = {key: array("d", values.get(key, ())) for key in ("position", "velocity", "effort")}
    return make("sensor_msgs/msg/JointState", header=header(stamp), name=list(names), **numbers)
