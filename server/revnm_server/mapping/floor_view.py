"""What a calibration says about every pixel of the depth network's grid: its ray, and how near the floor lies on it.

Computed once per calibration. Symbols: h, w of the disparity's grid, which is spread over the whole picture. Imports
numpy and OpenCV only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from revnm_client.geometry import FloatArray
from revnm_server.floor_camera import PARAMETERS, FloorCamera, on_plane, rotation
from revnm_server.mapping.node_grid import NodeGrid
from revnm_server.observation import Image32

_STEP = 1e-5  # of finite differences
_FARTHEST_M = 12.0  # floor that the fit of a disparity leans on


@dataclass(frozen=True, slots=True)
class FloorView:
    """A calibrated camera over a grid of pixels.

    Attributes:
        camera: The calibration.
        covariance: (5, 5) of :attr:`FloorCamera.vector`.
        ray_x: (h, w) float32, how far along x, floor frame, a pixel's ray goes per metre of depth along the view.
        ray_y: (h, w) float32, the same along y.
        nearness: (h, w) float32, 1/m: inverse of the depth at which the ray meets the floor; 0 at the horizon, negative
            above it. Linear in the pixel for a lens without distortion.
        nearness_sigma: (h, w) float32, 1/m: standard deviation of the nearness from the covariance, less what scale and
            shift of a disparity hide. Those hide errors of focal length, height and pitch, which bend nothing; roll and
            distortion remain.
    """

    camera: FloorCamera
    covariance: FloatArray
    ray_x: Image32
    ray_y: Image32
    nearness: Image32
    nearness_sigma: Image32

    @property
    def hw(self) -> tuple[int, int]:
        """Height and width of the grid."""
        return self.nearness.shape[0], self.nearness.shape[1]


def floor_view(camera: FloorCamera, hw: tuple[int, int], covariance: FloatArray | None = None) -> FloorView:
    """Prepare a view.

    Args:
        camera: The calibration.
        hw: Height and width of the disparity's grid.
        covariance: (5, 5) of the camera's vector; None: the calibration is exact.
    """
    spread = np.zeros((PARAMETERS, PARAMETERS)) if covariance is None else covariance
    pixels = grid_pixels(camera.size_px, hw)
    ray = _rays(camera.vector, camera.size_px, pixels)  # (h, w, 3)
    nearness = -ray[..., 2] / camera.height_m
    grid = NodeGrid(hw)
    sigma = grid.filled(_unabsorbed_sigma(camera, pixels[grid.nodes], nearness[grid.nodes], spread))
    single = [np.ascontiguousarray(each, dtype=np.float32) for each in (ray[..., 0], ray[..., 1], nearness, sigma)]
    return FloorView(camera, spread, *single)


def grid_pixels(size_px: tuple[int, int], hw: tuple[int, int]) -> FloatArray:
    """Return the picture's pixels (h, w, 2) in the middles of a grid's cells."""
    height, width = hw
    u = (np.arange(width) + 0.5) * size_px[0] / width - 0.5
    v = (np.arange(height) + 0.5) * size_px[1] / height - 0.5
    return np.stack(np.meshgrid(u, v), axis=-1)


def grid_from_picture(pixels: FloatArray, size_px: tuple[int, int], hw: tuple[int, int]) -> FloatArray:
    """Return where pixels (..., 2) of the picture lie in a grid, (..., 2) as (column, row), middles at integers."""
    return np.asarray((pixels + 0.5) * np.array(hw[::-1]) / np.array(size_px) - 0.5)


def place_jacobian(camera: FloorCamera, points_m: FloatArray) -> FloatArray:
    """Return how floor points (M, 2) that are seen at fixed pixels move with the camera's vector, (M, 2, 5), metres."""
    standing = np.concatenate([points_m, np.zeros((len(points_m), 1))], axis=1)
    pixels, _ = camera.project(standing)
    moves = []
    for step in _STEP * np.eye(PARAMETERS):
        ahead, _ = on_plane(camera.vector + step, camera.size_px, pixels)
        behind, _ = on_plane(camera.vector - step, camera.size_px, pixels)
        moves.append((ahead - behind) / (2.0 * _STEP))
    return np.stack(moves, axis=-1)


def root(covariance: FloatArray) -> FloatArray:
    """Return a matrix S (n, n) with S Sᵀ = covariance, which need not have full rank."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _rays(vector: FloatArray, size_px: tuple[int, int], pixels: FloatArray) -> FloatArray:
    """Return the rays (..., 3), floor frame, of length 1 along the view; nonsense outside the lens's model is cut."""
    middle = np.array([(size_px[0] - 1) / 2.0, (size_px[1] - 1) / 2.0])
    offset = (pixels - middle) / (0.5 * size_px[0])
    right, down = offset[..., 0], offset[..., 1]
    bend = 1.0 + vector[4] * (right * right + down * down)
    straight = 2.0 * np.exp(vector[0]) * np.maximum(bend, 0.05)
    local = np.stack([right / straight, down / straight, np.ones_like(straight)], axis=-1)
    return np.asarray(local @ rotation(vector).T)


def _unabsorbed_sigma(
    camera: FloorCamera, pixels: FloatArray, nearness: FloatArray, covariance: FloatArray
) -> FloatArray:
    floor = (nearness > 1.0 / _FARTHEST_M).ravel()
    if not covariance.any() or floor.sum() < PARAMETERS:
        return np.zeros_like(nearness)
    slopes = []
    for step in _STEP * np.eye(PARAMETERS):
        ends = [_rays(camera.vector + sign * step, camera.size_px, pixels)[..., 2] for sign in (1.0, -1.0)]
        heights = [np.exp(camera.vector[3] + sign * step[3]) for sign in (1.0, -1.0)]
        slopes.append(((ends[1] / heights[1] - ends[0] / heights[0]) / (2.0 * _STEP)).ravel())
    jacobian = np.stack(slopes, axis=1)  # (h·w, 5)
    basis = np.column_stack([nearness.ravel(), np.ones(nearness.size)])
    hidden, *_ = np.linalg.lstsq(basis[floor], jacobian[floor], rcond=None)
    left = (jacobian - basis @ hidden) @ root(covariance)
    return np.asarray(np.sqrt(np.square(left).sum(axis=1)).reshape(nearness.shape))
