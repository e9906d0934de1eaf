"""ROS 2 robots whose middleware is rmw_zenoh: no bridge is needed.

A topic's key is ``<domain>/<topic>/<type>/<hash of the type>``, and every message carries an attachment, without
which ROS drops it: sequence number and time, 64 bits each, little endian, and the 16 bytes that tell the publisher,
behind their count. Source: ros2/rmw_zenoh, ``liveliness_utils.cpp`` and ``attachment_helpers.cpp``.
"""

from __future__ import annotations

import itertools
import re
import secrets
import struct
import time
from collections.abc import Sequence

from revnm_client import cdr
from revnm_client.drivers.opening import DriverContext
from revnm_client.drivers.topics import TopicDriver, TopicKeys, velocity_encoder
from revnm_client.errors import ConfigError
from revnm_client.messages import Velocity

ROUTER_ON_THE_ROBOT = "tcp/localhost:7447"
MAX_DOMAIN = 232

_TYPES = {"twist": "geometry_msgs/msg/Twist", "twist_stamped": "geometry_msgs/msg/TwistStamped"}
_TOPIC = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_ANY_HASH = "*"  # what is heard is checked anyway
_NO_HASH = "TypeHashNotSupported"
_GID_BYTES = 16


class RmwZenohDriver(TopicDriver):
    """Scan, odometry and velocity as ROS 2 nodes with rmw_zenoh exchange them.

    The server listens to other keys, so the client sends scans and odometry on.
    """

    def __init__(
        self,
        context: DriverContext,
        *,
        domain: int = 0,
        namespace: str = "",
        scan_topic: str = "scan",
        odom_topic: str = "odom",
        cmd_vel_topic: str = "cmd_vel",
        cmd_vel: str = "twist",
        distro: str = "",
        connect: Sequence[str] | str = ROUTER_ON_THE_ROBOT,
    ) -> None:
        """Subscribe.

        Args:
            context: Robot and session.
            domain: ROS_DOMAIN_ID of the robot's nodes.
            namespace: Before all three topics. Empty, as on a robot alone in its router; robots that share a router
                and a domain need one each.
            scan_topic: sensor_msgs/LaserScan.
            odom_topic: nav_msgs/Odometry.
            cmd_vel_topic: What the base listens to...
            cmd_vel: ...as ``twist`` or ``twist_stamped``.
            distro: ``humble`` for ROS 2 Humble, which knows no hashes; the others need nothing.
            connect: Endpoints of the router, rmw_zenohd; empty is the session to the server.

        Raises:
            ConfigError: An option is wrong.
            LinkError: Told to stop before the router answered.
        """
        self._encode = velocity_encoder(cmd_vel)
        self._sequence = itertools.count(1)
        self._gid = secrets.token_bytes(_GID_BYTES)
        prefix = (
            f"{_checked_domain(domain)}/{_checked_name(namespace)}/" if namespace else f"{_checked_domain(domain)}/"
        )
        hashed = _NO_HASH if _is_humble(distro) else cdr.type_hash(_TYPES[cmd_vel])
        topics = TopicKeys(
            prefix + _key(scan_topic, "sensor_msgs/msg/LaserScan", _ANY_HASH),
            prefix + _key(odom_topic, "nav_msgs/msg/Odometry", _ANY_HASH),
            prefix + _key(cmd_vel_topic, _TYPES[cmd_vel], hashed),
        )
        super().__init__(context, connect, topics, shared=False)

    def _put(self, velocity: Velocity) -> None:
        attachment = struct.pack(f"<qqB{_GID_BYTES}s", next(self._sequence), time.time_ns(), _GID_BYTES, self._gid)
        self._velocity.put(self._encode(velocity), attachment=attachment)


def _key(topic: str, typename: str, hashed: str) -> str:
    package, _, name = typename.split("/")
    return f"{_checked_name(topic)}/{package}::msg::dds_::{name}_/{hashed}"


def _checked_name(name: str) -> str:
    """Return a topic or namespace without its outer slashes."""
    inner = str(name).strip("/")
    if not _TOPIC.fullmatch(inner):
        raise ConfigError(f"driver rmw_zenoh: {name!r} is no name of ROS 2: expected one like scan or front/scan")
    return inner


def _checked_domain(domain: int) -> int:
    if type(domain) is not int or not 0 <= domain <= MAX_DOMAIN:  # a bool would pass isinstance
        raise ConfigError(f"driver rmw_zenoh: domain is {domain!r}: expected an integer from 0 to {MAX_DOMAIN}")
    return domain


def _is_humble(distro: str) -> bool:
    if distro not in ("", "humble"):
        raise ConfigError(f"driver rmw_zenoh: distro is {distro!r}: expected humble, or nothing for newer ones")
    return distro == "humble"
