"""Compiled loops over the cells of a map: distances to what stands there, and what is open to a search.

See :mod:`revnm_server.travel_cost` and :mod:`revnm_server.floor_search`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import float64, int32, int64
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_server.compiled import FLOATS, IMAGE, LINE, MASK, compiled, tuple_of
from revnm_server.observation import Image32

Squares = NDArray[np.int32]
BoolArray = NDArray[np.bool_]

_SQUARES = int32[:, ::1]
_CELL = tuple_of(int64, int64)


@compiled(_SQUARES, MASK, int64)
def squares(stands: BoolArray, reach: int) -> Squares:
    """Return the squared distance (Ny, Nx), in cells, to the nearest cell where something stands.

    Where that is farther than the reach it is reach² + 1. First the distances along columns, then, row by row, the
    least sum of their squares and of those along the row (Felzenszwalb and Huttenlocher, 2012, §3,
    doi:10.4086/toc.2012.v008a019; in plain loops, since the reach is short).
    """
    rows, columns = stands.shape
    beyond = int32(reach + 1)
    down = np.empty((rows, columns), dtype=np.int32)
    last = np.full(columns, beyond, dtype=np.int32)
    for row in range(rows):
        for column in range(columns):
            last[column] = int32(0) if stands[row, column] else min(last[column] + int32(1), beyond)
            down[row, column] = last[column]
    last[:] = beyond
    for row in range(rows - 1, -1, -1):
        for column in range(columns):
            last[column] = min(last[column] + int32(1), down[row, column])
            down[row, column] = last[column] * last[column]
    found = down.copy()
    for row in range(rows):
        near, source = found[row], down[row]
        for step in range(1, min(reach, columns - 1) + 1):
            more = int32(step * step)
            for column in range(columns - step):
                near[column] = min(near[column], source[column + step] + more)
            for column in range(columns - step):
                near[column + step] = min(near[column + step], source[column] + more)
        for column in range(columns):
            near[column] = min(near[column], int32(reach * reach + 1))
    return found


@compiled(None, IMAGE, IMAGE, LINE, IMAGE, int64)
def add_nearness(per_m: Image32, obstacle: Image32, cuts: NDArray[np.float32], prices: Image32, reach: int) -> None:
    """Make cells near to obstacles dearer, in place.

    Args:
        per_m: (Ny, Nx) cost of a metre.
        obstacle: (Ny, Nx) probability.
        cuts: (C,): at each, what is at least so likely counts as an obstacle.
        prices: (C, reach² + 2): what the nearest one then adds, by its squared distance in cells.
        reach: Cells, beyond which it adds nothing.
    """
    for cut in range(len(cuts)):
        stands = obstacle >= cuts[cut]
        if not stands.any():
            continue
        away, price = squares(stands, reach), prices[cut]
        for row in range(per_m.shape[0]):
            for column in range(per_m.shape[1]):
                per_m[row, column] += price[away[row, column]]


@compiled(float64, int64, int64, _CELL, _CELL)
def _between(row: int, column: int, start: tuple[int, int], entry: tuple[int, int]) -> float:
    """Return how far a cell is from two others together, in cells."""
    return math.sqrt((row - start[0]) ** 2 + (column - start[1]) ** 2) + math.sqrt(
        (row - entry[0]) ** 2 + (column - entry[1]) ** 2
    )


@compiled(tuple_of(FLOATS, int64, int64), IMAGE, MASK, _CELL, _CELL, float64, int64)
def open_window(
    per_m: Image32, closed: BoolArray, start: tuple[int, int], entry: tuple[int, int], likely: float, step: int
) -> tuple[FloatArray, int, int]:
    """Return the weights of the rows and columns that hold all open cells, and the first row and column of them.

    Open is what is not closed and on ways of a likely length, in an ellipse about both ends; the others weigh inf.

    Args:
        per_m: (Ny, Nx) weights.
        closed: (Ny, Nx).
        start: Cell (row, column), which is held, too.
        entry: The same.
        likely: Cells; may be inf.
        step: The window begins and ends at its multiples, as far as the cells go.
    """
    rows, columns = per_m.shape
    top, bottom = min(start[0], entry[0]), max(start[0], entry[0])
    left, right = min(start[1], entry[1]), max(start[1], entry[1])
    for row in range(rows):
        for column in range(columns):
            outside = column < left or column > right or row < top or row > bottom
            if outside and not closed[row, column] and _between(row, column, start, entry) <= likely:
                top, bottom = min(top, row), max(bottom, row)
                left, right = min(left, column), max(right, column)
    top, left = top // step * step, left // step * step
    bottom, right = min(rows, (bottom // step + 1) * step), min(columns, (right // step + 1) * step)
    weights = np.full((bottom - top, right - left), math.inf)
    for row in range(top, bottom):
        for column in range(left, right):
            if not closed[row, column] and _between(row, column, start, entry) <= likely:
                weights[row - top, column - left] = per_m[row, column]
    return weights, top, left
