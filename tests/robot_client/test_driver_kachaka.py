"""The driver for Kachaka against a gRPC server that is built from the published stubs."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing

import pytest
import zenoh

grpc = pytest.importorskip("grpc", reason="grpcio is not installed")
pb2 = pytest.importorskip(
    "kachaka_api.generated.kachaka_api_pb2", reason="kachaka-api is not installed: it needs a Python before 3.13"
)

from kachaka_api.generated import kachaka_api_pb2_grpc  # noqa: E402

from revnm_client.drivers import DriverContext, RobotDriver, open_driver  # noqa: E402
from revnm_client.drivers.kachaka.api import message_classes  # noqa: E402
from revnm_client.drivers.kachaka.stamp_clock import StampClock  # noqa: E402
from revnm_client.errors import ConfigError  # noqa: E402
from revnm_client.geometry import Pose2  # noqa: E402
from revnm_client.messages import STANDSTILL, Velocity  # noqa: E402

AHEAD_NS = 3_600_000_000_000  # the robot's clock is an hour ahead
NOT_IN_MANUAL_MODE = 13151


class FakeKachaka(kachaka_api_pb2_grpc.KachakaApiServicer):
    """Answers as docs/GRPC.md of kachaka-api says: what is newer than the cursor, as soon as there is something."""

    def __init__(self) -> None:
        self.velocities: list[tuple[float, float]] = []
        self.modes: list[bool] = []
        self.lidar_s: list[float] = []
        self.errors: list[int] = []
        self.manual = False
        self.grants = True
        self.hangs = threading.Event()
        self._news = threading.Condition()
        self._cursor = 0
        self._scan, self._odometry = (0, None), (0, None)

    def show(self, *, scan=None, odometry=None) -> None:
        with self._news:
            self._cursor += 1
            if scan is not None:
                self._scan = (self._cursor, scan)
            if odometry is not None:
                self._odometry = (self._cursor, odometry)
            self._news.notify_all()

    def wake(self) -> None:
        """End what hangs."""
        self.hangs.clear()
        with self._news:
            self._news.notify_all()

    def _hang(self, context) -> None:
        with self._news:
            while self.hangs.is_set() and context.is_active():
                self._news.wait(0.02)

    def _newer(self, request, context, name: str):
        self._hang(context)
        with self._news:
            while context.is_active():
                cursor, message = getattr(self, name)
                if cursor and cursor != request.metadata.cursor:
                    return pb2.Metadata(cursor=cursor), message
                self._news.wait(0.02)
        return pb2.Metadata(), None

    def GetRosLaserScan(self, request, context):  # noqa: N802
        metadata, scan = self._newer(request, context, "_scan")
        return pb2.GetRosLaserScanResponse(metadata=metadata, scan=scan)

    def GetRosOdometry(self, request, context):  # noqa: N802
        metadata, odometry = self._newer(request, context, "_odometry")
        return pb2.GetRosOdometryResponse(metadata=metadata, odometry=odometry)

    def GetError(self, request, context):  # noqa: N802
        self._hang(context)
        return pb2.GetErrorResponse(error_codes=self.errors)

    def ActivateLaserScan(self, request, context):  # noqa: N802
        self.lidar_s.append(request.duration_sec)
        return pb2.ActivateLaserScanResponse(result=pb2.Result(success=True))

    def SetManualControlEnabled(self, request, context):  # noqa: N802
        self._hang(context)
        self.modes.append(request.enable)
        if self.grants:
            self.manual = request.enable
        code = 0 if self.grants else 10003
        return pb2.SetManualControlEnabledResponse(result=pb2.Result(success=self.grants, error_code=code))

    def SetRobotVelocity(self, request, context):  # noqa: N802
        self._hang(context)
        if not self.manual:
            result = pb2.Result(success=False, error_code=NOT_IN_MANUAL_MODE)
        else:
            self.velocities.append((request.linear, request.angular))
            result = pb2.Result(success=True)
        return pb2.SetRobotVelocityResponse(result=result)


def scan(*, ago_ns: int = 0, **changes):
    fields = {"angle_min": -math.pi, "angle_increment": math.tau / 4, "range_min": 0.1, "range_max": 10.0}
    header = pb2.RosHeader(stamp_nsec=time.time_ns() + AHEAD_NS - ago_ns, frame_id="laser_frame")
    return pb2.RosLaserScan(**{"header": header, "ranges": [1.0, 2.0, 0.0, math.inf], **fields, **changes})


def odometry(**changes):
    half = 0.25
    pose = pb2.Pose3d(
        position=pb2.Vector3(x=1.0, y=-2.0), orientation=pb2.Quaternion(z=math.sin(half), w=math.cos(half))
    )
    twist = pb2.Twist(linear=pb2.Vector3(x=0.125), angular=pb2.Vector3(z=-0.5))
    fields = {
        "header": pb2.RosHeader(stamp_nsec=time.time_ns() + AHEAD_NS, frame_id="odom"),
        "child_frame_id": "base_footprint",
        "pose": pb2.Pose3dWithCovariance(pose=pose, covariance=[0.0] * 36),
        "twist": pb2.TwistWithCovariance(twist=twist, covariance=[0.0] * 36),
    }
    return pb2.RosOdometry(**{**fields, **changes})


def serve(robot: FakeKachaka, port: int):
    server = grpc.server(ThreadPoolExecutor(16), options=[("grpc.so_reuseport", 0)])
    kachaka_api_pb2_grpc.add_KachakaApiServicer_to_server(robot, server)
    assert server.add_insecure_port(f"127.0.0.1:{port}") == port
    server.start()
    return server


@pytest.fixture
def port(endpoint: str) -> int:
    return int(endpoint.rsplit(":", 1)[1])


@pytest.fixture
def robot(port: int) -> Iterator[FakeKachaka]:
    robot = FakeKachaka()
    server = serve(robot, port)
    yield robot
    robot.wake()
    server.stop(0).wait()


@pytest.fixture
def context() -> Iterator[DriverContext]:
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("listen/endpoints", "[]")
    with zenoh.open(config) as session:
        yield DriverContext("rover", session)


@pytest.fixture
def driver(context: DriverContext, robot: FakeKachaka, port: int) -> Iterator[RobotDriver]:
    with closing(open_driver("kachaka", {"address": f"127.0.0.1:{port}"}, context)) as driver:
        yield driver
        robot.wake()


def taken(take: Callable[[], object], eventually):
    found = []
    eventually(lambda: (item := take()) is not None and (found.append(item) or True))
    return found[0]


def test_the_messages_are_those_of_the_published_interface():
    for name, message in message_classes().items():
        published = pb2.DESCRIPTOR.message_types_by_name[name.replace("ResultResponse", "SetRobotVelocityResponse")]
        for field in message.DESCRIPTOR.fields:
            same = published.fields_by_name[field.name]
            assert (field.number, field.type, field.is_repeated) == (same.number, same.type, same.is_repeated), name


def test_scans_and_odometries_come_in_this_machines_clock(driver, robot, eventually):
    robot.show(odometry=odometry())
    seen = taken(driver.take_odometry, eventually)
    assert seen.odom_from_robot == pytest.approx(Pose2(1.0, -2.0, 0.5))
    assert seen.velocity == Velocity(0.125, -0.5)
    assert abs(seen.stamp_ns - time.time_ns()) < 5_000_000_000

    robot.show(scan=scan(ago_ns=200_000_000))  # takes longer than the odometry did
    late = taken(driver.take_scan, eventually)
    assert late.ranges_m.tolist() == [1.0, 2.0, 0.0, math.inf]
    assert (late.angle_min_rad, late.angle_increment_rad) == (-math.pi, math.tau / 4)
    assert 100_000_000 < time.time_ns() - late.stamp_ns < 5_000_000_000
    assert driver.take_scan() is None  # none is taken twice
    assert not driver.shared
    assert driver.rejected == 0
    eventually(lambda: driver.trouble() is None)
    assert robot.lidar_s[0] >= 2.0


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ({"ranges": [1.0, math.nan]}, "range of beam 1 is nan"),
        ({"ranges": [1.0, -1.0]}, "range of beam 1 is -1.0"),
        ({"ranges": []}, "scan has 0 beams"),
        ({"angle_increment": math.nan}, "angle_increment is nan"),
        ({"angle_increment": 0.0}, "beams 0.0 rad apart"),
        ({"range_max": math.inf}, "range_max is inf"),
        ({"header": pb2.RosHeader(stamp_nsec=-1)}, "stamp is -1 ns"),
        ({"header": pb2.RosHeader(stamp_nsec=2**63 - 1)}, "stamp is 9223372036854775807 ns"),
    ],
)
def test_malformed_scans_are_counted_and_displace_nothing(driver, robot, eventually, bad, message):
    robot.show(scan=scan(**bad))
    eventually(lambda: driver.rejected == 1)
    assert message in driver.last_error
    assert driver.take_scan() is None
    robot.show(scan=scan(ranges=[1.0, 1e300]))
    assert taken(driver.take_scan, eventually).ranges_m.tolist() == [1.0, math.inf]
    assert abs(driver.rejected) == 1


def test_malformed_odometry_is_counted(driver, robot, eventually):
    flat = pb2.Pose3dWithCovariance(pose=pb2.Pose3d(position=pb2.Vector3(x=1.0)))
    robot.show(odometry=odometry(pose=flat))
    eventually(lambda: driver.rejected == 1)
    assert "quaternion" in driver.last_error


@pytest.mark.parametrize(
    ("velocity", "wire"),
    [
        (Velocity(0.15, 0.785), (0.5, 0.5)),
        (Velocity(0.3, -1.57), (1.0, -1.0)),
        (Velocity(0.5, 3.0), (1.0, 1.0)),
        (Velocity(-0.3, -9.0), (-1.0, -1.0)),
    ],
)
def test_velocities_are_parts_of_the_greatest(driver, robot, eventually, velocity, wire):
    driver.drive(velocity)
    eventually(lambda: robot.velocities)
    assert robot.velocities[0] == wire
    assert robot.modes == [True]


def test_a_robot_that_only_stands_is_left_alone(driver, robot, eventually):
    for _ in range(5):
        driver.drive(STANDSTILL)
    eventually(lambda: len(robot.lidar_s) >= 2)  # a second has passed
    assert robot.modes == []
    driver.close()
    assert robot.modes == []
    assert robot.velocities == []


def test_a_robot_that_a_client_before_left_driving_is_stopped(context, robot, port, eventually):
    robot.manual = True
    with closing(open_driver("kachaka", {"address": f"127.0.0.1:{port}"}, context)):
        eventually(lambda: robot.velocities == [(0.0, 0.0)])
    assert robot.modes == []


def test_it_stands_when_no_velocity_comes(driver, robot, eventually):
    driver.drive(Velocity(0.15, 0.0))
    eventually(lambda: robot.velocities[-1:] == [(0.0, 0.0)])
    assert robot.velocities[0] == (0.5, 0.0)


def test_at_last_it_stands_and_is_given_back(driver, robot, eventually):
    driver.drive(Velocity(0.15, 0.0))
    eventually(lambda: robot.velocities)
    driver.close()
    assert robot.velocities[-1] == (0.0, 0.0)
    assert robot.modes == [True, False]
    assert not robot.manual


def test_who_takes_the_robot_keeps_it(driver, robot, eventually):
    driver.drive(Velocity(0.15, 0.0))
    eventually(lambda: robot.velocities)
    robot.manual = False
    eventually(lambda: driver.drive(Velocity(0.15, 0.0)) or "somebody took" in str(driver.trouble()))
    before = len(robot.velocities)
    robot.manual = True  # of somebody else now
    driver.drive(STANDSTILL)
    driver.drive(Velocity(0.15, 0.0))
    polls = len(robot.lidar_s)
    eventually(lambda: len(robot.lidar_s) >= polls + 2)  # a second has passed
    driver.close()
    assert "somebody took" in driver.trouble()
    assert len(robot.velocities) == before
    assert robot.modes == [True]


def test_manual_control_that_is_refused_is_asked_for_again(driver, robot, eventually):
    robot.grants = False
    eventually(lambda: driver.drive(Velocity(0.15, 0.0)) or "error 10003" in str(driver.trouble()))
    robot.grants = True
    eventually(lambda: driver.drive(STANDSTILL) or driver.trouble() is None)
    assert robot.manual
    assert set(robot.velocities) == {(0.0, 0.0)}


def test_nothing_blocks_while_the_robot_hangs_and_all_comes_back(driver, robot, eventually):
    robot.show(scan=scan())
    taken(driver.take_scan, eventually)
    driver.drive(Velocity(0.15, 0.0))
    eventually(lambda: robot.velocities)
    robot.hangs.set()
    eventually(lambda: driver.drive(Velocity(0.15, 0.0)) or "DEADLINE_EXCEEDED" in str(driver.trouble()))
    begin_s = time.monotonic()
    for _ in range(1000):
        driver.drive(Velocity(0.15, 0.0))
        driver.take_scan()
        driver.take_odometry()
        driver.trouble()
    assert time.monotonic() - begin_s < 0.5  # a call would have waited for 0.3 s, 1000 times
    robot.wake()
    robot.show(scan=scan())
    assert taken(driver.take_scan, eventually).ranges_m[0] == 1.0
    eventually(lambda: driver.drive(Velocity(0.15, 0.0)) or driver.trouble() is None)


def test_a_robot_that_is_restarted_is_found_again(context, port, eventually):
    robot = FakeKachaka()
    server = serve(robot, port)
    with closing(open_driver("kachaka", {"address": f"127.0.0.1:{port}"}, context)) as driver:
        for _ in range(3):
            robot.show(scan=scan())
        taken(driver.take_scan, eventually)
        server.stop(0).wait()
        eventually(lambda: "does not answer: " in str(driver.trouble()))
        robot = FakeKachaka()  # its cursors begin anew
        server = serve(robot, port)
        robot.show(scan=scan(), odometry=odometry())
        taken(driver.take_scan, eventually)
        taken(driver.take_odometry, eventually)
        eventually(lambda: driver.trouble() is None)
    server.stop(0).wait()


def test_errors_of_the_robot_are_told(driver, robot, eventually):
    eventually(lambda: driver.trouble() is None)
    robot.errors = [12345, 6]
    eventually(lambda: driver.trouble() == "the robot reports error 12345, 6")
    robot.errors = []
    eventually(lambda: driver.trouble() is None)


@pytest.mark.parametrize("address", ["", "http://robot", "robot:port", 26400.5, "a b"])
def test_a_wrong_address_is_refused(context, address):
    with pytest.raises(ConfigError, match="expected host or host:port"):
        open_driver("kachaka", {"address": address}, context)


def test_the_quickest_message_tells_the_difference_of_the_clocks():
    clock, second = StampClock(), 1_000_000_000
    assert clock.here_ns(1000 * second, 5 * second) == 5 * second
    # 0.3 s later by the robot's clock, received after 0.5 s: 0.2 s on the way.
    assert clock.here_ns(1000 * second + 300_000_000, 5 * second + 500_000_000) == 5 * second + 300_000_000
    # The quickest yet: 0.1 s less than the first.
    assert clock.here_ns(1001 * second, 6 * second - 100_000_000) == 6 * second - 100_000_000
    # The robot's clock is set back by 500 s: looks old until ten seconds have passed.
    assert clock.here_ns(502 * second, 7 * second) < -400 * second
    assert clock.here_ns(512 * second, 17 * second) == 17 * second
