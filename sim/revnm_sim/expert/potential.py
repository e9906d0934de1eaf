"""Compiled loops of the expert: the potential by fast marching, and descents on it. Imports numpy and numba only.

All of it is float64: in float32 large costs stop the potential from growing, and the march never ends.
Indices run over cells (row along y, column along x); lengths in cells unless a name says metres.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray

_STEP = 0.5  # of a descent, in cells


@njit(cache=True, nogil=True)
def _push(keys: FloatArray, items: NDArray[np.int64], size: int, key: float, item: int) -> None:
    """Add an item to a binary heap of ``size`` entries."""
    i = size
    while i > 0:
        parent = (i - 1) >> 1
        if keys[parent] <= key:
            break
        keys[i], items[i] = keys[parent], items[parent]
        i = parent
    keys[i], items[i] = key, item


@njit(cache=True, nogil=True)
def _pop(keys: FloatArray, items: NDArray[np.int64], size: int) -> None:
    """Remove the least entry of a binary heap of ``size`` entries; the caller has read it."""
    last = size - 1
    key, item = keys[last], items[last]
    i = 0
    while True:
        child = 2 * i + 1
        if child >= last:
            break
        if child + 1 < last and keys[child + 1] < keys[child]:
            child += 1
        if keys[child] >= key:
            break
        keys[i], items[i] = keys[child], items[child]
        i = child
    keys[i], items[i] = key, item


@njit(cache=True, nogil=True)
def _planar_wave(a: float, b: float, cost: float) -> float:
    """Return the potential behind a wave front that has the values ``a`` and ``b`` beside the cell."""
    low, high = min(a, b), max(a, b)
    if high - low >= cost:
        return low + cost
    return 0.5 * (a + b + math.sqrt(2.0 * cost * cost - (a - b) ** 2))


@njit(cache=True, nogil=True)
def march(cost: FloatArray, goal_row: float, goal_column: float, seed_radius: float) -> FloatArray:
    """Return the least cost from every cell to a goal: the viscosity solution of |∇T| = cost.

    Args:
        cost: (Ny, Nx), of crossing a cell; inf where no one may be. The outermost cells must be inf.
        goal_row: Where the goal is, in cells, middles at integers.
        goal_column: Where the goal is.
        seed_radius: Cells so near to the goal get their exact distance times the mean of their and the goal's cost;
            nothing stands there.

    Returns:
        (Ny, Nx) potential; inf where the goal cannot be reached from.
    """
    height, width = cost.shape
    potential = np.full((height, width), np.inf)
    done = np.zeros((height, width), dtype=np.bool_)
    keys = np.empty(5 * height * width)
    items = np.empty(5 * height * width, dtype=np.int64)
    size = 0
    reach = math.ceil(seed_radius)
    goal_cost = cost[round(goal_row), round(goal_column)]
    for r in range(max(1, round(goal_row) - reach), min(height - 1, round(goal_row) + reach + 1)):
        for c in range(max(1, round(goal_column) - reach), min(width - 1, round(goal_column) + reach + 1)):
            distance = math.hypot(r - goal_row, c - goal_column)
            if distance <= seed_radius and cost[r, c] < np.inf:
                potential[r, c] = distance * 0.5 * (cost[r, c] + goal_cost)
                _push(keys, items, size, potential[r, c], r * width + c)
                size += 1
    while size > 0:
        item = items[0]
        _pop(keys, items, size)
        size -= 1
        row, column = item // width, item % width
        if done[row, column]:
            continue
        done[row, column] = True
        for k in range(4):
            r = row + (1 if k == 0 else -1 if k == 1 else 0)
            c = column + (1 if k == 2 else -1 if k == 3 else 0)
            if done[r, c] or not cost[r, c] < np.inf:
                continue
            value = _planar_wave(
                min(potential[r, c - 1], potential[r, c + 1]),
                min(potential[r - 1, c], potential[r + 1, c]),
                cost[r, c],
            )
            if value < potential[r, c]:
                potential[r, c] = value
                _push(keys, items, size, value, r * width + c)
                size += 1
    return potential


@njit(cache=True, nogil=True)
def _downhill(potential: FloatArray, row: int, column: int) -> tuple[float, float]:
    """Return the unit vector against the upwind gradient of a cell, (0, 0) where there is none."""
    here = potential[row, column]
    if not here < np.inf:
        return 0.0, 0.0
    below, above = potential[row - 1, column], potential[row + 1, column]
    left, right = potential[row, column - 1], potential[row, column + 1]
    dr = max(here - min(below, above), 0.0) * (1.0 if above < below else -1.0)
    dc = max(here - min(left, right), 0.0) * (1.0 if right < left else -1.0)
    norm = math.hypot(dr, dc)
    if norm == 0.0:
        return 0.0, 0.0
    return dr / norm, dc / norm


@njit(cache=True, nogil=True)
def _direction(potential: FloatArray, row: float, column: float) -> tuple[float, float]:
    """Return the unit direction of descent at a point: of the four cells around it, by their nearness."""
    r0, c0 = math.floor(row), math.floor(column)
    fr, fc = row - r0, column - c0
    dr = dc = 0.0
    for i in range(2):
        for j in range(2):
            weight = (fr if i else 1.0 - fr) * (fc if j else 1.0 - fc)
            cell_r, cell_c = _downhill(potential, r0 + i, c0 + j)
            dr += weight * cell_r
            dc += weight * cell_c
    norm = math.hypot(dr, dc)
    if norm < 0.1:  # the cells disagree: trust the nearest
        return _downhill(potential, round(row), round(column))
    return dr / norm, dc / norm


@njit(cache=True, nogil=True)
def descend(
    potential: FloatArray, start: FloatArray, goal: FloatArray, near: float, longest: float, out: FloatArray
) -> int:
    """Follow the potential down from a start.

    Args:
        potential: (Ny, Nx) of :func:`march`.
        start: (2,) (row, column), cells; its cell has a finite potential.
        goal: (2,) (row, column), cells.
        near: Nearer to the goal than so many cells, go straight.
        longest: Stop after so many cells of path.
        out: (P, 2) buffer for the path, the start first, half a cell between points.

    Returns:
        The number of points written; the last one is the goal, unless ``longest`` ended it. 0 if P was too short.
    """
    row, column = start
    out[0, 0], out[0, 1] = row, column
    count, length = 1, 0.0
    while count < len(out):
        to_goal = math.hypot(goal[0] - row, goal[1] - column)
        if to_goal < _STEP or length >= longest:
            if length < longest:
                out[count - 1, 0], out[count - 1, 1] = goal
            return count
        if to_goal < near:
            dr, dc = (goal[0] - row) / to_goal, (goal[1] - column) / to_goal
        else:
            dr, dc = _direction(potential, row, column)
            half_r, half_c = row + 0.5 * _STEP * dr, column + 0.5 * _STEP * dc
            if potential[round(half_r), round(half_c)] < np.inf:
                dr, dc = _direction(potential, half_r, half_c)
        if not potential[round(row + _STEP * dr), round(column + _STEP * dc)] < np.inf:
            dr, dc = _downhill(potential, round(row), round(column))
        row += _STEP * dr
        column += _STEP * dc
        out[count, 0], out[count, 1] = row, column
        count += 1
        length += _STEP
    return 0


@njit(cache=True, nogil=True)
def along(path: FloatArray, count: int, spacing: float, out: FloatArray) -> None:
    """Write the points (H, 2) at equal lengths of a path of ``count`` points, the path's end where it is short."""
    k, before, segment = 0, 0.0, 0.0
    for h in range(len(out)):
        wanted = (h + 1) * spacing
        while k < count - 1:
            segment = math.hypot(path[k + 1, 0] - path[k, 0], path[k + 1, 1] - path[k, 1])
            if before + segment >= wanted:
                break
            before += segment
            k += 1
        fraction = (wanted - before) / segment if k < count - 1 and segment > 0.0 else 0.0
        following = min(k + 1, count - 1)
        for axis in range(2):
            out[h, axis] = path[k, axis] + fraction * (path[following, axis] - path[k, axis])


@njit(cache=True, nogil=True)
def waypoints_of(
    potential: FloatArray,
    starts: FloatArray,
    goal: FloatArray,
    near: float,
    spacing: float,
    waypoints: FloatArray,
) -> None:
    """Write the waypoints (M, H, 2) of many starts (M, 2), all in cells; NaN where a start cannot reach the goal."""
    longest = spacing * waypoints.shape[1]
    path = np.empty((int(longest / _STEP) + 8, 2))
    height, width = potential.shape
    for m in range(len(starts)):
        row, column = round(starts[m, 0]), round(starts[m, 1])
        inside = 0 < row < height - 1 and 0 < column < width - 1
        if not inside or not potential[row, column] < np.inf:
            waypoints[m] = np.nan
            continue
        count = descend(potential, starts[m], goal, near, longest, path)
        along(path, count, spacing, waypoints[m])
