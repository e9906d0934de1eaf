"""What the LiDAR saw in the last two seconds and cannot see now.

A place that the newest scan sees is known from that scan alone, so noise does not pile up and things that
moved leave no ghosts. What lies outside its field of view, nearer than its shortest range, or hidden behind
something nearer, is remembered and moved along by odometry.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray, Pose2
from revnm_client.messages import Scan

KEEP_NS = 2_000_000_000
_NEARBY_M = 4.0  # farther points matter to nobody here
_HIDDEN_M = 0.10  # behind the measured range by more than this is hidden


class ObstacleMemory:
    """Obstacle points, fixed in the odometry frame."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget everything."""
        self._points_m: FloatArray = np.empty((0, 2))
        self._stamps_ns: NDArray[np.int64] = np.empty(0, dtype=np.int64)

    def add(self, scan: Scan, odom_from_robot: Pose2) -> None:
        """Take in a scan.

        Args:
            scan: The newest.
            odom_from_robot: Pose of the robot at the scan's stamp.
        """
        old = odom_from_robot.inverse().apply(self._points_m)
        keep = hidden(old, scan) & (self._stamps_ns > scan.stamp_ns - KEEP_NS)
        new = scan.points_m()
        new = new[np.hypot(new[:, 0], new[:, 1]) < _NEARBY_M]
        self._points_m = np.concatenate([self._points_m[keep], odom_from_robot.apply(new)])
        stamps = np.full(len(new), scan.stamp_ns, dtype=np.int64)
        self._stamps_ns = np.concatenate([self._stamps_ns[keep], stamps])

    def points_m(self, odom_from_robot: Pose2) -> FloatArray:
        """Return the points (M, 2) in the frame of a robot that now stands there."""
        return odom_from_robot.inverse().apply(self._points_m)


def hidden(points_m: FloatArray, scan: Scan) -> NDArray[np.bool_]:
    """Tell which points (M, 2), robot frame at the scan, are nearby but cannot be seen by the scan.

    A beam without return that is not shorter than the shortest range sees everything along it; one that is
    shorter, or no number, sees nothing (drivers report masked beams as 0).
    """
    nearby = np.hypot(points_m[:, 0], points_m[:, 1]) < _NEARBY_M
    from_lidar = scan.robot_from_lidar.inverse().apply(points_m)
    distance = np.hypot(from_lidar[:, 0], from_lidar[:, 1])
    beam, inside = beams_at(from_lidar, scan)
    reach = np.where(scan.sees, scan.ranges_m, 0.0)
    reach = np.minimum(reach, np.minimum(np.roll(reach, 1), np.roll(reach, -1)))
    unseen = ~inside | (distance > reach[beam] + _HIDDEN_M) | (distance < scan.range_min_m)
    return np.asarray(unseen & nearby)


def beams_at(points_m: FloatArray, scan: Scan) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return the beam nearest to the direction of each point (M, 2), LiDAR's frame, and whether there is one.

    Where there is none, 0 stands for it.
    """
    bearing = np.arctan2(points_m[:, 1], points_m[:, 0])
    step = abs(scan.angle_increment_rad)
    turn = (bearing - scan.angle_min_rad) * math.copysign(1.0, scan.angle_increment_rad)
    beams = len(scan.ranges_m)
    beam = np.rint(np.mod(turn, math.tau) / step)  # too large for an integer where the step is tiny
    if abs(beams * step - math.tau) < 1.5 * step:
        beam %= beams
    inside = beam < beams
    return np.where(inside, beam, 0.0).astype(np.intp), inside
