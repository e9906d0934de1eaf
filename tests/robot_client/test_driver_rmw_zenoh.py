"""The driver for rmw_zenoh against a router and peers that put and listen as ROS 2 nodes do."""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest
import zenoh
from zenoh.ext import Int64, z_deserialize, z_serialize

from revnm_client import cdr
from revnm_client.drivers import DriverContext, open_driver
from revnm_client.errors import ConfigError, LinkError
from revnm_client.geometry import Pose2
from revnm_client.link import LatestSubscriber, open_client
from revnm_client.messages import STANDSTILL, Odometry, Scan, Velocity

# From the sources of ROS 2 Jazzy, as `ros2 topic info -v` shows them.
TWIST = "geometry_msgs::msg::dds_::Twist_/RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a"
TWIST_STAMPED = (
    "geometry_msgs::msg::dds_::TwistStamped_/RIHS01_5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64"
)
SCAN_OF_ANOTHER_DISTRO = f"sensor_msgs::msg::dds_::LaserScan_/RIHS01_{'5' * 64}"
ODOMETRY = "nav_msgs::msg::dds_::Odometry_/RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"


@pytest.fixture
def context(client: zenoh.Session) -> DriverContext:
    return DriverContext("rover", client)


@pytest.fixture
def peer(router: zenoh.Session, endpoint: str) -> Iterator[zenoh.Session]:
    """A node on the robot, beside the router."""
    with open_client([endpoint]) as session:
        yield session


def scan(range_m: float) -> bytes:
    ranges = np.full(8, range_m, dtype=np.float32)
    return cdr.encode_scan(Scan(5, -math.pi, math.tau / 8, 0.1, 10.0, ranges))


def odometry(x_m: float) -> bytes:
    return cdr.encode_odometry(Odometry(5, Pose2(x_m, 0.0, 0.0), STANDSTILL))


def taken(take, put, eventually):
    """Put until something is taken, and return it: a subscription takes its time to get about."""
    found = None

    def comes() -> bool:
        nonlocal found
        put()
        found = take()
        return found is not None

    eventually(comes)
    return found


def test_the_type_hashes_are_those_of_ros():
    assert TWIST.endswith(cdr.type_hash("geometry_msgs/msg/Twist"))
    assert TWIST_STAMPED.endswith(cdr.type_hash("geometry_msgs/msg/TwistStamped"))
    assert ODOMETRY.endswith(cdr.type_hash("nav_msgs/msg/Odometry"))
    assert cdr.type_hash("std_msgs/msg/String").startswith("RIHS01_df668c740482bbd48fb39d76a70dfd4b")


def test_it_hears_its_robot_whatever_the_hash_and_nobody_else(context, endpoint, peer, eventually):
    options = {"domain": 7, "namespace": "/bot1", "scan_topic": "front/scan", "connect": endpoint}
    with closing(open_driver("rmw_zenoh", options, context)) as driver:

        def put() -> None:
            for strange in ("0/bot1", "7/bot2", "7", "77/bot1"):  # another domain, another robot
                peer.put(f"{strange}/front/scan/{SCAN_OF_ANOTHER_DISTRO}", scan(9.0))
                peer.put(f"{strange}/odom/{ODOMETRY}", odometry(9.0))
            peer.put(f"7/bot1/scan/{SCAN_OF_ANOTHER_DISTRO}", scan(9.0))  # another topic
            peer.put("7/bot1/front/scan/sensor_msgs::msg::dds_::PointCloud2_/RIHS01_0", scan(9.0))  # another type
            peer.put(f"7/bot1/front/scan/{SCAN_OF_ANOTHER_DISTRO}", scan(2.0), attachment=bytes(33))
            peer.put(f"7/bot1/odom/{ODOMETRY}", odometry(1.0), attachment=bytes(33))

        heard = [taken(driver.take_scan, put, eventually) for _ in range(5)]
        assert {float(scan.ranges_m[0]) for scan in heard} == {2.0}
        places = [taken(driver.take_odometry, put, eventually).odom_from_robot.x_m for _ in range(5)]
        assert set(places) == {1.0}
        assert not driver.shared
        assert driver.trouble() is None
        assert driver.rejected == 0


