"""The example of a driver of one's own, against a base and a LiDAR behind pseudo terminals."""

from __future__ import annotations

import os
import pty
import sys
import time
import tty
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import pytest
import zenoh

from revnm_client.drivers import DriverContext, RobotDriver, open_driver
from revnm_client.errors import LinkError
from revnm_client.geometry import Pose2
from revnm_client.messages import Velocity

pytest.importorskip("serial", reason="pyserial is not installed")

EXAMPLES = Path(__file__).parents[2] / "robot_client" / "examples"
RANGES = " ".join(["1500"] * 90 + ["0"] * 270)


class Port(NamedTuple):
    """Our end of a serial line, and the name of the robot's."""

    fd: int
    name: str

    def say(self, line: str) -> None:
        os.write(self.fd, line.encode())

    def lines(self) -> list[str]:
        try:
            return os.read(self.fd, 65536).decode().splitlines()
        except BlockingIOError:
            return []


@pytest.fixture
def ports() -> Iterator[tuple[Port, Port]]:
    """Base and LiDAR."""
    ends = [pty.openpty() for _ in range(2)]
    for ours, theirs in ends:
        tty.setraw(theirs)
        os.set_blocking(ours, False)
    yield tuple(Port(ours, os.ttyname(theirs)) for ours, theirs in ends)
    for fd in (fd for end in ends for fd in end):
        try:
            os.close(fd)
        except OSError:  # closed by a test
            continue


@pytest.fixture
def context(client: zenoh.Session, monkeypatch: pytest.MonkeyPatch) -> Iterator[DriverContext]:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    yield DriverContext("rover", client)
    sys.modules.pop("serial_robot", None)


@pytest.fixture
def driver(context: DriverContext, ports: tuple[Port, Port]) -> Iterator[RobotDriver]:
    options = {"base": ports[0].name, "lidar": ports[1].name}
    with closing(open_driver("serial_robot:SerialRobot", options, context)) as driver:
        yield driver


def taken(take, eventually):
    found = []
    eventually(lambda: (item := take()) is not None and (found.append(item) or True))
    return found[0]


def test_it_measures_and_drives(driver, ports, eventually):
    base, lidar = ports
    base.say("O 1.5 -2 0.25 0.1 ")
    base.say("-0.2\n")
    odometry = taken(driver.take_odometry, eventually)
    assert (odometry.odom_from_robot, odometry.velocity) == (Pose2(1.5, -2.0, 0.25), Velocity(0.1, -0.2))
    lidar.say(f"S {RANGES}\n")
    scan = taken(driver.take_scan, eventually)
    assert len(scan.points_m()) == 90
    assert scan.points_m()[0].tolist() == [1.5, 0.0]
    assert abs(scan.stamp_ns - time.time_ns()) < 5_000_000_000
    assert driver.take_scan() is None
    driver.drive(Velocity(0.25, -0.5))
    eventually(lambda: base.lines() == ["V 0.250 -0.500"])
    assert driver.trouble() is None
    assert driver.rejected == 0


@pytest.mark.parametrize(
    ("lidar", "line", "message"),
    [
        (False, "O 1 2 nan 0 0\n", "yaw is nan"),
        (False, "O 1 2 3 11 0\n", "v is 11.0: expected -10.0 to 10.0"),
        (False, "O 1 2 3\n", "O' and 3 numbers: expected O and 5"),
        (False, "O 1 2 x 0 0\n", "could not convert"),
        (False, "\n", "missing"),
        (False, "O" * 5000, "and 0 numbers"),
        (True, f"S {RANGES} 1500\n", "scan has 361 beams: expected 360 to 360"),
        (True, f"S {RANGES[:-1]}-1\n", "range of beam 359 is -0.001"),
        (True, "\xff\0\n", "expected S"),
    ],
)
def test_what_is_malformed_is_counted(driver, ports, eventually, lidar, line, message):
    ports[lidar].say(line)
    eventually(lambda: driver.rejected == 1)
    assert message in driver.last_error
    assert driver.take_odometry() is None
    assert driver.take_scan() is None


def test_it_stands_at_last(context, ports):
    base, lidar = ports
    driver = open_driver("serial_robot:SerialRobot", {"base": base.name, "lidar": lidar.name}, context)
    driver.drive(Velocity(0.25, 0.0))
    driver.close()
    assert base.lines() == ["V 0.250 0.000", "V 0.000 0.000"]


def test_a_cable_that_is_pulled_is_told(context, eventually):
    ends = [pty.openpty() for _ in range(2)]
    names = [os.ttyname(theirs) for _, theirs in ends]
    driver = open_driver("serial_robot:SerialRobot", {"base": names[0], "lidar": names[1]}, context)
    for fd in (fd for end in ends for fd in end):
        os.close(fd)
    eventually(lambda: "is gone" in str(driver.trouble()))
    with pytest.raises(LinkError, match="cannot send a velocity"):
        driver.drive(Velocity(0.0, 0.0))
    with pytest.raises(LinkError, match="cannot send"):
        driver.close()


def test_a_port_that_is_none_is_refused(context):
    with pytest.raises(LinkError, match=r"cannot open the robot: .*/dev/none"):
        open_driver("serial_robot:SerialRobot", {"base": "/dev/none", "lidar": "/dev/none"}, context)
