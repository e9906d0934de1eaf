"""Planning in the picture of the remote camera: where the floor is, a way over it, and the points of a way.

Pixels are (u, v) of the camera's picture, u right, v down, centres at integers; cells are (row, column) of a coarser
grid over it. The search is the expert's (:mod:`revnm_sim.expert.potential`): a front that spreads from the goal finds
the shortest way, as A* does, and is not bound to the grid's eight directions.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_sim.camera import Camera
from revnm_sim.expert.potential import along, descend, march
from revnm_sim.rays.raycast import FLOOR, cast_ids
from revnm_sim.world import FLAT_M, World, primitive_arrays

BoolArray = NDArray[np.bool_]

COLUMNS = 320  # of the grid: a plan of such a grid costs a few milliseconds
REPLAN_NS = 1_000_000_000  # the paper's IBVS plans every second
_SEED_CELLS = 1.5
_NEAR_CELLS = 2.5
_LONGEST = 10.0  # of a way, in widths plus heights of the grid


class ImageGrid:
    """The grid of a camera's picture, its cells square, 320 across."""

    def __init__(self, camera: Camera) -> None:
        """Lay the grid over the picture."""
        self.cell_px = camera.width_px / COLUMNS
        self.shape = (round(camera.height_px / self.cell_px), COLUMNS)

    def cells(self, pixels: FloatArray) -> FloatArray:
        """Return the cells (..., 2), middles at integers, of pixels (..., 2)."""
        return np.asarray(((pixels + 0.5) / self.cell_px - 0.5)[..., ::-1])

    def pixels(self, cells: FloatArray) -> FloatArray:
        """Return the pixels (..., 2) of cells (..., 2)."""
        return np.asarray((cells[..., ::-1] + 0.5) * self.cell_px - 0.5)

    def rows_px(self) -> FloatArray:
        """Return the picture's rows (h,), pixels, of the grid's rows."""
        return np.asarray((np.arange(self.shape[0]) + 0.5) * self.cell_px - 0.5)


def see_floor(world: World, camera: Camera, grid: ImageGrid) -> BoolArray:
    """Return where the camera sees the floor, or what lies flat on it, (h, w); no robot is in the picture."""
    _, ids, _ = cast_ids(primitive_arrays(world.primitives), camera, grid.shape)
    flat = np.array([primitive.top_m <= FLAT_M for primitive in world.primitives], dtype=bool)
    return np.asarray((ids == FLOOR) | ((ids >= 0) & np.append(flat, False)[np.maximum(ids, -1)]))


def find_path(
    free: BoolArray, grid: ImageGrid, start_px: FloatArray, goal_px: FloatArray, *, reach_px: float
) -> FloatArray | None:
    """Return the shortest way in the picture, pixels (N, 2), or None.

    Args:
        free: (h, w) where the way may lead.
        grid: Of the same picture.
        start_px: (2,) pixel to go from; where it is not free, the nearest free one.
        goal_px: (2,) pixel to reach; where it is not free, the way leads to the nearest free one and ends here.
        reach_px: How far away the nearest free pixel may be.
    """
    reach = reach_px / grid.cell_px
    start = _nearest(free, grid.cells(start_px), reach)
    goal = _nearest(free, grid.cells(goal_px), reach)
    if start is None or goal is None:
        return None
    cost = np.pad(np.where(free, 1.0, np.inf), 1, constant_values=np.inf)  # the front needs a rim
    start, goal = start + 1.0, goal + 1.0
    potential = march(cost, float(goal[0]), float(goal[1]), _SEED_CELLS)
    if not np.isfinite(potential[round(start[0]), round(start[1])]):
        return None
    longest = _LONGEST * sum(free.shape)
    path = np.empty((2 * int(longest) + 8, 2))
    count = descend(potential, start, goal, _NEAR_CELLS, longest, path)
    return np.concatenate([grid.pixels(path[:count] - 1.0), goal_px[None]])


def rest_of(path: FloatArray, point: FloatArray) -> FloatArray:
    """Return what is left (M, 2) of a path (N ≥ 2, 2), from its nearest point to ``point`` (2,) on."""
    begin, step = path[:-1], np.diff(path, axis=0)
    squares = np.maximum((step**2).sum(axis=1), 1e-12)
    fraction = np.clip(((point - begin) * step).sum(axis=1) / squares, 0.0, 1.0)
    feet = begin + fraction[:, None] * step
    nearest = int(np.argmin(((feet - point) ** 2).sum(axis=1)))
    return np.concatenate([feet[nearest : nearest + 1], path[nearest + 1 :]])


def look_ahead(path: FloatArray, point: FloatArray, *, spacing: float, count: int) -> FloatArray:
    """Return the points (H, 2) of pure pursuit: along the path from its nearest point, its end where it is short.

    Args:
        path: (N ≥ 2, 2), in pixels or metres.
        point: (2,) where the robot is.
        spacing: From one to the next, in the path's measure.
        count: H.
    """
    rest = np.ascontiguousarray(rest_of(path, point))
    points = np.empty((count, 2))
    along(rest, len(rest), spacing, points)
    return points


class ImageRoute:
    """The way in the picture, planned anew every second; the goal's direction while there is none."""

    def __init__(self, grid: ImageGrid, goal_px: FloatArray) -> None:
        """Begin without a way.

        Args:
            grid: Of the camera's picture.
            goal_px: (2,) pixel of the goal.
        """
        self._grid, self._goal_px = grid, goal_px
        self._path: FloatArray | None = None
        self._due_ns = -math.inf

    def path(self, now_ns: int, start_px: FloatArray, free: Callable[[], BoolArray], *, reach_px: float) -> FloatArray:
        """Return the way, pixels (N ≥ 2, 2).

        Args:
            now_ns: Time, nanoseconds.
            start_px: (2,) where the robot is.
            free: Gives the free mask (h, w); called when a plan is due.
            reach_px: How far away from start and goal the nearest free pixel may be.
        """
        if self._path is None or now_ns >= self._due_ns:
            self._due_ns = now_ns + REPLAN_NS
            found = find_path(free(), self._grid, start_px, self._goal_px, reach_px=reach_px)
            self._path = np.stack([start_px, self._goal_px]) if found is None else found
        return self._path


def _nearest(free: BoolArray, cell: FloatArray, reach: float) -> FloatArray | None:
    """Return the cell itself, clipped into the grid, if it is free, else the nearest free one within reach."""
    last = np.array(free.shape) - 1.0
    inside = np.clip(cell, 0.0, last)
    row, column = np.round(inside).astype(int)
    if free[row, column]:
        return np.asarray(inside)
    cells = np.argwhere(free)
    if not len(cells):
        return None
    distances = np.hypot(*(cells - inside).T)
    best = int(np.argmin(distances))
    return cells[best].astype(float) if distances[best] <= reach else None
