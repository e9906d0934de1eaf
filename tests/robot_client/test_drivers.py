"""The port to the robot: which driver is opened, and what the loop does with one that is not of this package."""

from __future__ import annotations

import sys
import threading
import time
from importlib import import_module

import pytest
import zenoh
from rosbags.typesys import Stores, get_typestore

from revnm_client import cdr, keys
from revnm_client.agent import AgentConfig, RobotAgent
from revnm_client.control_messages import decode_state
from revnm_client.drivers import DriverContext, open_driver
from revnm_client.errors import ConfigError
from revnm_client.geometry import Pose2
from revnm_client.link import Inbox, LatestSubscriber
from revnm_client.messages import STANDSTILL, Odometry, Velocity
from revnm_client.runner import RobotRunner, RunnerSettings

ROBOT = "rover"
OWN = '''
import math, time
import numpy as np
from revnm_client.errors import LinkError
from revnm_client.geometry import Pose2
from revnm_client.messages import STANDSTILL, Odometry, Scan

class Own:
    """Stands in the open; gives its trouble and what it was told to the test."""
    shared, rejected, last_error = False, 0, ""
    told, says, broken, closed = [], None, False, False

    def __init__(self, context, *, beams):
        self.ranges = np.full(beams, 6.0, dtype=np.float32)
        Own.robot = context.robot

    def take_scan(self):
        return Scan(time.time_ns(), -math.pi, math.tau / len(self.ranges), 0.1, 10.0, self.ranges)

    def take_odometry(self):
        return Odometry(time.time_ns(), Pose2(1.0, 2.0, 0.3), STANDSTILL)

    def drive(self, velocity):
        if Own.broken:
            raise LinkError("the cable is out")
        Own.told.append(velocity)

    def trouble(self):
        return Own.says

    def close(self):
        Own.closed = True
'''


@pytest.fixture
def own(tmp_path, monkeypatch):
    """Return the class of a driver that a user has written."""
    (tmp_path / "own_robot.py").write_text(OWN)
    monkeypatch.syspath_prepend(str(tmp_path))
    module = import_module("own_robot")

    yield module.Own
    del sys.modules["own_robot"]


@pytest.fixture
def context(client: zenoh.Session) -> DriverContext:
    return DriverContext(ROBOT, client)


@pytest.mark.parametrize(
    ("kind", "options", "message"),
    [
        ("zeno", {}, "driver zeno: expected zenoh.*package.module:Class"),
        ("zenoh", {"cmdvel": "twist"}, "unexpected keyword argument 'cmdvel': expected options of cmd_vel, connect"),
        ("zenoh", {"cmd_vel": "ackermann"}, "'ackermann': expected twist or twist_stamped"),
        ("no_such_package:Robot", {}, "cannot be loaded: No module named 'no_such_package'"),
        ("revnm_client.agent:Robot", {}, "cannot be loaded: module 'revnm_client.agent' has no attribute 'Robot'"),
    ],
)
def test_a_driver_that_is_none_is_refused(context, kind, options, message):
    with pytest.raises(ConfigError, match=message):
        open_driver(kind, options, context)


def test_zenoh_speaks_stamped_velocities_and_stands_at_last(context, router, eventually):
    subscriber = LatestSubscriber(router, keys.cmd_vel(ROBOT))
    driver = open_driver("zenoh", {"cmd_vel": "twist_stamped"}, context)

    def heard(velocity: Velocity):
        sample = subscriber.take()
        if sample is None:
            driver.drive(velocity)
            return None
        return get_typestore(Stores.ROS2_HUMBLE).deserialize_cdr(
            sample.payload.to_bytes(), "geometry_msgs/msg/TwistStamped"
        )

    message = None

    def arrives() -> bool:
        nonlocal message
        message = heard(Velocity(0.25, -0.5))
        return message is not None

    eventually(arrives)
    assert (message.twist.linear.x, message.twist.angular.z) == (0.25, -0.5)
    assert abs(message.header.stamp.sec + message.header.stamp.nanosec * 1e-9 - time.time()) < 5.0
    subscriber.drain()
    driver.close()
    eventually(lambda: (sample := subscriber.take()) is not None and sample.payload.to_bytes()[-48:] == bytes(48))


def test_zenoh_by_the_router_on_the_robot(context, endpoint, router, eventually):
    driver = open_driver("zenoh", {"connect": endpoint}, context)
    odometry = cdr.encode_odometry(Odometry(5, Pose2(1.0, 0.0, 0.0), STANDSTILL))
    taken = None

    def comes() -> bool:
        nonlocal taken
        router.put(keys.odom(ROBOT), b"garbage")
        router.put(keys.odom(ROBOT), odometry)
        taken = driver.take_odometry()
        return taken is not None

    eventually(comes)
    assert taken == Odometry(5, Pose2(1.0, 0.0, 0.0), STANDSTILL)
    assert driver.shared
    assert driver.trouble() is None
    assert driver.rejected > 0
    assert "rover/odom" in driver.last_error
    driver.close()


def test_a_driver_of_ones_own_drives_the_loop(own, endpoint, router, eventually):
    settings = RunnerSettings(ROBOT, (endpoint,), driver="own_robot:Own", driver_options={"beams": 90})
    runner = RobotRunner(settings, RobotAgent(AgentConfig(robot=ROBOT)))
    scans = Inbox(LatestSubscriber(router, keys.scan(ROBOT)), cdr.decode_scan)
    poses = Inbox(LatestSubscriber(router, keys.odom(ROBOT)), cdr.decode_odometry)
    states = Inbox(LatestSubscriber(router, keys.state(ROBOT)), decode_state)
    stop = threading.Event()
    thread = threading.Thread(target=runner.run, args=(stop,))
    thread.start()
    try:
        scan = None

        def shared() -> bool:
            nonlocal scan
            scan = scans.take() or scan
            return scan is not None and poses.take() is not None

        eventually(shared)  # the server would not hear them else
        assert len(scan.ranges_m) == 90
        assert own.robot == ROBOT
        eventually(lambda: own.told)
        own.says = "a bumper is pressed"
        eventually(lambda: (state := states.take()) is not None and state["reason"] == "a bumper is pressed")
        own.broken = True
        eventually(lambda: runner.failures > 3)
        assert thread.is_alive()
        assert not own.closed
    finally:
        stop.set()
        thread.join(timeout=10.0)
    assert own.closed
    assert set(own.told) == {STANDSTILL}
