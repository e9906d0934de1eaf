"""Draw a lifted picture into a grid of the floor.

The grid lies in the camera's floor frame and covers what the camera usefully sees. Floor is looked up from every cell
and obstacles are thrown into the cells they stand in, so that far away neither leaves gaps between pixel rows: what
stands shows only its near side, and the floor behind it stays unseen. Imports numpy only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray, Pose2
from revnm_server.floor_grid import FloorGrid
from revnm_server.floor_view import FloorView, grid_from_picture
from revnm_server.lift import FARTHEST_M, Kind, Lifted
from revnm_server.map_spread import SPREAD_SIGMAS, MapSpread
from revnm_server.node_grid import NODE_STEP
from revnm_server.obstacle_points import obstacle_points

_BoolGrid = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class MapSpec:
    """Size of the map and weight of its evidence.

    Attributes:
        cell_m: Side of a cell.
        ahead_m: The map covers x up to this: beyond, a picture's rows lie metres apart on the floor.
        behind_m: The map covers x from minus this: robots pass below the camera, too.
        width_m: The map covers y to half of this on both sides.
        floor_logit: Log-odds that a pixel of sure floor takes from its cell.
        obstacle_logit: Log-odds that a pixel of a sure obstacle adds to its cell.
        most_logit: Bound of a cell's log-odds, either way.
        overhead_m: What is higher over the floor counts only in cells in which no floor is seen: the robot passes
            below what hangs, and walls whose feet are hidden may still stand there.
        overhead_logit: Bound of the log-odds that all such pixels of a cell add: they do not show its floor, so scans
            that pass below say more.
        most_spread_m: Bound of the standard deviation over which an uncertain obstacle spreads.
    """

    cell_m: float = 0.1
    ahead_m: float = 30.0
    behind_m: float = 3.0
    width_m: float = 24.0
    floor_logit: float = 0.4
    obstacle_logit: float = 1.2
    most_logit: float = 4.0
    overhead_m: float = 0.5
    overhead_logit: float = 0.85
    most_spread_m: float = 0.3

    @property
    def shape(self) -> tuple[int, int]:
        """Rows along y and columns along x."""
        return round(self.width_m / self.cell_m), round((self.ahead_m + self.behind_m) / self.cell_m)

    @property
    def origin_m(self) -> tuple[float, float]:
        """(x, y) of the middle of cell (0, 0)."""
        return 0.5 * self.cell_m - self.behind_m, 0.5 * self.cell_m - 0.5 * self.width_m

    def middles_m(self) -> FloatArray:
        """Return the middles (Ny, Nx, 2) of the cells."""
        rows, columns = self.shape
        x = self.origin_m[0] + self.cell_m * np.arange(columns)
        y = self.origin_m[1] + self.cell_m * np.arange(rows)
        return np.stack(np.meshgrid(x, y), axis=-1)

    def unknown(self) -> FloorGrid:
        """Return a map on which nothing was seen."""
        half, never = np.full(self.shape, 0.5, dtype=np.float32), np.full(self.shape, np.inf, dtype=np.float32)
        return FloorGrid(self.origin_m, self.cell_m, half, np.zeros(self.shape, dtype=np.bool_), never)


@dataclass(frozen=True, slots=True)
class Body:
    """A robot that is taken out of the map.

    Attributes:
        floor_from_robot: Its pose in the camera's floor frame, the middle of its footprint.
        length_m: Along its heading.
        width_m: Across.
        height_m: Over the floor.
    """

    floor_from_robot: Pose2
    length_m: float
    width_m: float
    height_m: float


class FloorMapper:
    """Draws the pictures of one calibrated camera."""

    def __init__(self, view: FloorView, spec: MapSpec | None = None) -> None:
        self.spec = spec or MapSpec()
        self._view = view
        self._part = _within_reach(view, self.spec)  # all below is of these rows and columns alone
        self._middles = self.spec.middles_m()[self._part]
        self._shape = self._middles.shape[0], self._middles.shape[1]
        self._outside = self._shape[0] * self._shape[1]  # the cell of what lies off them
        self._spread = MapSpread(view, self._middles, self.spec.cell_m, self.spec.most_spread_m)
        self._near, self._far, self._in_view = self._looked_up()
        self._floor_cell = self._floor_cells()

    def draw(self, lifted: Lifted, age_s: NDArray[np.float32], bodies: tuple[Body, ...] = ()) -> FloorGrid:
        """Draw one picture.

        Args:
            lifted: The picture.
            age_s: (h, w), time since each pixel was truly seen.
            bodies: Robots whose places are known.
        """
        spec = self.spec
        floor, free, floor_age = self._floor(lifted, age_s)
        low, high, count, age_sum = self._obstacles(lifted, age_s)
        logit = free + low + np.where(floor, 0.0, np.minimum(high, spec.overhead_logit))
        probability = _probability(np.clip(logit, -spec.most_logit, spec.most_logit))
        stands = np.where(logit > 0.0, probability, np.float32(0.0))
        spread = self._spread.spread(stands, lifted.line.nearness_sigma)
        age = np.where(count > 0, age_sum / np.maximum(count, 1), floor_age).astype(np.float32)
        grid = spec.unknown()
        grid.obstacle[self._part] = np.maximum(probability, spread)
        grid.floor[self._part] = floor
        grid.age_s[self._part] = age
        for body in bodies:
            take_out(grid, body)
        return grid

    def _floor(self, lifted: Lifted, age_s: NDArray[np.float32]) -> tuple[_BoolGrid, FloatArray, FloatArray]:
        """Return where floor is seen, log-odds, and age, each (Ny, Nx)."""
        is_floor = (lifted.kind == Kind.FLOOR).ravel()
        pixels = np.flatnonzero(is_floor)
        cells = self._floor_cell[pixels]
        grade = lifted.grade.ravel()
        summed = np.bincount(cells, weights=grade[pixels], minlength=self._outside + 1)[:-1].reshape(self._shape)
        looked_up = self._in_view & is_floor[self._near] & is_floor[self._far]
        alone = np.where(looked_up, grade[self._near], np.float32(0.0))
        total = np.where(summed < 0.0, summed, alone)
        seen = looked_up | (summed < 0.0)
        age = np.where(seen, age_s.ravel()[self._near], np.inf)
        return seen, self.spec.floor_logit * total, age

    def _obstacles(
        self, lifted: Lifted, age_s: NDArray[np.float32]
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return log-odds of what is low and of what is high, pixels, and the sum of their ages, each (Ny, Nx)."""
        points = obstacle_points(lifted, self._view, self.spec.cell_m)
        cells = self._cells(points.x_m, points.y_m)
        weight = self.spec.obstacle_logit * points.grade
        overhead = points.height_m > self.spec.overhead_m
        layers = (weight * ~overhead, weight * overhead, None, age_s.ravel()[points.pixel])
        drawn = [np.bincount(cells, weights=each, minlength=self._outside + 1)[:-1] for each in layers]
        low, high, count, age_sum = (each.astype(np.float64).reshape(self._shape) for each in drawn)
        return low, high, count, age_sum

    def _cells(self, x_m: NDArray[np.floating], y_m: NDArray[np.floating]) -> NDArray[np.intp]:
        """Return the part's cells (M,) as one number each; what lies off it gets a number of its own."""
        (rows, columns), (x0, y0), per_m = self._shape, self._middles[0, 0], np.float32(1.0 / self.spec.cell_m)
        column = np.rint((x_m - np.float32(x0)) * per_m).astype(np.intp)
        row = np.rint((y_m - np.float32(y0)) * per_m).astype(np.intp)
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        return np.asarray(np.where(inside, row * columns + column, self._outside))

    def _floor_cells(self) -> NDArray[np.intp]:
        """Return the cell (h·w,) of the floor at every pixel."""
        below = self._view.nearness > 1e-3
        depth = 1.0 / np.where(below, self._view.nearness, np.float32(1e-3))
        cells = self._cells((depth * self._view.ray_x).ravel(), (depth * self._view.ray_y).ravel())
        return np.where(below.ravel(), cells, self._outside)

    def _looked_up(self) -> tuple[NDArray[np.intp], NDArray[np.intp], _BoolGrid]:
        """Return the pixels (Ny, Nx), as one number each, before and behind each cell, and which cells are in view."""
        height, width = self._view.hw
        standing = np.concatenate([self._middles, np.zeros((*self._shape, 1))], axis=-1)
        pixels, depth = self._view.camera.project(standing)
        place = grid_from_picture(pixels, self._view.camera.size_px, self._view.hw)
        column, row = np.rint(place[..., 0]), place[..., 1]
        inside = (depth > 0.0) & (column >= 0) & (column < width) & (row > -0.5) & (row < height - 0.5)
        column = np.where(inside, column, 0.0).astype(np.intp)
        row = np.clip(np.where(inside, row, 0.0), 0.0, height - 1.0)
        nearer, farther = np.ceil(row).astype(np.intp), np.floor(row).astype(np.intp)
        return nearer * width + column, farther * width + column, inside


