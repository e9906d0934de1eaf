"""Zenoh keys of the contract.

They follow zenoh-bridge-ros2dds (a ROS name without its leading slash, behind the robot's namespace), so that
a ROS 2 robot needs only the bridge. Source: eclipse-zenoh/zenoh-plugin-ros2dds, ``ros2_utils.rs``.
"""

from __future__ import annotations

import re

from revnm_client.errors import ConfigError

_NAME = re.compile(r"[A-Za-z0-9_-]{1,32}")


def check_name(name: str) -> str:
    """Return ``name`` if it may stand in a key as a robot's or camera's name.

    Raises:
        ConfigError: It does not match ``[A-Za-z0-9_-]{1,32}``.
    """
    if not _NAME.fullmatch(name):
        raise ConfigError(f"{name!r} is no robot or camera name: expected 1 to 32 of A-Z a-z 0-9 _ -")
    return name


def scan(robot: str) -> str:
    """Robot → all: sensor_msgs/LaserScan."""
    return f"{check_name(robot)}/scan"


def odom(robot: str) -> str:
    """Robot → all: nav_msgs/Odometry."""
    return f"{check_name(robot)}/odom"


def cmd_vel(robot: str) -> str:
    """Client → base: geometry_msgs/Twist."""
    return f"{check_name(robot)}/cmd_vel"


def waypoints(robot: str) -> str:
    """Server → robot: nav_msgs/Path with the plan attachment."""
    return f"{check_name(robot)}/waypoints"


def state(robot: str) -> str:
    """Robot → all: state as JSON, 2 Hz."""
    return f"{check_name(robot)}/revnm/state"


def stop(robot: str) -> str:
    """Queryable of the robot: stop and resume; its reply is the acknowledgement."""
    return f"{check_name(robot)}/revnm/stop"


def time(robot: str) -> str:
    """Queryable of the server: its clock, for the robot's offset estimate."""
    return f"{check_name(robot)}/revnm/time"


def image(camera: str) -> str:
    """Simulated camera → server: sensor_msgs/CompressedImage."""
    return f"{check_name(camera)}/image/compressed"
