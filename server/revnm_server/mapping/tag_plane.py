"""The plane of a robot's tag: where places around the robot lie in the picture, without any calibration.

The tag's four corners, whose places on the robot are known, fix the homography from the robot's surroundings at the
tag's height to the picture. Exact corners give exact places; with corners a fraction of a pixel wrong the error grows
with the distance in tag sizes, so far places need a calibration. Imports numpy and OpenCV only.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_server.frame import RobotSighting

_SMALLEST_DEPTH = 0.05  # of the tag's own: what lies nearer to the horizon is not drawn
_FARTHEST_PX = 20_000.0
_LEAST_NEARNESS = 1e-6  # of the tag's own, which is 1: the horizon's is 0


class TagPlane:
    """The homography of one sighting."""

    def __init__(self, sighting: RobotSighting, *, tag_size_m: float) -> None:
        """Fix the plane.

        Args:
            sighting: Where the tag's corners are.
            tag_size_m: Side of the tag's black border.
        """
        half = 0.5 * tag_size_m
        corners_m = np.array([[half, half], [half, -half], [-half, -half], [-half, half]])
        self._picture_from_robot = cv2.getPerspectiveTransform(
            corners_m.astype(np.float32), sighting.corners.astype(np.float32)
        )

    def project(self, points_m: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Project points (M, 2), metres, in the robot's frame at the sighting.

        Returns:
            Pixels (M, 2), and which of them (M,) lie on the plane's visible side; the others are meaningless.
        """
        points = np.column_stack([points_m, np.ones(len(points_m))]) @ self._picture_from_robot.T  # (M, 3)
        visible = points[:, 2] / self._picture_from_robot[2, 2] > _SMALLEST_DEPTH
        depth = np.where(visible, points[:, 2], 1.0)
        return np.asarray(points[:, :2] / depth[:, None]), np.asarray(visible)

    def locate(self, pixels: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return where on the plane pixels (M, 2) lie: the inverse of :meth:`project`.

        Returns:
            Points (M, 2), metres, in the robot's frame at the sighting, and which of them (M,) are valid; the pixels
            of the others lie on or above the horizon, or too near to the camera, and their points are meaningless.
        """
        points = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(self._picture_from_robot).T
        nearness = points[:, 2] * self._picture_from_robot[2, 2]  # 1 at the tag, 0 at the horizon
        valid = (nearness > _LEAST_NEARNESS) & (nearness < 1.0 / _SMALLEST_DEPTH)
        scale = np.where(valid, points[:, 2], 1.0)
        return np.asarray(points[:, :2] / scale[:, None]), np.asarray(valid)


def path_in_picture(waypoints_m: FloatArray, sighting: RobotSighting, *, tag_size_m: float) -> FloatArray:
    """Draw waypoints in the picture by the homography of the robot's tag: no calibration is needed.

    Args:
        waypoints_m: (H, 2), metres, in the robot's frame at the sighting.
        sighting: Where the tag's corners are.
        tag_size_m: Side of the tag's black border.

    Returns:
        (K, 2) pixels, K <= H: the path ends where it would leave the plane's visible side.
    """
    pixels, visible = TagPlane(sighting, tag_size_m=tag_size_m).project(waypoints_m)
    near = visible & np.all(np.abs(pixels) < _FARTHEST_PX, axis=1)
    return np.asarray(pixels[np.logical_and.accumulate(near)], dtype=np.float64)
