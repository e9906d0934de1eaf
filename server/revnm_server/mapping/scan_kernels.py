"""Compiled loops over the cells that scans tell of; see :mod:`revnm_server.mapping.scan_memory`.

Numbers are float32, as the map's are; times are float64.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import float32, float64, int64
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_server.compiled import FLOATS, IMAGE, LINE, MASK, compiled, named_tuple_of, tuple_of
from revnm_server.observation import Image32

BoolGrid = NDArray[np.bool_]
Flat32 = NDArray[np.float32]

_ONE, _HALF, _ZERO = np.float32(1.0), np.float32(0.5), np.float32(0.0)
_LEAST = np.float32(1e-3)  # of a probability


class Fan(NamedTuple):
    """The beams of one scan, and where it was taken.

    Attributes:
        x_m: Of the robot, frame of the map.
        y_m: The same.
        first_rad: Where the first beam points, in that frame.
        step_rad: From a beam to the next; not 0.
        free_m: (N,) float32, how far each beam clears the floor.
    """

    x_m: np.float32
    y_m: np.float32
    first_rad: np.float32
    step_rad: np.float32
    free_m: Flat32


class Middles(NamedTuple):
    """Where the cells' middles are.

    Attributes:
        x_m: (Nx,) float32.
        y_m: (Ny,) float32.
        cell_m: Side of a cell.
    """

    x_m: Flat32
    y_m: Flat32
    cell_m: np.float32


class Window(NamedTuple):
    """A part of the cells; the ends are beyond it."""

    top: int
    bottom: int
    left: int
    right: int


_FAN = named_tuple_of(Fan, float32, float32, float32, float32, LINE)
_MIDDLES = named_tuple_of(Middles, LINE, LINE, float32)
_WINDOW = named_tuple_of(Window, int64, int64, int64, int64)


@compiled(MASK, _FAN, _MIDDLES, _WINDOW)
def passed(fan: Fan, middles: Middles, window: Window) -> BoolGrid:
    """Return through which cells (bottom − top, right − left) of a window beams went, near their middles."""
    found = np.zeros((window.bottom - window.top, window.right - window.left), dtype=np.bool_)
    turn, side = np.float32(math.tau) / abs(fan.step_rad), _HALF * middles.cell_m
    count, farthest = len(fan.free_m), _ZERO
    for free_m in fan.free_m:
        farthest = max(farthest, free_m)
    for row in range(window.top, window.bottom):
        y = middles.y_m[row] - fan.y_m
        for column in range(window.left, window.right):
            x = middles.x_m[column] - fan.x_m
            distance = np.float32(math.sqrt(x * x + y * y))
            if distance >= farthest:
                continue
            beams = (np.float32(math.atan2(y, x)) - fan.first_rad) / fan.step_rad
            beams -= turn * np.float32(math.floor(beams / turn))  # in [0, turn], however the beams go round
            nearest = np.float32(np.rint(beams))
            beam = 0 if nearest > turn - _HALF else int(nearest)
            if beam < count and abs(beams - nearest) * abs(fan.step_rad) * distance <= side:
                found[row - window.top, column - window.left] = distance < fan.free_m[beam]
    return found


@compiled(tuple_of(IMAGE, MASK, IMAGE), IMAGE, MASK, IMAGE, IMAGE, FLOATS, float32, float64)
def fused(
    obstacle: Image32,
    floor: BoolGrid,
    age_s: Image32,
    logit: Image32,
    seen_s: FloatArray,
    sure_logit: float,
    stamp_s: float,
) -> tuple[Image32, BoolGrid, Image32]:
    """Return obstacle, floor and age, each (Ny, Nx), of a map with the scans in it.

    Args:
        obstacle: (Ny, Nx), of the camera's map.
        floor: (Ny, Nx), of it.
        age_s: (Ny, Nx), of it.
        logit: (Ny, Nx), what the scans tell.
        seen_s: (Ny, Nx), when they told it; −inf for never.
        sure_logit: From here on a hit overrules the camera, and a free cell is floor.
        stamp_s: Now.
    """
    stands, lies, age = np.empty_like(obstacle), floor.copy(), np.empty_like(age_s)
    rows, columns = obstacle.shape
    for row in range(rows):
        for column in range(columns):
            scans = logit[row, column]
            seen = min(max(obstacle[row, column], _LEAST), _ONE - _LEAST)
            if scans != _ZERO:
                total = np.float32(math.log(seen / (_ONE - seen))) + scans
                if scans >= sure_logit:
                    total = max(total, scans)
                seen = _ONE / (_ONE + np.float32(math.exp(-total)))
                lies[row, column] |= scans <= -sure_logit
            stands[row, column] = seen
            age[row, column] = min(age_s[row, column], np.float32(stamp_s - seen_s[row, column]))
    return stands, lies, age
