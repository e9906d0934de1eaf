"""Where a world is occupied, as a grid seen from above, and how far away the nearest obstacle is.

Imports numpy and scipy only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from revnm_client.geometry import FloatArray
from revnm_sim.world import FLAT_M, Bounds, Primitive, Shape, World

_RIM_CELLS = 2


@dataclass(frozen=True, slots=True)
class OccupancyGrid:
    """Cells in rows along y and columns along x.

    Attributes:
        origin_m: (x, y) of the outer corner of cell (0, 0), world frame.
        resolution_m: Side of a cell.
        occupied: (Ny, Nx) bool; a cell that an obstacle touches anywhere is occupied.
        distance_m: (Ny, Nx) float64, from the cell's middle to that of the nearest occupied cell.
    """

    origin_m: tuple[float, float]
    resolution_m: float
    occupied: NDArray[np.bool_]
    distance_m: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        """Measure the distances, once."""
        distance = distance_transform_edt(~self.occupied, sampling=self.resolution_m)
        object.__setattr__(self, "distance_m", distance)

    def clearance_m(self, points_m: FloatArray) -> FloatArray:
        """Return the distance (...,) of points (..., 2) to the nearest obstacle, within half a cell; 0 outside."""
        cells = np.floor((points_m - np.array(self.origin_m)) / self.resolution_m).astype(np.int64)
        rows, columns = cells[..., 1], cells[..., 0]
        height, width = self.occupied.shape
        inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        found = self.distance_m[np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)]
        return np.where(inside, found, 0.0)


def occupancy(
    world: World, *, resolution_m: float = 0.05, z_min_m: float = FLAT_M, z_max_m: float = 0.40
) -> OccupancyGrid:
    """Rasterise what reaches into a range of heights; everything outside the world's bounds is occupied.

    Args:
        world: What to rasterise.
        resolution_m: Side of a cell.
        z_min_m: What ends below is driven over.
        z_max_m: What begins above is driven under.

    Returns:
        The grid over the bounds and a rim of two occupied cells around them.
    """
    bounds = world.bounds
    rim = _RIM_CELLS * resolution_m
    origin = (bounds.x_min_m - rim, bounds.y_min_m - rim)
    columns = int(np.ceil((bounds.x_max_m - bounds.x_min_m) / resolution_m - 1e-9)) + 2 * _RIM_CELLS
    rows = int(np.ceil((bounds.y_max_m - bounds.y_min_m) / resolution_m - 1e-9)) + 2 * _RIM_CELLS
    xs = np.asarray(origin[0] + (np.arange(columns) + 0.5) * resolution_m, dtype=np.float64)
    ys = np.asarray(origin[1] + (np.arange(rows) + 0.5) * resolution_m, dtype=np.float64)
    occupied = _outside(xs, ys, bounds)
    for primitive in world.primitives:
        if primitive.bottom_m < z_max_m and primitive.top_m > z_min_m:
            _mark(occupied, xs, ys, primitive, resolution_m)
    return OccupancyGrid(origin, resolution_m, occupied)


def _mark(
    occupied: NDArray[np.bool_], xs: FloatArray, ys: FloatArray, primitive: Primitive, resolution_m: float
) -> None:
    """Mark the cells, with their middles at ``xs`` (Nx,) and ``ys`` (Ny,), that a primitive's footprint touches."""
    half = np.array(primitive.size_m[:2]) / 2.0
    c, s = math.cos(primitive.yaw_rad), math.sin(primitive.yaw_rad)
    is_round = primitive.shape is Shape.CYLINDER
    reach = half if is_round else np.abs(np.array([[c, s], [s, c]])) @ half  # of the bounding rectangle
    dx, dy = xs - primitive.centre_m[0], ys - primitive.centre_m[1]
    window_x = np.flatnonzero(np.abs(dx) < reach[0] + resolution_m / 2.0)
    window_y = np.flatnonzero(np.abs(dy) < reach[1] + resolution_m / 2.0)
    if not (window_x.size and window_y.size):
        return
    dx, dy = dx[window_x][None, :], dy[window_y][:, None]
    if is_round:
        touched = _cells_on_disc(dx, dy, half[0], resolution_m)
    else:
        touched = _cells_on_box(dx, dy, half, np.array([c, s]), resolution_m)
    occupied[window_y[0] : window_y[-1] + 1, window_x[0] : window_x[-1] + 1] |= touched


def _outside(xs: FloatArray, ys: FloatArray, bounds: Bounds) -> NDArray[np.bool_]:
    """Return the cells (Ny, Nx) whose middle is outside the bounds."""
    in_x = (xs > bounds.x_min_m) & (xs < bounds.x_max_m)
    in_y = (ys > bounds.y_min_m) & (ys < bounds.y_max_m)
    return np.asarray(~(in_y[:, None] & in_x[None, :]))


def _cells_on_disc(dx: FloatArray, dy: FloatArray, radius_m: float, resolution_m: float) -> NDArray[np.bool_]:
    """Return which cells, by their middles relative to the disc's (1, X) and (Y, 1), touch the disc."""
    near_x = np.maximum(np.abs(dx) - resolution_m / 2.0, 0.0)
    near_y = np.maximum(np.abs(dy) - resolution_m / 2.0, 0.0)
    return np.asarray(near_x**2 + near_y**2 < radius_m**2)


def _cells_on_box(
    dx: FloatArray, dy: FloatArray, half_m: FloatArray, axis: FloatArray, resolution_m: float
) -> NDArray[np.bool_]:
    """Return which cells touch a yawed box; all of them touch its bounding rectangle.

    Separating axes of two rectangles: the grid's are taken by the window of :func:`_mark`, the box's remain.
    """
    c, s = axis
    reach = (abs(c) + abs(s)) * resolution_m / 2.0
    along = np.abs(c * dx + s * dy) < half_m[0] + reach
    across = np.abs(c * dy - s * dx) < half_m[1] + reach
    return np.asarray(along & across)