def test_malformed_messages_are_counted(context, endpoint, peer, eventually):
    with closing(open_driver("rmw_zenoh", {"connect": endpoint}, context)) as driver:
        eventually(
            lambda: (
                peer.put(f"0/scan/{SCAN_OF_ANOTHER_DISTRO}", b"\0\1\0\0") or driver.take_scan() or driver.rejected > 3
            )
        )
        assert "0/scan" in driver.last_error
        assert taken(driver.take_odometry, lambda: peer.put(f"0/odom/{ODOMETRY}", odometry(1.0)), eventually)


@pytest.mark.parametrize(
    ("options", "key", "offset"),
    [
        ({}, f"3/cmd_vel/{TWIST}", 4),
        ({"cmd_vel": "twist_stamped", "cmd_vel_topic": "/base/cmd_vel"}, f"3/base/cmd_vel/{TWIST_STAMPED}", 28),
        ({"distro": "humble"}, "3/cmd_vel/geometry_msgs::msg::dds_::Twist_/TypeHashNotSupported", 4),
    ],
)
def test_velocities_are_what_ros_expects(context, endpoint, peer, eventually, options, key, offset):
    subscriber = LatestSubscriber(peer, key)
    driver = open_driver("rmw_zenoh", {"domain": 3, "connect": endpoint, **options}, context)
    first = taken(subscriber.take, lambda: driver.drive(Velocity(0.25, -0.5)), eventually)
    second = taken(subscriber.take, lambda: driver.drive(Velocity(0.25, -0.5)), eventually)
    assert struct.unpack_from("<6d", first.payload.to_bytes(), offset) == (0.25, 0.0, 0.0, 0.0, 0.0, -0.5)

    attachments = [sample.attachment.to_bytes() for sample in (first, second)]
    for attachment in attachments:
        sequence, time_ns, gid = z_deserialize(tuple[Int64, Int64, bytes], zenoh.ZBytes(attachment))
        assert len(attachment) == 33
        assert attachment == bytes(z_serialize((Int64(sequence), Int64(time_ns), gid)))
        assert len(gid) == 16
        assert abs(time_ns * 1e-9 - time.time()) < 60.0
    assert attachments[0][-17:] == attachments[1][-17:]  # one publisher
    assert attachments[0][:8] != attachments[1][:8]
    subscriber.drain()
    driver.close()
    last = taken(subscriber.take, lambda: None, eventually)
    assert last.payload.to_bytes()[-48:] == bytes(48)  # standstill


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"domain": 233}, "domain is 233: expected an integer from 0 to 232"),
        ({"domain": "0"}, "domain is '0'"),
        ({"domain": True}, "domain is True"),
        ({"namespace": "a//b"}, "'a//b' is no name of ROS 2"),
        ({"scan_topic": ""}, "'' is no name"),
        ({"odom_topic": "odom*"}, "is no name"),
        ({"cmd_vel_topic": "2fast"}, "is no name"),
        ({"cmd_vel": "ackermann"}, "expected twist or twist_stamped"),
        ({"distro": "foxy"}, "distro is 'foxy': expected humble"),
        ({"connect": "nowhere"}, "endpoints are nowhere"),
    ],
)
def test_wrong_options_are_refused(context, options, message):
    with pytest.raises(ConfigError, match=message):
        open_driver("rmw_zenoh", options, context)


def test_it_can_be_stopped_while_it_waits_for_the_router(context):
    context.stop.set()
    with pytest.raises(LinkError, match="gave up connecting to tcp/localhost:1"):
        open_driver("rmw_zenoh", {"connect": "tcp/localhost:1"}, context)
