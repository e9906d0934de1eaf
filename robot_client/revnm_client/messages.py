"""The messages between server, robot and simulator, as plain data.

These are what the program works with; :mod:`revnm_client.cdr` turns them to and from ROS 2 CDR and checks
every decoded one, so code that holds one of these can trust it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import IDENTITY, FloatArray, Pose2


@dataclass(frozen=True, slots=True)
class Scan:
    """One turn of a 2D LiDAR (sensor_msgs/LaserScan).

    Attributes:
        stamp_ns: Time of the first beam, nanoseconds, clock of the sender.
        angle_min_rad: Angle of beam 0 in the LiDAR's frame, counter-clockwise from its forward.
        angle_increment_rad: Angle between beams; not 0.
        range_min_m: Shortest range that the sensor reports, over 0.
        range_max_m: Longest range that the sensor reports.
        ranges_m: (N,) float32; a beam outside [range_min_m, range_max_m], inf included, has no return.
        robot_from_lidar: Where the LiDAR sits on the robot; no message tells it, the robot's settings do.
    """

    stamp_ns: int
    angle_min_rad: float
    angle_increment_rad: float
    range_min_m: float
    range_max_m: float
    ranges_m: NDArray[np.float32]
    robot_from_lidar: Pose2 = IDENTITY

    @property
    def sees(self) -> NDArray[np.bool_]:
        """(N,): whether a beam sees anything, if only that nothing is in range; drivers report masked beams as 0."""
        return self.ranges_m >= self.range_min_m  # False for what is no number

    @property
    def hits(self) -> NDArray[np.bool_]:
        """(N,): whether a beam ended at something."""
        return self.sees & (self.ranges_m < self.range_max_m)

    def points_m(self) -> FloatArray:
        """Return the hits (M, 2), M ≤ N, metres, in the robot frame."""
        index = np.flatnonzero(self.hits)
        angles = self.angle_min_rad + self.angle_increment_rad * index
        ranges = self.ranges_m[index].astype(np.float64)
        points = np.stack([ranges * np.cos(angles), ranges * np.sin(angles)], axis=1)  # (M, 2), the LiDAR's frame
        return points if self.robot_from_lidar == IDENTITY else self.robot_from_lidar.apply(points)


@dataclass(frozen=True, slots=True)
class Mounting:
    """What no scan tells of its LiDAR.

    Attributes:
        robot_from_lidar: Where it sits.
        zero_is_open: Its driver says 0 where nothing is in range, as some do, and not that it sees nothing.
    """

    robot_from_lidar: Pose2 = IDENTITY
    zero_is_open: bool = False

    def place(self, scan: Scan) -> Scan:
        """Return the scan as the robot has it."""
        ranges = scan.ranges_m
        if self.zero_is_open:
            ranges = np.where(ranges == 0.0, np.float32(np.inf), ranges)
        return replace(scan, ranges_m=ranges, robot_from_lidar=self.robot_from_lidar)


@dataclass(frozen=True, slots=True)
class Odometry:
    """Wheel odometry (nav_msgs/Odometry).

    Attributes:
        stamp_ns: Time of the measurement, nanoseconds, clock of the sender.
        odom_from_robot: Pose of the robot in its drifting odometry frame.
        velocity: Measured velocity in the robot frame.
    """

    stamp_ns: int
    odom_from_robot: Pose2
    velocity: Velocity


@dataclass(frozen=True, slots=True)
class Velocity:
    """A velocity of a differential-drive robot (geometry_msgs/Twist).

    Attributes:
        v_mps: Forward, metres per second.
        w_radps: Turning, radians per second, counter-clockwise.
    """

    v_mps: float
    w_radps: float


STANDSTILL = Velocity(0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Plan:
    """Waypoints from the server (nav_msgs/Path; epoch, seq, goal id and server in the attachment).

    Attributes:
        stamp_ns: Capture time of the picture that the plan was made from, server's clock.
        waypoints_m: (H, 2), metres, in the robot frame at the capture time; the last one may be repeated
            where the goal is nearer than the plan is long.
        epoch: Raised by every stop; a robot refuses plans of an older epoch.
        seq: Counts up within an epoch.
        goal_id: The goal that the plan leads to.
        server: Who made it: a robot follows one server at a time.
    """

    stamp_ns: int
    waypoints_m: FloatArray
    epoch: int
    seq: int
    goal_id: str
    server: str = ""


@dataclass(frozen=True, slots=True)
class CompressedImage:
    """An encoded picture (sensor_msgs/CompressedImage).

    Attributes:
        stamp_ns: Capture time, nanoseconds, clock of the sender.
        format: ``"jpeg"`` or ``"png"``.
        data: The encoded bytes.
    """

    stamp_ns: int
    format: str
    data: bytes
