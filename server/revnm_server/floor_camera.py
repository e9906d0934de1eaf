"""A camera over a floor: how a calibrated picture and the floor belong together.

The floor frame lies under the camera: its origin on the floor below the optical centre, x along the direction of view,
y left, z up. Square pixels, principal point in the middle. Lens distortion is the division model with one coefficient
(A. Fitzgibbon, CVPR 2001, DOI 10.1109/CVPR.2001.990465), which has a closed form both ways. Imports numpy only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray

PARAMETERS = 5
"""Of :meth:`FloorCamera.vector`: log of the focal length, pitch, roll, log of the height, distortion."""

_LEAST_DEPTH_M = 1e-3
_MOST_CARRIED = 0.5  # of its distance, that a place may move between calibrations
_MISSED = 0.01  # of its distance, that a place's pixel may miss it by: not all lenses have one for it


@dataclass(frozen=True, slots=True)
class FloorCamera:
    """What a calibration knows of a camera.

    Attributes:
        size_px: Width and height of the picture.
        focal_px: Focal length.
        pitch_rad: How far the view is bent down from the horizontal.
        roll_rad: Turn about the view, clockwise as seen in the picture's content.
        height_m: Of the optical centre over the floor.
        distortion: Coefficient λ of the division model, in units of (half the picture's width)⁻²; negative for barrels.
    """

    size_px: tuple[int, int]
    focal_px: float
    pitch_rad: float
    roll_rad: float
    height_m: float
    distortion: float = 0.0

    @property
    def vector(self) -> FloatArray:
        """The parameters (5,): log of the focal length in picture widths, pitch, roll, log height, distortion."""
        focal = math.log(self.focal_px / self.size_px[0])
        return np.array([focal, self.pitch_rad, self.roll_rad, math.log(self.height_m), self.distortion])

    @classmethod
    def from_vector(cls, vector: FloatArray, size_px: tuple[int, int]) -> FloorCamera:
        """Return the camera with these parameters (5,); the inverse of :attr:`vector`."""
        focal, pitch, roll, height, distortion = (float(value) for value in vector)
        return cls(size_px, math.exp(focal) * size_px[0], pitch, roll, math.exp(height), distortion)

    def project(self, points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Project points (..., 3), floor frame, metres.

        Returns:
            Pixels (..., 2), pixel centres at integers, and depths (...,) along the view, metres; pixels of points at or
            behind the optical centre are meaningless.
        """
        return project(self.vector, self.size_px, points_m)

    def on_plane(self, pixels: FloatArray, height_m: float = 0.0) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return where the rays through pixels (..., 2) meet the level plane of a height over the floor.

        Returns:
            Points (..., 2), metres, floor frame, and which of them (...,) are valid: the others lie on or above the
            horizon, and their points are meaningless.
        """
        return on_plane(self.vector, self.size_px, pixels, height_m)

    def carry(self, points_m: FloatArray, onto: FloorCamera) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Find the places that another calibration of the same camera has for what is seen at points of the floor.

        Args:
            points_m: (..., 2) metres, floor frame.
            onto: The other calibration.

        Returns:
            Points (..., 2), metres, its floor frame, and which of them (...,) are valid: those before the camera both
            times, where its lens has pixels for them, and not elsewhere by more than half of their distance.
        """
        standing = np.concatenate([points_m, np.zeros((*points_m.shape[:-1], 1))], axis=-1)
        pixels, depths = self.project(standing)
        carried, valid = onto.on_plane(pixels)
        back, _ = self.on_plane(pixels)
        far, apart, missed = (np.linalg.norm(each, axis=-1) for each in (points_m, carried - points_m, back - points_m))
        return carried, valid & (depths > _LEAST_DEPTH_M) & (apart <= _MOST_CARRIED * far) & (missed <= _MISSED * far)


def rotation(vector: FloatArray) -> FloatArray:
    """Return the rotations (..., 3, 3) that take the optical frame (right, down, ahead) to the floor frame."""
    pitch, roll = vector[..., 1], vector[..., 2]
    cp, sp, cr, sr = np.cos(pitch), np.sin(pitch), np.cos(roll), np.sin(roll)
    zero = np.zeros_like(cp)
    # Columns: right (0, -1, 0) and down (-sin p, 0, -cos p), turned by the roll, and ahead (cos p, 0, -sin p).
    right = np.stack([-sr * sp, -cr, -sr * cp], axis=-1)
    down = np.stack([-cr * sp, sr, -cr * cp], axis=-1)
    return np.stack([right, down, np.stack([cp, zero, -sp], axis=-1)], axis=-1)


def project(vector: FloatArray, size_px: tuple[int, int], points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Project points with many cameras at once: :meth:`FloorCamera.project` for parameters (..., 5).

    The parameters' leading axes are broadcast against the points' (..., 3).
    """
    eye = np.zeros((*vector.shape[:-1], 3))
    eye[..., 2] = np.exp(vector[..., 3])
    local = _turned(points_m - eye, rotation(vector))
    depth = local[..., 2]
    ahead = np.maximum(depth, _LEAST_DEPTH_M)
    right, down = local[..., 0] / ahead, local[..., 1] / ahead
    focal = 2.0 * np.exp(vector[..., 0])  # half picture widths
    strength = vector[..., 4] * np.square(focal) * (right * right + down * down)
    bent = 2.0 / (1.0 + np.sqrt(np.maximum(1.0 - 4.0 * strength, 0.0)))
    scale = 0.5 * size_px[0] * focal * bent
    u, v = _middle(size_px)
    return np.stack([u + scale * right, v + scale * down], axis=-1), depth


def on_plane(
    vector: FloatArray, size_px: tuple[int, int], pixels: FloatArray, height_m: float = 0.0
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Lift pixels with many cameras at once: :meth:`FloorCamera.on_plane` for parameters (..., 5).

    The parameters' leading axes are broadcast against the pixels' (..., 2).
    """
    offset = (pixels - _middle(size_px)) / (0.5 * size_px[0])
    right, down = offset[..., 0], offset[..., 1]
    focal = 2.0 * np.exp(vector[..., 0])
    straight = focal * (1.0 + vector[..., 4] * (right * right + down * down))
    local = np.empty((*straight.shape, 3))
    local[..., 0], local[..., 1], local[..., 2] = right, down, straight
    ray = _turned(local, np.swapaxes(rotation(vector), -1, -2))
    length = np.sqrt(right * right + down * down + straight * straight)
    valid = (ray[..., 2] < -1e-6 * length) & (straight > 0.0)
    drop = np.where(valid, -ray[..., 2], 1.0)
    reach = (np.exp(vector[..., 3]) - height_m) / drop
    return ray[..., :2] * reach[..., None], valid


def _turned(rows: FloatArray, rotations: FloatArray) -> FloatArray:
    """Return rows (..., 3) times rotations (3, 3) or (..., 3, 3)."""
    if rotations.ndim == 2:
        return np.asarray(rows @ rotations)
    return np.asarray(sum(rows[..., j, None] * rotations[..., j, :] for j in range(3)))


def _middle(size_px: tuple[int, int]) -> FloatArray:
    return np.array([(size_px[0] - 1) / 2.0, (size_px[1] - 1) / 2.0])
