"""Compiled loops over the cells of a map that are open to a search; see :mod:`revnm_server.planning.floor_search`."""

from __future__ import annotations

import math

import numpy as np
from numba import float64, int64
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_server.compiled import FLOATS, IMAGE, MASK, compiled, tuple_of
from revnm_server.observation import Image32

BoolArray = NDArray[np.bool_]

_CELL = tuple_of(int64, int64)


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
