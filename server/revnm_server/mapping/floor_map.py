"""Draw a lifted picture into a grid of the floor.

The grid lies in the camera's floor frame and covers what the camera usefully sees. Floor is looked up from every cell
and obstacles are thrown into the cells they stand in, so that far away neither leaves gaps between pixel rows: what
stands shows only its near side, and the floor behind it stays unseen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray, Pose2
from revnm_server.mapping.draw_kernels import Cells, Gaps, Picture, floor_evidence, obstacle_evidence, weighed
from revnm_server.mapping.floor_grid import FloorGrid
from revnm_server.mapping.floor_view import FloorView, grid_from_picture
from revnm_server.mapping.lift import FARTHEST_M, Lifted
from revnm_server.mapping.map_spread import SPREAD_SIGMAS, MapSpread
from revnm_server.mapping.node_grid import NODE_STEP
from revnm_server.observation import Image32
from revnm_server.stage_checks import check_shape

_BoolGrid = NDArray[np.bool_]

_PIECE = 0.7  # of a cell: points so close leave none out
_LEVEL_SLACK = 1.5  # of the rows' distance on a level surface
_SLANT = 4.0  # of the columns' distance on a surface across the view


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
        corner, per_m = self._middles[0, 0].astype(np.float32), np.float32(1.0 / self.spec.cell_m)
        self._cells = Cells(corner[0], corner[1], per_m, *self._shape)
        self._gaps = _gaps(view)
        self._spread = MapSpread(view, self._middles, self.spec.cell_m, self.spec.most_spread_m)
        self._near, self._far, self._in_view = self._looked_up()
        self._floor_cell = self._floor_cells()

    def draw(self, lifted: Lifted, age_s: NDArray[np.float32], bodies: tuple[Body, ...] = ()) -> FloorGrid:
        """Draw one picture.

        Args:
            lifted: The picture.
            age_s: (h, w), time since each pixel was truly seen.
            bodies: Robots whose places are known.

        Raises:
            ContractError: The picture or the times are not of the view's size.
        """
        check_shape("picture", lifted.kind, self._view.hw)
        check_shape("age", age_s, self._view.hw)
        spec = self.spec
        picture = Picture(lifted.kind, lifted.x_m, lifted.y_m, lifted.height_m, lifted.grade, age_s)
        floor, graded, floor_age = floor_evidence(picture, self._floor_cell, self._near, self._far, self._in_view)
        layers = obstacle_evidence(
            self._cells, picture, self._gaps, _PIECE * spec.cell_m, spec.obstacle_logit, spec.overhead_m
        )
        logit, age = weighed(floor, graded, floor_age, layers, spec.floor_logit, spec.overhead_logit, spec.most_logit)
        probability = _probability(logit)
        stands = np.where(logit > 0.0, probability, np.float32(0.0))
        spread = self._spread.spread(stands, lifted.line.nearness_sigma)
        grid = spec.unknown()
        grid.obstacle[self._part] = np.maximum(probability, spread)
        grid.floor[self._part] = floor
        grid.age_s[self._part] = age
        for body in bodies:
            take_out(grid, body)
        return grid

    def _floor_cells(self) -> NDArray[np.int64]:
        """Return the cell (h, w) of the floor at every pixel, as one number; what lies off them gets its own."""
        below = self._view.nearness > 1e-3
        depth = 1.0 / np.where(below, self._view.nearness, np.float32(1e-3))
        column = np.rint((depth * self._view.ray_x - self._cells.x_m) * self._cells.per_m).astype(np.int64)
        row = np.rint((depth * self._view.ray_y - self._cells.y_m) * self._cells.per_m).astype(np.int64)
        (rows, columns), off = self._shape, math.prod(self._shape)
        inside = below & (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        return np.asarray(np.where(inside, row * columns + column, off))

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


def _gaps(view: FloorView) -> Gaps:
    """Return how far neighbours on one surface are apart.

    Across the view, columns lie apart in proportion to z. On a level surface the place is proportional to z, and z to
    1 / nearness: one row changes it by Δnearness / nearness of itself.
    """
    ray = np.maximum(np.maximum(np.abs(view.ray_x), np.abs(view.ray_y)), np.float32(1e-3))
    across = np.float32(_SLANT * view.camera.size_px[0] / view.hw[1] / view.camera.focal_px)
    per_row = np.float32(np.abs(np.diff(view.nearness, axis=0)).max())
    return Gaps(ray, across, np.maximum(view.nearness, np.float32(1e-2)), np.float32(_LEVEL_SLACK) * per_row)


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


def _probability(logit: Image32) -> Image32:
    return np.asarray(np.float32(1.0) / (np.float32(1.0) + np.exp(-logit)))


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
