"""Where robots' tags are in the picture, by where the robots are on the floor. Imports numpy only."""

from __future__ import annotations

import numpy as np

from revnm_client.geometry import FloatArray, Pose2
from revnm_server.calibration.keyframes import TagMount
from revnm_server.floor_camera import FloorCamera

_LEAST_DEPTH_M = 0.1


def tag_corners(camera: FloorCamera, floor_from_robot: Pose2, mount: TagMount) -> FloatArray | None:
    """Return the pixels (4, 2) of the corners of a robot's tag: front left, front right, rear right, rear left.

    They may lie outside of the picture; None for what is not before the camera.
    """
    half = 0.5 * mount.size_m
    corners_m = floor_from_robot.apply(half * np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]]))
    pixels, depths = camera.project(np.column_stack([corners_m, np.full(4, mount.height_m)]))
    return np.asarray(pixels, dtype=np.float64) if (depths > _LEAST_DEPTH_M).all() else None