def _within_reach(view: FloorView, spec: MapSpec) -> tuple[slice, slice]:
    """Return the map's rows and columns in which a camera may draw: beyond its farthest depth nothing is said.

    They begin and end at nodes of a :class:`NodeGrid` over the whole map, so that layers are the same on both.
    """
    margin_m = SPREAD_SIGMAS * spec.most_spread_m + spec.cell_m
    reach_m = 1.1 * FARTHEST_M  # rays are of the pixels' middles, and things are seen half a pixel beyond
    found = []
    for ray, start_m, size in zip((view.ray_y, view.ray_x), spec.origin_m[::-1], spec.shape, strict=True):
        first_m = min(0.0, reach_m * float(ray.min())) - margin_m
        last_m = max(0.0, reach_m * float(ray.max())) + margin_m
        first, last = ((value - start_m) / spec.cell_m / NODE_STEP for value in (first_m, last_m))
        found.append(slice(max(0, NODE_STEP * math.floor(first)), min(size, NODE_STEP * math.ceil(last) + 1)))
    return found[0], found[1]


def _probability(logit: FloatArray) -> NDArray[np.float32]:
    return np.asarray(1.0 / (1.0 + np.exp(-logit.astype(np.float32))), dtype=np.float32)


def take_out(grid: FloorGrid, body: Body) -> None:
    """Turn the floor under a robot into free floor, in place: it stands there."""
    half = 0.5 * np.array([body.length_m, body.width_m]) + 0.5 * grid.cell_m
    rows, columns = grid.obstacle.shape
    reach = float(np.hypot(*half)) / grid.cell_m
    row, column = grid.cells(np.array(body.floor_from_robot[:2]))
    window = (_around(row, reach, rows), _around(column, reach, columns))
    cells = np.moveaxis(np.mgrid[window], 0, -1)
    local = body.floor_from_robot.inverse().apply(grid.points_m(cells))
    under = (np.abs(local) < half).all(axis=-1)
    grid.obstacle[window][under] = 0.02
    grid.floor[window][under] = True
    grid.age_s[window][under] = 0.0


def _around(middle: float, reach: float, size: int) -> slice:
    """Return the indices of an axis that are within reach; empty beyond its ends."""
    first, last = (min(size, max(0, int(end))) for end in (middle - reach, middle + reach + 2.0))
    return slice(first, last)
