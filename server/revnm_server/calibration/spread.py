"""From the covariance of a calibration to metres on the floor and pixels in the picture, by numeric derivatives.

Vectors are (8,): the camera's five parameters and a pose floor_from_robot (x, y, yaw). Imports numpy only.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from revnm_client.geometry import FloatArray, Pose2
from revnm_server.floor_camera import PARAMETERS, on_plane, project

_STEP = 1e-6
_DIRECTIONS = 12
_DRIFT = 0.02  # of a way driven, on top of what the covariance holds


def spread_m(vector: FloatArray, covariance: FloatArray, size_px: tuple[int, int], distance_m: float) -> float:
    """Return the standard deviation of places on the floor around a robot, in its frame, metres.

    Args:
        vector: (8,) camera and pose.
        covariance: (8, 8) of it.
        size_px: Of the picture.
        distance_m: How far the places are from the robot.

    Returns:
        The root mean square over the directions that the camera sees; inf if it sees none.
    """
    angles = np.linspace(0.0, math.tau, _DIRECTIONS, endpoint=False)
    pose = Pose2(*vector[PARAMETERS:])
    local = pose.apply(distance_m * np.stack([np.cos(angles), np.sin(angles)], axis=1))
    pixels, depth = project(vector[:PARAMETERS], size_px, np.column_stack([local, np.zeros(_DIRECTIONS)]))
    seen = (depth > 0.1) & ((pixels >= 0.0) & (pixels <= np.array(size_px) - 1.0)).all(axis=1)
    if not seen.any():
        return math.inf
    covariances = in_robot_covariances(vector, covariance, size_px, pixels[seen])
    return float(np.sqrt(np.trace(covariances, axis1=1, axis2=2).mean()))


def in_robot(vectors: FloatArray, size_px: tuple[int, int], pixels: FloatArray) -> FloatArray:
    """Return the places (..., M, 2) on the floor that pixels (M, 2) show, metres, in the robot's frame.

    Args:
        vectors: (..., 8) cameras and poses.
        size_px: Of the picture.
        pixels: (M, 2) of the picture.
    """
    points, _ = on_plane(vectors[..., None, :PARAMETERS], size_px, pixels)
    away = points - vectors[..., None, PARAMETERS : PARAMETERS + 2]
    yaw = vectors[..., PARAMETERS + 2, None]
    c, s, dx, dy = np.cos(yaw), np.sin(yaw), away[..., 0], away[..., 1]
    return np.stack([c * dx + s * dy, c * dy - s * dx], axis=-1)


def in_robot_covariances(
    vector: FloatArray, covariance: FloatArray, size_px: tuple[int, int], pixels: FloatArray
) -> FloatArray:
    """Return the covariances (M, 2, 2) of the places that :func:`in_robot` returns, square metres."""
    slopes = _slopes(lambda vectors: in_robot(vectors, size_px, pixels), vector)  # (M, 2, 8)
    return np.asarray(slopes @ covariance @ slopes.transpose(0, 2, 1))


def pixel_sigma_px(
    vector: FloatArray, covariance: FloatArray, size_px: tuple[int, int], height_m: float, *, driven_m: float
) -> float:
    """Return how uncertain the pixel of a robot's tag is after a way that only odometry has measured, pixels."""

    def pixel(vectors: FloatArray) -> FloatArray:
        heights = np.full((len(vectors), 1), height_m)
        places = np.concatenate([vectors[:, PARAMETERS : PARAMETERS + 2], heights], axis=1)
        return project(vectors[:, :PARAMETERS], size_px, places)[0]

    slopes = _slopes(pixel, vector)  # (2, 8)
    drift = _DRIFT * driven_m * float(np.linalg.norm(slopes[:, PARAMETERS : PARAMETERS + 2], ord=2))
    return float(np.sqrt(np.trace(slopes @ covariance @ slopes.T) + drift**2))


def _slopes(function: Callable[[FloatArray], FloatArray], vector: FloatArray) -> FloatArray:
    """Return the derivatives (..., 8) of a function from vectors (B, 8) to (B, ...) at a vector (8,)."""
    values = function(np.concatenate([vector[None], vector + _STEP * np.eye(len(vector))]))
    return np.moveaxis((values[1:] - values[0]) / _STEP, 0, -1)
