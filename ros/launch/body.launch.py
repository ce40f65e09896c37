"""Starts the node: ros2 launch fenics_rom_ros body.launch.py file:=/path/to/finger.h5."""

from fenics_rom_ros.bridge import PARAMETERS
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue


def generate_launch_description():
    """The node, and an argument for each of its parameters."""
    said = [DeclareLaunchArgument(name, default_value=str(default)) for name, default in PARAMETERS.items()]
    given = {
        name: ParameterValue(LaunchConfiguration(name), value_type=type(default))
        for name, default in PARAMETERS.items()
    }
    body = Node(package="fenics_rom_ros", executable="body", name="body", parameters=[given], output="screen")
    return LaunchDescription([*said, body])
