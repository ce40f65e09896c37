"""A reduced soft body in a ROS 2 graph."""
