"""Distance to the nearest obstacle on a small grid around the robot, truncated, exact between cell centres.

The transform is separable (Felzenszwalb and Huttenlocher, doi:10.4086/toc.2012.v008a019); because distances
are truncated to a few cells, a handful of shifted minima replaces the lower envelope. In small integers the grid
fits the processor's nearest cache, and numpy alone is fast enough.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray

Array32 = NDArray[np.float32]
Cells = NDArray[np.unsignedinteger[Any]]


class DistanceField:
    """Looks distances up by the nearest cell; a position outside the grid takes the value at its border."""

    def __init__(self, distance_m: Array32, half_m: float, resolution_m: float) -> None:
        """Wrap distances (side, side), metres, indexed by the cell along x and the cell along y."""
        self._flat = distance_m.ravel()
        self._side = distance_m.shape[0]
        self._last = float(self._side - 1)
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
        x, y = (points_m.T + half_m) * (1.0 / resolution_m)
        inside = (np.minimum(x, y) >= 0.0) & (np.maximum(x, y) < side)
        x, y = x[inside].astype(np.intp), y[inside].astype(np.intp)
        occupied = np.zeros((side, side), dtype=bool)  # [y, x], so that distances lie in memory as [x, y]
        occupied[y, x] = True
        squared = squared_distance(occupied, int(np.ceil(reach_m / resolution_m)))
        distance = np.sqrt(squared, dtype=np.float32) * np.float32(resolution_m)
        distance.clip(0.0, reach_m, out=distance)
        return cls(distance.T, half_m, resolution_m)

    @property
    def distance_m(self) -> Array32:
        """The distances (side, side), metres, by the cell along x and the cell along y."""
        return self._flat.reshape(self._side, self._side)

    def at(self, x_m: Array32, y_m: Array32) -> Array32:
        """Return the distance, metres, at positions of any one shape."""
        index = self._cell(x_m)
        index *= self._side
        index += self._cell(y_m)
        return self._flat.take(index, mode="wrap")  # the quickest mode; no index is out of range

    def _cell(self, coordinate_m: Array32) -> NDArray[np.int32]:
        cell = coordinate_m + self._half_m
        cell *= self._per_m
        cell.clip(0.0, self._last, out=cell)
        return cell.astype(np.int32)


def squared_distance(occupied: NDArray[np.bool_], reach: int) -> Cells:
    """Return the squared distance, in cells, to the nearest occupied cell.

    Args:
        occupied: (h, w).
        reach: Truncation, cells: exact up to this distance, more than reach² where nothing is that near.

    Returns:
        (h, w), of the smallest unsigned type that holds 2 (reach + 1)².
    """
    far = reach + 1
    kind = np.min_scalar_type(2 * far**2)
    along = _along_columns(kind.type(far) * ~occupied, reach)
    squared = np.ascontiguousarray(along.T)
    squared *= squared
    nearest = squared.copy()
    for shift in range(1, far):
        _lower(nearest, squared + kind.type(shift * shift), shift)
    return nearest.T


def _along_columns(distance: Cells, reach: int) -> Cells:
    """Spread distances (h, w) of 0 or more than ``reach`` along the columns, in place.

    After the shifts 1, 2, 4 ... distances up to their sum are exact: far fewer than ``reach`` passes.
    """
    exact = 0
    while exact < reach:
        shift = min(exact + 1, reach - exact)
        _lower(distance, distance + distance.dtype.type(shift), shift)
        exact += shift
    return distance


def _lower(values: Cells, bound: Cells, shift: int) -> None:
    """Lower ``values`` to what ``bound`` holds ``shift`` rows above and below; whole rows lie in one piece."""
    np.minimum(values[shift:], bound[:-shift], out=values[shift:])
    np.minimum(values[:-shift], bound[shift:], out=values[:-shift])
