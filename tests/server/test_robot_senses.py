"""Odometry and scans over a real Zenoh session: all of them, in the server's clock, and nothing that lies."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import zenoh

from revnm_client import keys
from revnm_client.cdr import encode_odometry, encode_scan
from revnm_client.control_messages import encode_state
from revnm_client.geometry import IDENTITY, Pose2
from revnm_client.link import open_client, open_router
from revnm_client.messages import STANDSTILL, Odometry, Scan
from revnm_server.robots.robot_senses import RobotSenses

from .free_port import free_port
from .waiting import eventually

MS = 1_000_000
ODOM, SCAN = keys.odom("rover"), keys.scan("rover")
Sessions = tuple[zenoh.Session, zenoh.Session]


@pytest.fixture(scope="module")
def sessions() -> Iterator[Sessions]:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with open_router([endpoint]) as router, open_client([endpoint]) as client:
        yield router, client


class Ears:
    """Senses that keep what they heard."""

    def __init__(self, sessions: Sessions) -> None:
        self.senses = RobotSenses(sessions[0], "rover")
        self.client = sessions[1]
        self.odometry: list[Odometry] = []
        self.scans: list[Scan] = []

    def listen(self) -> bool:
        heard = self.senses.listen()
        self.odometry += heard.odometry
        self.scans += heard.scans
        return True

    def rejected(self, key: str) -> int:
        self.listen()
        return self.senses.rejected[key]

    def say(self, **changes: object) -> None:
        state = {"robot": "rover", "moving": False, "reason": None, "stopped": False, "epoch": 0}
        self.client.put(keys.state("rover"), encode_state(state | changes))  # type: ignore[operator]


@pytest.fixture
def ears(sessions: Sessions) -> Iterator[Ears]:
    made = Ears(sessions)
    # Wait until what the client sends arrives: garbage is counted.
    eventually(lambda: made.client.put(ODOM, b"?") or made.rejected(ODOM))
    made.client.put(SCAN, b"?")
    eventually(lambda: made.rejected(SCAN))  # what was sent before has come, too
    yield made
    made.senses.close()


def odometry(stamp_ns: int, x_m: float = 0.0) -> Odometry:
    return Odometry(stamp_ns, Pose2(x_m, 0.0, 0.0), STANDSTILL)


def scan(stamp_ns: int) -> Scan:
    return Scan(stamp_ns, -1.0, 0.5, 0.1, 8.0, np.full(5, 2.0, np.float32))


def test_every_odometry_since_the_last_time_is_heard_in_order(ears: Ears) -> None:
    start_ns = time.time_ns()
    for index in range(60):
        ears.client.put(ODOM, encode_odometry(odometry(start_ns + index * MS, x_m=0.01 * index)))
    ears.client.put(SCAN, encode_scan(scan(start_ns)))
    eventually(lambda: ears.listen() and len(ears.odometry) >= 60 and ears.scans)
    assert [each.stamp_ns - start_ns for each in ears.odometry] == [index * MS for index in range(60)]
    assert ears.odometry[-1].odom_from_robot.x_m == pytest.approx(0.59)
    assert ears.scans[0].stamp_ns == start_ns


def test_the_offset_that_the_robot_tells_is_added(ears: Ears) -> None:
    hour_ms = 3_600_000
    ears.say(clock_offset_ms=-hour_ms)  # the robot's clock is an hour ahead
    stamp_ns = time.time_ns()

    def heard() -> bool:
        ears.client.put(ODOM, encode_odometry(odometry(stamp_ns + hour_ms * MS)))
        return ears.listen() and bool(ears.odometry)

    eventually(heard)
    assert ears.odometry[0].stamp_ns == stamp_ns


def test_small_changes_of_the_offset_do_not_move_stamps(ears: Ears) -> None:
    clock = ears.senses._clock
    clock.hear({"clock_offset_ms": 100.0})
    clock.hear({"clock_offset_ms": 115.0})
    assert clock.offset_ns == 100 * MS
    clock.hear({"clock_offset_ms": 130.0})
    assert clock.offset_ns == 130 * MS
    clock.hear({"v_mps": 1.0})
    assert clock.offset_ns == 130 * MS


@pytest.mark.parametrize("told", [None, "much", True, 1e300])
def test_a_robot_that_does_not_know_its_offset_is_not_believed(ears: Ears, told: object) -> None:
    before = ears.rejected(ODOM)
    ears.say(clock_offset_ms=told)
    eventually(lambda: ears.listen() and ears.senses._clock.offset_ns is None)
    ears.odometry.clear()
    ears.client.put(ODOM, encode_odometry(odometry(time.time_ns())))
    eventually(lambda: ears.rejected(ODOM) > before)
    assert ears.odometry == []


@pytest.mark.parametrize("off_s", [-30, 3])
def test_stamps_that_are_off_are_refused_and_counted(ears: Ears, off_s: int) -> None:
    before, scans_before = ears.rejected(ODOM), ears.rejected(SCAN)
    wrong_ns = time.time_ns() + off_s * 1_000_000_000
    ears.client.put(ODOM, encode_odometry(odometry(wrong_ns)))
    ears.client.put(SCAN, encode_scan(replace(scan(0), stamp_ns=wrong_ns)))
    eventually(lambda: ears.rejected(ODOM) == before + 1 and ears.rejected(SCAN) == scans_before + 1)
    assert (ears.odometry, ears.scans) == ([], [])


def test_garbage_is_counted_and_changes_nothing(ears: Ears) -> None:
    before = ears.rejected(SCAN)
    for payload in (b"", b"\x00" * 64, encode_odometry(odometry(1)), b"\xff" * 999):
        ears.client.put(SCAN, payload)
    eventually(lambda: ears.rejected(SCAN) == before + 4)
    assert ears.scans == []


def test_scans_have_the_mounting_that_the_robot_tells(ears: Ears) -> None:
    def heard() -> bool:
        ears.client.put(SCAN, encode_scan(scan(time.time_ns())))
        return ears.listen() and bool(ears.scans)

    eventually(heard)
    assert ears.scans[-1].robot_from_lidar == IDENTITY
    ears.say(lidar_x_m=0.1, lidar_y_m=-0.2, lidar_yaw_rad=3)
    eventually(lambda: heard() and ears.scans[-1].robot_from_lidar == Pose2(0.1, -0.2, 3.0))
    ears.say(lidar_x_m="ahead", lidar_y_m=0.0, lidar_yaw_rad=0.0)
    ears.say(lidar_x_m=1e9, lidar_y_m=0.0, lidar_yaw_rad=0.0)
    ears.say(lidar_yaw_rad=0.0)
    ears.client.put(SCAN, b"?")
    before = ears.rejected(SCAN)
    eventually(lambda: ears.client.put(SCAN, b"?") or ears.rejected(SCAN) > before)  # what was said before has come
    ears.scans.clear()
    eventually(heard)
    assert ears.scans[-1].robot_from_lidar == Pose2(0.1, -0.2, 3.0)
