"""A robot's odometry at the times of pictures, and its drives: stretches without a jump. Imports numpy only."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

from revnm_client.geometry import Pose2, interpolate
from revnm_client.messages import Odometry
from revnm_server.calibration.keyframes import Travel

_KEPT_NS = 3_000_000_000
_SLACK_NS = 50_000_000
_LONGEST_GAP_NS = 500_000_000
_FASTEST_MPS = 2.0
_FASTEST_RADPS = 4.0
_SLACK_M, _SLACK_RAD = 0.05, 0.1


class OdometryTrack:
    """The last seconds of one robot's odometry.

    Attributes:
        drive: Number of the present drive; a new one begins when odometry jumps, goes back in time or leaves out more
            than half a second while the robot moves on.
    """

    def __init__(self, first_drive: int) -> None:
        """Begin with a drive's number; the next ones count up from it by 1."""
        self.drive = first_drive
        self._points: deque[tuple[int, Travel]] = deque()

    def push(self, odometry: Odometry) -> None:
        """Take the newest odometry."""
        if not self._points:
            self._points.append((odometry.stamp_ns, Travel(odometry.odom_from_robot)))
            return
        before_ns, before = self._points[-1]
        if odometry.stamp_ns == before_ns:
            return
        if _jumped(before.odom_from_robot, odometry.odom_from_robot, odometry.stamp_ns - before_ns):
            self.drive += 1
            self._points.clear()
            self._points.append((odometry.stamp_ns, Travel(odometry.odom_from_robot)))
            return
        self._points.append((odometry.stamp_ns, before.on(odometry.odom_from_robot)))
        while self._points[0][0] < odometry.stamp_ns - _KEPT_NS:
            self._points.popleft()

    def at(self, stamp_ns: int) -> Travel | None:
        """Return the travel at a time, nanoseconds; None where this drive has no odometry near it."""
        if not self._points:
            return None
        after = next((i for i, (stamp, _) in enumerate(self._points) if stamp >= stamp_ns), len(self._points))
        if after == len(self._points):
            stamp, travel = self._points[-1]
            return travel if stamp_ns - stamp <= _LONGEST_GAP_NS else None
        stamp, travel = self._points[after]
        if after == 0:
            return travel if stamp - stamp_ns <= _SLACK_NS else None
        return _between(*self._points[after - 1], stamp, travel, stamp_ns)


def _between(a_ns: int, a: Travel, b_ns: int, b: Travel, stamp_ns: int) -> Travel:
    fraction = (stamp_ns - a_ns) / (b_ns - a_ns)
    pose = interpolate(a.odom_from_robot, b.odom_from_robot, fraction)
    return replace(
        a,
        odom_from_robot=pose,
        forward_m=a.forward_m + fraction * (b.forward_m - a.forward_m),
        way_m=a.way_m + fraction * (b.way_m - a.way_m),
        turn_rad=a.turn_rad + fraction * (b.turn_rad - a.turn_rad),
    )


def _jumped(before: Pose2, after: Pose2, passed_ns: int) -> bool:
    step = before.inverse() @ after
    way, turn = math.hypot(step.x_m, step.y_m), abs(step.yaw_rad)
    if passed_ns < 0 or (passed_ns > _LONGEST_GAP_NS and (way > _SLACK_M or turn > _SLACK_RAD)):
        return True
    passed_s = passed_ns * 1e-9
    return way > _SLACK_M + _FASTEST_MPS * passed_s or turn > _SLACK_RAD + _FASTEST_RADPS * passed_s
