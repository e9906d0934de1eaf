"""Notices a LiDAR that cannot be believed: it sees nothing, or repeats itself while its stamps go on."""

from __future__ import annotations

import math

import numpy as np

from revnm_client.geometry import Pose2, wrap_angle
from revnm_client.messages import Scan

STUCK = "scan is stuck: it shows the same while the robot moves"
SEES_NOTHING = "scan sees nothing: is the LiDAR covered, or does it not turn?"

_MOVED_M = 0.03  # or turned: by so much some of hundreds of beams differ, even of a LiDAR that rounds to a centimetre
_TURNED_RAD = 0.03


class ScanWatch:
    """Looks at each scan, and compares it with the one before.

    Attributes:
        trouble: Why the newest scan is not to be believed; None where it is. No beam sees, not even that nothing is in
            range; or the ranges stay the same, to the last bit, while the robot has moved by 3 cm or turned by 2°.
            Without a single return the latter cannot be told: in the open that is what a good LiDAR says, too.
    """

    def __init__(self) -> None:
        self.trouble: str | None = None
        self._first: tuple[Scan, Pose2] | None = None

    def look(self, scan: Scan, odom_from_robot: Pose2) -> None:
        """Take in a scan, and where the robot was at its stamp."""
        if self._first is None or not _same(self._first[0], scan):
            self._first = scan, odom_from_robot
            self.trouble = None if scan.sees.any() else SEES_NOTHING
            return
        before = self._first[1]
        moved = math.hypot(odom_from_robot.x_m - before.x_m, odom_from_robot.y_m - before.y_m) > _MOVED_M
        turned = abs(wrap_angle(odom_from_robot.yaw_rad - before.yaw_rad)) > _TURNED_RAD
        if moved or turned:
            self.trouble = self.trouble or STUCK

    def forget(self) -> None:
        """Start anew: the odometry's frame did."""
        self.trouble, self._first = None, None


def _same(first: Scan, second: Scan) -> bool:
    return bool(second.hits.any()) and np.array_equal(first.ranges_m, second.ranges_m)
