"""The pinhole camera of the simulator: no distortion, square pixels, principal point in the middle.

Optical frame: x right, y down, z along the view. Imports numpy only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from revnm_client.geometry import FloatArray


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole camera at a place.

    Attributes:
        width_px: Width of the picture.
        height_px: Height of the picture.
        hfov_rad: Horizontal field of view.
        position_m: (x, y, z) of the optical centre, world frame.
        yaw_rad: Direction of view in the plane, counter-clockwise from world x.
        pitch_rad: How far the view is bent down from the horizontal.
        roll_rad: Turn about the view, clockwise as seen in the picture's content.
    """

    width_px: int
    height_px: int
    hfov_rad: float
    position_m: tuple[float, float, float]
    yaw_rad: float
    pitch_rad: float
    roll_rad: float = 0.0

    @property
    def focal_px(self) -> float:
        """Focal length, pixels."""
        return self.width_px / (2.0 * math.tan(self.hfov_rad / 2.0))

    @property
    def centre_px(self) -> FloatArray:
        """Principal point (u, v); pixel centres lie at integers."""
        return np.array([(self.width_px - 1) / 2.0, (self.height_px - 1) / 2.0])

    def world_from_camera(self) -> FloatArray:
        """Return the rotation (3, 3) that takes the optical frame to the world frame."""
        cy, sy = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        cp, sp = math.cos(self.pitch_rad), math.sin(self.pitch_rad)
        cr, sr = math.cos(self.roll_rad), math.sin(self.roll_rad)
        forward = np.array([cy * cp, sy * cp, -sp])
        right = np.array([sy, -cy, 0.0])
        down = np.cross(forward, right)
        rolled_right = cr * right + sr * down
        rolled_down = cr * down - sr * right
        return np.stack([rolled_right, rolled_down, forward], axis=1)

    def project(self, points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Project world points (..., 3) to pixels (..., 2) and depths along the view (...,), metres.

        Pixels of points at or behind the optical centre are meaningless: check the depth.
        """
        local = (points_m - np.array(self.position_m)) @ self.world_from_camera()
        depth = local[..., 2]
        safe = np.where(np.abs(depth) < 1e-9, 1e-9, depth)
        pixels = self.centre_px + self.focal_px * local[..., :2] / safe[..., None]
        return pixels, depth

    def floor_point(self, pixel: FloatArray) -> FloatArray | None:
        """Return where the ray through a pixel (2,) meets the floor z = 0, (2,) metres, or None above it."""
        ray = self.world_from_camera() @ np.append((pixel - self.centre_px) / self.focal_px, 1.0)
        if ray[2] >= -1e-9:
            return None
        return np.asarray(np.array(self.position_m[:2]) - ray[:2] * (self.position_m[2] / ray[2]))

    def inside(self, pixels: FloatArray, depths_m: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """Return which of the projected points lie in the picture and in front of the camera."""
        limit = np.array([self.width_px, self.height_px]) - 0.5
        return np.asarray((depths_m > 1e-6) & ((pixels >= -0.5) & (pixels < limit)).all(axis=-1))
