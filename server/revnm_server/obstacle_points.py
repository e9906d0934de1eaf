"""The obstacle pixels of a lifted picture as points close enough together for a grid. Imports numpy only."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from revnm_server.floor_view import FloorView
from revnm_server.lift import Kind, Lifted
from revnm_server.observation import Image32

_LEVEL_SLACK = 1.5  # of the rows' distance on a level surface
_SLANT = 4.0  # of the columns' distance on a surface across the view
_MOST_PIECES = 8

_Floats = NDArray[np.floating]


class ObstaclePoints(NamedTuple):
    """M points.

    Attributes:
        x_m: (M,), floor frame.
        y_m: (M,).
        height_m: (M,), over the floor.
        grade: (M,) in [0, 1], how surely each is an obstacle.
        pixel: (M,) the pixel it comes from, as one number.
    """

    x_m: _Floats
    y_m: _Floats
    height_m: _Floats
    grade: _Floats
    pixel: NDArray[np.intp]


def obstacle_points(lifted: Lifted, view: FloorView, cell_m: float) -> ObstaclePoints:
    """Return a point for every obstacle pixel, and points between neighbours on one surface farther than a cell apart.

    Neighbours are on one surface if they are no farther apart than rows are on a level one, and a few times as far
    as columns are on one across the view: what stands behind is not joined with what stands before.
    """
    obstacle = lifted.kind == Kind.OBSTACLE
    pixel = np.flatnonzero(obstacle)
    parts = [_at(lifted, pixel, pixel, 0.0)]
    stride = lifted.kind.shape[1]
    for step, gap_m in ((1, _column_gap_m(lifted, view)), (stride, _row_gap_m(lifted, view))):
        parts += _between(lifted, obstacle, step, gap_m, cell_m)
    return ObstaclePoints(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def _column_gap_m(lifted: Lifted, view: FloorView) -> Image32:
    """Return the most (h, w) that two neighbours in a row may be apart."""
    per_column = view.camera.size_px[0] / view.hw[1] / view.camera.focal_px
    return np.asarray(np.float32(_SLANT * per_column) * _depth_m(lifted, view))


def _row_gap_m(lifted: Lifted, view: FloorView) -> Image32:
    """Return the most (h, w) that two neighbours in a column may be apart.

    On a level surface the place is proportional to z, and z to 1 / nearness: one row changes it by Δnearness /
    nearness of itself.
    """
    per_row = np.float32(np.abs(np.diff(view.nearness, axis=0)).max())
    place = np.abs(lifted.x_m) + np.abs(lifted.y_m)
    return np.asarray(np.float32(_LEVEL_SLACK) * per_row * place / np.maximum(view.nearness, np.float32(1e-2)))


def _depth_m(lifted: Lifted, view: FloorView) -> Image32:
    ray = np.maximum(np.abs(view.ray_x), np.abs(view.ray_y))
    along = np.maximum(np.abs(lifted.x_m), np.abs(lifted.y_m))
    return np.asarray(along / np.maximum(ray, np.float32(1e-3)), dtype=np.float32)


def _between(
    lifted: Lifted, obstacle: NDArray[np.bool_], step: int, gap_m: Image32, cell_m: float
) -> list[ObstaclePoints]:
    """Return points between the pixels and their neighbours ``step`` numbers on."""
    flat = obstacle.ravel()
    pairs = flat[:-step] & flat[step:]
    if step == 1:
        pairs[obstacle.shape[1] - 1 :: obstacle.shape[1]] = False  # the end of a row and the start of the next
    x, y = lifted.x_m.ravel(), lifted.y_m.ravel()
    apart = np.maximum(np.abs(x[step:] - x[:-step]), np.abs(y[step:] - y[:-step]))
    chosen = np.flatnonzero(pairs & (apart > 0.7 * cell_m) & (apart < gap_m.ravel()[:-step]))
    if not len(chosen):
        return []
    pieces = np.clip(np.ceil(apart[chosen] / (0.7 * cell_m)), 2, _MOST_PIECES).astype(np.intp)
    first, of = np.repeat(chosen, pieces - 1), np.repeat(pieces, pieces - 1)
    piece = 1 + np.arange(len(first)) - np.repeat(np.cumsum(pieces - 1) - (pieces - 1), pieces - 1)
    return [_at(lifted, first, first + step, (piece / of).astype(np.float32))]


def _at(lifted: Lifted, first: NDArray[np.intp], second: NDArray[np.intp], share: float | _Floats) -> ObstaclePoints:
    """Return the points at a share of the way between pixels (M,)."""
    layers = (lifted.x_m, lifted.y_m, lifted.height_m, lifted.grade)
    if first is second:
        x, y, height, grade = (layer.ravel()[first] for layer in layers)
    else:
        ends = ((layer.ravel()[first], layer.ravel()[second]) for layer in layers)
        x, y, height, grade = (a + share * (b - a) for a, b in ends)
    return ObstaclePoints(x, y, height, grade, first)
