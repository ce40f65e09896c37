"""The node: parameters, topics and a timer around a bridge, which knows nothing of ROS."""

import sys
from collections.abc import Callable
from functools import partial
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rosidl_runtime_py.utilities import get_message

from fenics_rom.errors import FenicsRomError
from fenics_rom_ros.bridge import PARAMETERS, Bridge

QUEUE = 10  # messages that wait to be sent: reliable, the last ones kept


def make(name: str, /, **fields: Any) -> Any:
    """A message of the name of its type."""
    return get_message(name)(**fields)


class BodyNode(Node):
    """A body or a world at real time."""

    def __init__(self) -> None:
        super().__init__("body")
        given = {name: self.declare_parameter(name, default).value for name, default in PARAMETERS.items()}
        self._bridge = Bridge(given.pop("file"), make=make, **given)
        self._senders = {
            topic: self.create_publisher(get_message(kind), topic, QUEUE)
            for topic, kind in self._bridge.outputs.items()
        }
        for topic, (kind, take) in self._bridge.inputs.items():
            self.create_subscription(get_message(kind), topic, partial(self._take, take), qos_profile_sensor_data)
        self.create_timer(1 / given["rate"], self._cycle)
        self.get_logger().info(f"{self._bridge.world!r}; listens to {', '.join(self._bridge.inputs) or 'nothing'}")

    def _take(self, take: Callable[[Any], None], message: Any) -> None:
        """A message that cannot be used is told and left out."""
        try:
            take(message)
        except FenicsRomError as error:
            self.get_logger().error(str(error), throttle_duration_sec=1.0)

    def _cycle(self) -> None:
        for topic, message in self._bridge.cycle(self.get_clock().now().nanoseconds):
            self._senders[topic].publish(message)
        while self._bridge.told:
            self.get_logger().warning(self._bridge.told.pop(0))


def main(args: list[str] | None = None) -> None:
    """Until it is told to stop, or a step cannot be taken."""
    rclpy.init(args=args)
    try:
        rclpy.spin(BodyNode())
    except FenicsRomError as error:
        sys.exit(f"fenics_rom: {error}")
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()
