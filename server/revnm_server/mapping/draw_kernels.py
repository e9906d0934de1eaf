"""Compiled loops that draw a lifted picture into cells; see :mod:`revnm_server.mapping.floor_map`.

Arithmetic is float32, as the pictures are; sums are float64.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import boolean, float32, float64, int64, uint8
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_server.compiled import FLOATS, IMAGE, MASK, NUMBERS, compiled, named_tuple_of, tuple_of
from revnm_server.observation import Image32

FLOOR, OBSTACLE = 1, 2
"""Kinds of pixels, as of :class:`revnm_server.mapping.lift.Kind`."""

_MOST_PIECES = 8
_ZERO = np.float32(0.0)


class Picture(NamedTuple):
    """A lifted picture, each (h, w) as of :class:`revnm_server.mapping.lift.Lifted`.

    Attributes:
        kind: uint8.
        x_m: float32.
        y_m: float32.
        height_m: float32.
        grade: float32.
        age_s: float32, time since the pixel was truly seen.
    """

    kind: NDArray[np.uint8]
    x_m: Image32
    y_m: Image32
    height_m: Image32
    grade: Image32
    age_s: Image32


class Gaps(NamedTuple):
    """How far neighbouring pixels on one surface may be apart on the floor.

    Attributes:
        ray: (h, w) float32, metres along its larger axis for each metre of a pixel's depth along the view; not 0.
        across: Most distance of neighbours in a row, for each metre of depth.
        nearness: (h, w) float32, of the floor, 1/m; not 0.
        down: Most distance of neighbours in a column, for each metre of distance along both axes and each metre of the
            floor's depth.
    """

    ray: Image32
    across: np.float32
    nearness: Image32
    down: np.float32


class Cells(NamedTuple):
    """Where the cells are.

    Attributes:
        x_m: Middle of cell (0, 0).
        y_m: The same.
        per_m: Cells to a metre.
        rows: Along y.
        columns: Along x.
    """

    x_m: np.float32
    y_m: np.float32
    per_m: np.float32
    rows: int
    columns: int


_PICTURE = named_tuple_of(Picture, uint8[:, ::1], IMAGE, IMAGE, IMAGE, IMAGE, IMAGE)
_GAPS = named_tuple_of(Gaps, IMAGE, float32, IMAGE, float32)
_CELLS = named_tuple_of(Cells, float32, float32, float32, int64, int64)
_LAYERS = float64[:, :, ::1]


@compiled(tuple_of(MASK, FLOATS, IMAGE), _PICTURE, NUMBERS, NUMBERS, NUMBERS, MASK)
def floor_evidence(
    picture: Picture,
    cell: NDArray[np.int64],
    near: NDArray[np.int64],
    far: NDArray[np.int64],
    in_view: NDArray[np.bool_],
) -> tuple[NDArray[np.bool_], FloatArray, Image32]:
    """Return where floor is seen, the sum of its pixels' grades, and its age, each (Ny, Nx).

    Args:
        picture: What is seen.
        cell: (h, w) of each pixel's floor, as one number; Ny · Nx where it lies off the cells.
        near: (Ny, Nx) the pixel before each cell's middle, as one number.
        far: (Ny, Nx) the pixel behind it.
        in_view: (Ny, Nx), where there are such pixels.
    """
    kind, grade, age = picture.kind.ravel(), picture.grade.ravel(), picture.age_s.ravel()
    rows, columns = near.shape
    summed = np.zeros(rows * columns + 1)
    pixel_cell = cell.ravel()
    for pixel in range(len(kind)):
        if kind[pixel] == FLOOR:
            summed[pixel_cell[pixel]] += grade[pixel]
    seen = np.zeros((rows, columns), dtype=np.bool_)
    total = np.zeros((rows, columns))
    since = np.full((rows, columns), np.float32(math.inf), dtype=np.float32)
    for row in range(rows):
        for column in range(columns):
            before = near[row, column]
            looked_up = in_view[row, column] and kind[before] == FLOOR and kind[far[row, column]] == FLOOR
            drawn = summed[row * columns + column]
            if drawn < 0.0:
                total[row, column] = drawn
            elif looked_up:
                total[row, column] = grade[before]
            if drawn < 0.0 or looked_up:
                seen[row, column] = True
                since[row, column] = age[before]
    return seen, total, since


@compiled(None, FLOATS, _CELLS, float32, float32, boolean, float32, float32)
def _add(
    layers: FloatArray, cells: Cells, x_m: np.float32, y_m: np.float32, high: bool, weight: float, age_s: np.float32
) -> None:
    """Add a point to the layers (4, Ny · Nx), unless it lies off the cells."""
    column, row = int(np.rint((x_m - cells.x_m) * cells.per_m)), int(np.rint((y_m - cells.y_m) * cells.per_m))
    if 0 <= column < cells.columns and 0 <= row < cells.rows:
        cell = row * cells.columns + column
        layers[int(high), cell] += weight
        layers[2, cell] += 1.0
        layers[3, cell] += age_s


@compiled(None, FLOATS, _CELLS, _PICTURE, _GAPS, int64, float32, float32, float32)
def _join(
    layers: FloatArray,
    cells: Cells,
    picture: Picture,
    gaps: Gaps,
    step: int,
    piece_m: float,
    logit: float,
    overhead_m: float,
) -> None:
    """Add points between the obstacle pixels and those ``step`` numbers on that are on the same surface."""
    height, width = picture.kind.shape
    kind, x, y = picture.kind.ravel(), picture.x_m.ravel(), picture.y_m.ravel()
    above, grade, age = picture.height_m.ravel(), picture.grade.ravel(), picture.age_s.ravel()
    ray, nearness = gaps.ray.ravel(), gaps.nearness.ravel()
    for first in range(height * width - step):
        second = first + step
        if kind[first] != OBSTACLE or kind[second] != OBSTACLE or (step == 1 and second % width == 0):
            continue
        apart = max(abs(x[second] - x[first]), abs(y[second] - y[first]))
        if not apart > piece_m:
            continue
        if step == 1:
            gap = gaps.across * (max(abs(x[first]), abs(y[first])) / ray[first])
        else:
            gap = gaps.down * (abs(x[first]) + abs(y[first])) / nearness[first]
        if not apart < gap:
            continue
        pieces = min(max(int(np.ceil(apart / piece_m)), 2), _MOST_PIECES)
        for piece in range(1, pieces):
            share = np.float32(piece / pieces)
            at_x = x[first] + share * (x[second] - x[first])
            at_y = y[first] + share * (y[second] - y[first])
            high = above[first] + share * (above[second] - above[first]) > overhead_m
            sure = grade[first] + share * (grade[second] - grade[first])
            _add(layers, cells, at_x, at_y, high, logit * sure, age[first])


@compiled(_LAYERS, _CELLS, _PICTURE, _GAPS, float32, float32, float32)
def obstacle_evidence(
    cells: Cells, picture: Picture, gaps: Gaps, piece_m: float, logit: float, overhead_m: float
) -> FloatArray:
    """Return log-odds of what is low and of what is high, points, and the sum of their ages, (4, Ny, Nx).

    There is a point for every obstacle pixel, and points between neighbours on one surface that are far apart.
    Neighbours are on one surface if they are no farther apart than rows are on a level one, and a few times as far as
    columns are on one across the view: what stands behind is not joined with what stands before.

    Args:
        cells: Where the points go.
        picture: What is seen.
        gaps: How far neighbours on one surface are apart.
        piece_m: Neighbours farther apart are joined, by points no farther apart while they are not too many.
        logit: Log-odds of a sure obstacle.
        overhead_m: What is higher over the floor is high.
    """
    layers = np.zeros((4, cells.rows * cells.columns))
    kind, x, y = picture.kind.ravel(), picture.x_m.ravel(), picture.y_m.ravel()
    height, grade, age = picture.height_m.ravel(), picture.grade.ravel(), picture.age_s.ravel()
    for pixel in range(len(kind)):
        if kind[pixel] == OBSTACLE:
            high = height[pixel] > overhead_m
            _add(layers, cells, x[pixel], y[pixel], high, logit * grade[pixel], age[pixel])
    for step in (1, picture.kind.shape[1]):
        _join(layers, cells, picture, gaps, step, piece_m, logit, overhead_m)
    return layers.reshape((4, cells.rows, cells.columns))


@compiled(tuple_of(IMAGE, IMAGE), MASK, FLOATS, IMAGE, _LAYERS, float64, float64, float64)
def weighed(
    seen: NDArray[np.bool_],
    graded: FloatArray,
    floor_age_s: Image32,
    layers: FloatArray,
    floor_logit: float,
    most_overhead: float,
    most: float,
) -> tuple[Image32, Image32]:
    """Return log-odds that something stands in the cells, and their age, each (Ny, Nx).

    Args:
        seen: (Ny, Nx), where floor is seen.
        graded: (Ny, Nx) the sum of its pixels' grades.
        floor_age_s: (Ny, Nx) its age.
        layers: (4, Ny, Nx) of :func:`obstacle_evidence`; what is high counts only where no floor is seen.
        floor_logit: Log-odds of sure floor.
        most_overhead: Bound of what is high.
        most: Bound of all, either way.
    """
    logit, age = np.empty_like(floor_age_s), np.empty_like(floor_age_s)
    rows, columns = logit.shape
    for row in range(rows):
        for column in range(columns):
            high = 0.0 if seen[row, column] else min(layers[1, row, column], most_overhead)
            total = floor_logit * graded[row, column] + layers[0, row, column] + high
            logit[row, column] = min(max(total, -most), most)
            count = layers[2, row, column]
            age[row, column] = layers[3, row, column] / count if count > 0.0 else floor_age_s[row, column]
    return logit, age


@compiled(IMAGE, IMAGE, float32[:, :, ::1], boolean)
def spread_along(probability: Image32, weights: NDArray[np.float32], along_rows: bool) -> Image32:
    """Return the greatest (Ny, Nx) of each cell and of what its neighbours along an axis give.

    Args:
        probability: (Ny, Nx).
        weights: (D, Ny, Nx), what a cell gives of its probability to those at distances 1 … D; falling with it.
        along_rows: To the cells of other rows, else of other columns.
    """
    rows, columns = probability.shape
    result = probability.copy()
    down, across = int(along_rows), int(not along_rows)
    for row in range(rows):
        for column in range(columns):
            own = probability[row, column]
            if own == _ZERO:
                continue
            for index in range(weights.shape[0]):
                given = own * weights[index, row, column]
                if given == _ZERO:
                    break
                for distance in (index + 1, -index - 1):
                    to_row, to_column = row + distance * down, column + distance * across
                    if 0 <= to_row < rows and 0 <= to_column < columns:
                        result[to_row, to_column] = max(result[to_row, to_column], given)
    return result
