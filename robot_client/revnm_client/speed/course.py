"""The cluttered room in which the client is measured: a round course between pillars, seen by a LiDAR of 720 beams.

Frame: the room's, in its middle; the robot drives counter-clockwise.
"""

from __future__ import annotations

import math

import numpy as np

from revnm_client.geometry import FloatArray, Pose2
from revnm_client.messages import Scan, Velocity
from revnm_client.mppi import MppiInput

BEAMS = 720
SPEED_MPS = 0.4
_RADIUS_M = 1.5
_HALF_M = 2.6
_RANGE_M = 12.0
_WAYPOINTS_M = 0.4 * np.arange(1, 6)
_ANGLES_RAD = -math.pi + math.tau / BEAMS * np.arange(BEAMS)
_PILLARS_M = np.array(  # (C, 3): x, y, radius
    [
        [0.0, 0.0, 0.45], [0.8, 0.1, 0.12], [-0.5, 0.7, 0.15], [-0.3, -0.8, 0.2], [2.2, 0.4, 0.15], [1.6, 1.6, 0.2],
        [0.1, 2.15, 0.1], [-1.5, 1.7, 0.25], [-2.2, 0.0, 0.12], [-1.7, -1.5, 0.2], [0.2, -2.2, 0.15], [1.6, -1.6, 0.1],
    ]
)  # fmt: skip


def start() -> Pose2:
    """Return the robot's first pose, on the course."""
    return Pose2(_RADIUS_M, 0.0, math.pi / 2.0)


def scan(world_from_robot: Pose2, stamp_ns: int) -> Scan:
    """Return what the LiDAR sees from there: pillars and walls, without noise."""
    dx, dy = np.cos(_ANGLES_RAD + world_from_robot.yaw_rad), np.sin(_ANGLES_RAD + world_from_robot.yaw_rad)
    origin = np.array([world_from_robot.x_m, world_from_robot.y_m])
    with np.errstate(divide="ignore"):  # a beam along a wall never meets it
        to_wall = np.minimum(
            (_HALF_M - np.sign(dx) * origin[0]) / abs(dx), (_HALF_M - np.sign(dy) * origin[1]) / abs(dy)
        )
    cx, cy = (_PILLARS_M[:, :2] - origin).T
    along = np.outer(dx, cx) + np.outer(dy, cy)  # (N, C)
    half_chord = _PILLARS_M[:, 2] ** 2 - (cx**2 + cy**2 - along**2)
    to_pillar = np.where((half_chord > 0.0) & (along > 0.0), along - np.sqrt(np.maximum(half_chord, 0.0)), np.inf)
    ranges = np.minimum(to_wall, to_pillar.min(axis=1)).astype(np.float32)
    return Scan(stamp_ns, -math.pi, math.tau / BEAMS, 0.05, _RANGE_M, ranges)


def waypoints(world_from_robot: Pose2) -> FloatArray:
    """Return the next 2 m of the course, (5, 2), in the robot's frame."""
    angles = math.atan2(world_from_robot.y_m, world_from_robot.x_m) + _WAYPOINTS_M / _RADIUS_M
    points = _RADIUS_M * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return world_from_robot.inverse().apply(points)


def inputs(count: int, period_s: float) -> list[MppiInput]:
    """Return what a controller sees in each tick of a drive along the course, whatever it would do itself."""
    turned = SPEED_MPS / _RADIUS_M
    found = []
    for angle in turned * period_s * np.arange(count):
        pose = Pose2(_RADIUS_M * math.cos(angle), _RADIUS_M * math.sin(angle), angle + math.pi / 2.0)
        path = np.concatenate([np.zeros((1, 2)), waypoints(pose)])
        found.append(MppiInput(path, scan(pose, 0).points_m(), Velocity(SPEED_MPS, turned)))
    return found
