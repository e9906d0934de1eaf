"""Distance to the nearest obstacle on a small grid around the robot, truncated, exact between cell centres.

The transform is separable (Felzenszwalb and Huttenlocher, doi:10.4086/toc.2012.v008a019); because distances
are truncated to a few cells, a handful of shifted minima replaces the lower envelope, and numpy alone is fast
enough.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray

Array32 = NDArray[np.float32]


class DistanceField:
    """Looks distances up by the nearest cell; a position outside the grid takes the value at its border."""

    def __init__(self, distance_m: Array32, half_m: float, resolution_m: float) -> None:
        self._flat = np.ascontiguousarray(distance_m).ravel()
        self._side = distance_m.shape[0]
        self._half_m = np.float32(half_m)
        self._per_m = np.float32(1.0 / resolution_m)

    @classmethod
    def from_points(cls, points_m: FloatArray, *, half_m: float, resolution_m: float, reach_m: float) -> DistanceField:
        """Build the field of obstacle points.

        Args:
            points_m: (M, 2), the field's frame; those outside the grid are ignored.
            half_m: The grid spans [−half_m, half_m]², rounded up to whole cells.
            resolution_m: Side of a cell.
            reach_m: Distances are truncated to this.
        """
        side = int(np.ceil(2.0 * half_m / resolution_m))
        cells = np.floor((points_m + half_m) / resolution_m).astype(np.int64)
        cells = cells[((cells >= 0) & (cells < side)).all(axis=1)]
        occupied = np.zeros((side, side), dtype=bool)  # [y, x]
        occupied[cells[:, 1], cells[:, 0]] = True
        squared = squared_distance(occupied, int(np.ceil(reach_m / resolution_m)))
        distance = np.minimum(np.sqrt(squared) * np.float32(resolution_m), np.float32(reach_m))
        return cls(distance, half_m, resolution_m)

    def at(self, x_m: Array32, y_m: Array32) -> Array32:
        """Return the distance, metres, at positions of any one shape."""
        index = self._cell(y_m)
        index *= self._side
        index += self._cell(x_m)
        return np.take(self._flat, index)

    def _cell(self, coordinate_m: Array32) -> NDArray[np.int32]:
        cell = coordinate_m + self._half_m
        cell *= self._per_m
        np.maximum(cell, 0.0, out=cell)
        np.minimum(cell, np.float32(self._side - 1), out=cell)
        return cell.astype(np.int32)


def squared_distance(occupied: NDArray[np.bool_], reach: int) -> Array32:
    """Return the squared distance, in cells, to the nearest occupied cell.

    Args:
        occupied: (h, w).
        reach: Truncation, cells: exact up to this distance, (reach + 1)² or more where nothing is that near.
    """
    far = np.float32((reach + 1) ** 2)
    rows = np.where(occupied, np.float32(0.0), far)
    rows = _shifted_minimum(rows, reach)
    return _shifted_minimum(rows.T, reach).T


def _shifted_minimum(values: Array32, reach: int) -> Array32:
    """Return min over s of values[i + s, :] + s², |s| ≤ reach."""
    nearest = values.copy()
    moved = np.empty_like(nearest)
    for shift in range(1, min(reach, len(values) - 1) + 1):
        part = moved[shift:]
        np.add(values[:-shift], np.float32(shift * shift), out=part)
        np.minimum(nearest[shift:], part, out=nearest[shift:])
        np.add(values[shift:], np.float32(shift * shift), out=part)
        np.minimum(nearest[:-shift], part, out=nearest[:-shift])
    return nearest
