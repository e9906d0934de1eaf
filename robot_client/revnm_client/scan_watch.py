"""Notices a LiDAR that repeats itself: its stamps go on, and what it shows is old."""

from __future__ import annotations

import math

import numpy as np

from revnm_client.geometry import Pose2, wrap_angle
from revnm_client.messages import Scan

_MOVED_M = 0.03  # or turned: by so much some of hundreds of beams differ, even of a LiDAR that rounds to a centimetre
_TURNED_RAD = 0.03


class ScanWatch:
    """Compares each scan with the one before.

    Attributes:
        stuck: The ranges stay the same, to the last bit, while the robot has moved by 3 cm or turned by 2°. Without a
            single return nothing can be told: in the open that is what a good LiDAR says, too.
    """

    def __init__(self) -> None:
        self.stuck = False
        self._first: tuple[Scan, Pose2] | None = None

    def look(self, scan: Scan, odom_from_robot: Pose2) -> None:
        """Take in a scan, and where the robot was at its stamp."""
        if self._first is None or not _same(self._first[0], scan):
            self._first, self.stuck = (scan, odom_from_robot), False
            return
        before = self._first[1]
        moved = math.hypot(odom_from_robot.x_m - before.x_m, odom_from_robot.y_m - before.y_m) > _MOVED_M
        turned = abs(wrap_angle(odom_from_robot.yaw_rad - before.yaw_rad)) > _TURNED_RAD
        self.stuck = self.stuck or moved or turned

    def forget(self) -> None:
        """Start anew: the odometry's frame did."""
        self.stuck, self._first = False, None


def _same(first: Scan, second: Scan) -> bool:
    return bool(np.isfinite(second.ranges_m).any()) and np.array_equal(first.ranges_m, second.ranges_m)
