"""The scale of the floor by the row of the picture, learnt from the robot's tag as it goes; no calibration.

For a pinhole without roll over a plane the scale across the view, pixels per metre, is linear in the row, and the scale
along the view grows with its square. So few sightings of a tag of known size tell both for every row of the floor.
"""

from __future__ import annotations

import math

import numpy as np

from revnm_client.geometry import FloatArray
from revnm_server.mapping.tag_plane import TagPlane
from revnm_sim.bench.image_plan import BoolArray, ImageGrid

_STEP_M = 0.01
_ROWS_APART = 8.0  # two rows of a tag, pixels: the line through nearer ones would be a guess
_LEAST_SHARE = 0.1  # of the last tag's scale: near the horizon the line goes to zero and below


class RowScale:
    """The line of scale over row, regressed on all sightings so far; one scale everywhere until rows differ."""

    def __init__(self, *, tag_height_m: float) -> None:
        """Begin without a sighting.

        Args:
            tag_height_m: Height of the tag over the floor.
        """
        self._height_m = tag_height_m
        self._seen: list[tuple[float, float]] = []  # row of the robot's foot, scale across
        self._line = (0.0, 0.0)
        self._foreshortening: list[float] = []

    def add(self, plane: TagPlane) -> None:
        """Learn from one sighting; a repeated one adds nothing."""
        pixels, _ = plane.project(_STEP_M * np.array([[0.0, 0.0], [1, 0], [-1, 0], [0, 1], [0, -1]]))
        change = np.stack([pixels[1] - pixels[2], pixels[3] - pixels[4]], axis=1) / (2.0 * _STEP_M)  # per metre
        away = max(float(np.hypot(*change[1])), 1e-9)  # rows per metre along the view
        across = abs(float(np.linalg.det(change))) / away
        sample = (float(pixels[0, 1]) + self._height_m * across, across)
        if self._seen and sample == self._seen[-1]:
            return
        self._seen.append(sample)
        self._foreshortening.append(away / across**2)
        rows, scales = np.array(self._seen).T
        if np.ptp(rows) < _ROWS_APART:
            self._line = (0.0, across)
        else:
            slope, offset = np.polyfit(rows, scales, 1)
            self._line = (float(slope), float(offset))

    def across(self, rows_px: FloatArray) -> FloatArray:
        """Return the scale (...,) across the view at rows (...,) of the floor, pixels per metre."""
        slope, offset = self._line
        return np.asarray(np.maximum(slope * rows_px + offset, _LEAST_SHARE * self._seen[-1][1]))

    def away(self, rows_px: FloatArray) -> FloatArray:
        """Return the scale (...,) along the view at rows (...,) of the floor, pixels per metre."""
        return np.asarray(np.mean(self._foreshortening) * self.across(rows_px) ** 2)

    def foot(self, tag_px: FloatArray) -> FloatArray:
        """Return the pixel (2,) of the floor under the tag last added: as many pixels lower as its height is wide."""
        return np.asarray(tag_px + np.array([0.0, self._height_m * self._seen[-1][1]]))

    def lift(self, pixels: FloatArray) -> FloatArray:
        """Return the pixels (M, 2) at the tag's height over pixels (M, 2) of the floor; the inverse of :meth:`foot`."""
        return np.asarray(
            pixels - np.stack([np.zeros(len(pixels)), self._height_m * self.across(pixels[:, 1])], axis=1)
        )


def free_by_metres(floor: BoolArray, grid: ImageGrid, scale: RowScale, *, radius_m: float) -> BoolArray:
    """Return on which cells (h, w) of the floor a disc of a radius, seen in perspective, holds nothing but floor.

    What lies beyond the picture's edge is taken for floor.
    """
    rows_px = grid.rows_px()
    half_width = radius_m * scale.across(rows_px) / grid.cell_px  # (h,) cells
    half_height = radius_m * scale.away(rows_px) / grid.cell_px
    beside = _columns_to_obstacle(floor)
    free = np.ones_like(floor)
    height = len(floor)
    highest = min(math.floor(half_height.max()), height - 1)
    for k in range(-highest, highest + 1):
        other = np.arange(height) + k
        rows = np.flatnonzero((half_height >= abs(k)) & (other >= 0) & (other < height))
        chord = half_width[rows] * np.sqrt(1.0 - (k / half_height[rows]) ** 2)
        free[rows] &= beside[rows + k] > chord[:, None]
    return np.asarray(free)


def _columns_to_obstacle(floor: BoolArray) -> FloatArray:
    """Return how many columns away (h, w) the nearest cell of the same row is that is not floor."""
    columns = np.arange(floor.shape[1], dtype=float)
    left = np.maximum.accumulate(np.where(floor, -np.inf, columns), axis=1)
    right = np.minimum.accumulate(np.where(floor, np.inf, columns)[:, ::-1], axis=1)[:, ::-1]
    return np.asarray(np.minimum(columns - left, right - columns))
