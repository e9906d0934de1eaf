"""Which floor around the robot has been seen in the last two seconds: as long as obstacles are remembered.

Floor that was seen longer ago may have something on it that has been forgotten since.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray, Pose2
from revnm_client.messages import Scan
from revnm_client.obstacle_memory import KEEP_NS, hidden


class SeenFloor:
    """The last scans, with the poses that they were taken at."""

    def __init__(self) -> None:
        self._scans: deque[tuple[Scan, Pose2]] = deque()

    def clear(self) -> None:
        """Forget everything."""
        self._scans.clear()

    def add(self, scan: Scan, odom_from_robot: Pose2) -> None:
        """Take in a scan and the robot's pose at its stamp."""
        self._scans.append((scan, odom_from_robot))
        while self._scans[0][0].stamp_ns <= scan.stamp_ns - KEEP_NS:
            self._scans.popleft()

    @property
    def newest(self) -> Scan:
        """The newest scan; call it after the first."""
        return self._scans[-1][0]

    def seen(self, points_m: FloatArray, odom_from_robot: Pose2) -> NDArray[np.bool_]:
        """Tell which points (M, 2), in the frame of a robot that now stands there, any of the scans saw."""
        points = odom_from_robot.apply(points_m)
        found = np.zeros(len(points_m), dtype=np.bool_)
        for scan, pose in self._scans:
            found |= ~hidden(pose.inverse().apply(points), scan)
        return found
