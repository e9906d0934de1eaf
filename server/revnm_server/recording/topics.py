"""The topics of a run record: their names, and the ROS 2 types of their messages.

What goes over Zenoh stands under its key with a leading slash; what the server adds stands beside it.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

from revnm_client import keys
from revnm_server.recording.ros import type_store


class Topic(NamedTuple):
    """A topic.

    Attributes:
        name: With its leading slash.
        type: Of its messages, such as ``sensor_msgs/msg/LaserScan``.
    """

    name: str
    type: str


_STRING = "std_msgs/msg/String"

TRANSFORMS = Topic("/tf", "tf2_msgs/msg/TFMessage")
STILL_TRANSFORMS = Topic("/tf_static", "tf2_msgs/msg/TFMessage")
DIAGNOSTICS = Topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
LOG = Topic("/rosout", "rcl_interfaces/msg/Log")
TICKS = Topic("/revnm/tick", _STRING)
"""What each tick was given and what it planned, as JSON: see :mod:`revnm_server.recording.tick_document`."""


def scan(robot: str) -> Topic:
    """As the robot sent it."""
    return Topic("/" + keys.scan(robot), "sensor_msgs/msg/LaserScan")


def odometry(robot: str) -> Topic:
    """As the robot sent it."""
    return Topic("/" + keys.odom(robot), "nav_msgs/msg/Odometry")


def velocity(robot: str) -> Topic:
    """As the client sent it to the robot's base."""
    return Topic("/" + keys.cmd_vel(robot), "geometry_msgs/msg/Twist")


def waypoints(robot: str) -> Topic:
    """As the server sent them."""
    return Topic("/" + keys.waypoints(robot), "nav_msgs/msg/Path")


def ticket(robot: str) -> Topic:
    """The attachment of the waypoints, JSON: epoch, seq and goal."""
    return Topic(f"/{keys.waypoints(robot)}/ticket", _STRING)


def state(robot: str) -> Topic:
    """The robot's own JSON as it sent it, in a String."""
    return Topic("/" + keys.state(robot), _STRING)


def ego_depth(robot: str) -> Topic:
    """What the networks imagine that the robot sees, in [−1, 1]."""
    return Topic(f"/{keys.check_name(robot)}/revnm/ego_depth", "sensor_msgs/msg/Image")


def way(robot: str) -> Topic:
    """The planner's whole way on the floor."""
    return Topic(f"/{keys.check_name(robot)}/revnm/way", "nav_msgs/msg/Path")


def goal(robot: str) -> Topic:
    """Where the goal is on the floor."""
    return Topic(f"/{keys.check_name(robot)}/goal", "geometry_msgs/msg/PoseStamped")


def goal_pixel(robot: str) -> Topic:
    """Where the goal is in the picture: x is u, y is v, pixels."""
    return Topic(f"/{keys.check_name(robot)}/goal_pixel", "geometry_msgs/msg/PointStamped")


def picture(camera: str) -> Topic:
    """What a tick saw, JPEG."""
    return Topic("/" + keys.image(camera), "sensor_msgs/msg/CompressedImage")


def camera_info(camera: str) -> Topic:
    """What is known of the camera."""
    return Topic(f"/{keys.check_name(camera)}/camera_info", "sensor_msgs/msg/CameraInfo")


def depth(camera: str) -> Topic:
    """The picture's disparity in thousandths of its range: viewers show 1000, the nearest, as a metre."""
    return Topic(f"/{keys.check_name(camera)}/depth", "sensor_msgs/msg/Image")


@functools.cache
def schema_text(type_name: str) -> bytes:
    """Return the definition of a type and of those in it, in ROS 2's message language."""
    return type_store().generate_msgdef(type_name, ros_version=2)[0].encode()
