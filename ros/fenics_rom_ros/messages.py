"""Numbers as fields of standard messages, and back. ROS has quaternions as x y z w, and times as whole nanoseconds.

What makes a message is given: `make("std_msgs/msg/Header", stamp=..., frame_id=...)`. Sequences of numbers are those of
`array`, which ROS takes as they are.
"""

import math
from array import array
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import FenicsRomError, shown

Make = Callable[..., Any]
SECOND = 1_000_000_000  # ns
UNIT = 1e-3  # of the length of a quaternion: so far off it may be
FLOAT32 = 7  # as sensor_msgs/msg/PointField numbers kinds of numbers


class MessageError(FenicsRomError):
    """A message, or a parameter of the node, that cannot be used; all is as it was."""


def nanoseconds(header: Any) -> int:
    """The stamp of a message, ns."""
    return int(header.stamp.sec) * SECOND + int(header.stamp.nanosec)


def header_of(make: Make, stamp: int, frame: str) -> Any:
    """A header of a stamp, ns."""
    seconds, rest = divmod(stamp, SECOND)
    return make(
        "std_msgs/msg/Header", stamp=make("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest), frame_id=frame
    )


def pose_from(message: Any, where: str) -> tuple[Array, Array]:
    """Position (3,), m, and unit quaternion (4,), w x y z, of a geometry_msgs/PoseStamped.

    Raises:
        MessageError: not finite, or no rotation.
    """
    at, turn = message.pose.position, message.pose.orientation
    position, rotation = np.array([at.x, at.y, at.z]), np.array([turn.w, turn.x, turn.y, turn.z])
    if not np.isfinite(position).all():
        raise MessageError(f"{where}: position: use finite numbers, m (got {shown(position.tolist())})")
    length = float(np.linalg.norm(rotation))
    if not abs(length - 1) <= UNIT:  # not of NaN, either
        raise MessageError(
            f"{where}: orientation: use a unit quaternion (got x y z w = {turn.x}, {turn.y}, {turn.z}, {turn.w})"
        )
    return position, rotation / length


def transforms(make: Make, stamp: int, frame: str, poses: Mapping[str, tuple[Array, Array]]) -> Any:
    """A tf2_msgs/TFMessage: where frames are in another one, by positions (3,), m, and quaternions w x y z."""
    made = []
    for child, (position, rotation) in poses.items():
        w, *turn = rotation.tolist()
        transform = make(
            "geometry_msgs/msg/Transform",
            translation=_vector(make, position),
            rotation=make("geometry_msgs/msg/Quaternion", **dict(zip("xyz", turn, strict=True)), w=w),
        )
        header = header_of(make, stamp, frame)
        made.append(
            make("geometry_msgs/msg/TransformStamped", header=header, child_frame_id=child, transform=transform)
        )
    return make("tf2_msgs/msg/TFMessage", transforms=made)


def wrench(make: Make, stamp: int, frame: str, force: Array, torque: Array) -> Any:
    """A geometry_msgs/WrenchStamped: N, and N m about the origin of a frame, in its axes."""
    both = make("geometry_msgs/msg/Wrench", force=_vector(make, force), torque=_vector(make, torque))
    return make("geometry_msgs/msg/WrenchStamped", header=header_of(make, stamp, frame), wrench=both)


def image(make: Make, stamp: int, frame: str, values: Array) -> Any:
    """A sensor_msgs/Image of numbers (rows, columns) as 32FC1."""
    rows, columns = values.shape
    return make(
        "sensor_msgs/msg/Image",
        header=header_of(make, stamp, frame),
        height=rows,
        width=columns,
        encoding="32FC1",
        is_bigendian=0,
        step=4 * columns,
        data=_bytes(values),
    )


def cloud(make: Make, stamp: int, frame: str, columns: Mapping[str, Array]) -> Any:
    """A sensor_msgs/PointCloud2 of columns (n,) by name, as 32-bit floats, without order."""
    table = np.column_stack([*columns.values()])
    (points, width), row = table.shape, 4 * table.size
    fields = [
        make("sensor_msgs/msg/PointField", name=name, offset=4 * k, datatype=FLOAT32, count=1)
        for k, name in enumerate(columns)
    ]
    return make(
        "sensor_msgs/msg/PointCloud2",
        header=header_of(make, stamp, frame),
        height=1,
        width=points,
        fields=fields,
        is_bigendian=False,
        point_step=4 * width,
        row_step=row,
        data=_bytes(table),
        is_dense=bool(math.isfinite(table.sum())),
    )


def _vector(make: Make, numbers: Array) -> Any:
    return make("geometry_msgs/msg/Vector3", **dict(zip("xyz", numbers.tolist(), strict=True)))


def _bytes(values: Array) -> "array[int]":
    return array("B", values.astype("<f4").tobytes())
