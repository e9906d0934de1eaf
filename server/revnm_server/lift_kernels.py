"""Compiled loops over the pixels of a picture that is lifted, and over the guesses where its floor is.

Numbers are float32, as the pictures are.
"""

from __future__ import annotations

import numpy as np
from numba import boolean, float32, int64
from numpy.typing import NDArray

from revnm_server.compiled import IMAGE, LINE, MASK, compiled
from revnm_server.observation import Image32

_ON = np.float32(2.0)  # tolerances
_BELOW = np.float32(-2.5)  # what is so far below a line speaks against it
_EVEN = np.float32(0.25)  # of a step, by which it may differ from the next on a plane, by noise

BoolImage = NDArray[np.bool_]
Flat32 = NDArray[np.float32]


@compiled(int64[::1], IMAGE, LINE, LINE)
def votes(lines: Image32, nearness: Flat32, disparity: Flat32) -> NDArray[np.int64]:
    """Return how many pixels (M,) lie on lines (G, 2) of scale and shift, less those far below, (G,).

    The unit of the lines and of the disparity is the tolerance.
    """
    found = np.zeros(len(lines), dtype=np.int64)
    for g in range(len(lines)):
        scale, shift = lines[g, 0], lines[g, 1]
        count = 0
        for m in range(len(nearness)):
            rest = disparity[m] - scale * nearness[m] - shift
            count += int(abs(rest) < _ON) - int(rest < _BELOW)
        found[g] = count
    return found


@compiled(None, LINE, LINE, LINE, float32, boolean[::1])
def _steep(before: Flat32, middle: Flat32, after: Flat32, least: np.float32, found: NDArray[np.bool_]) -> None:
    """Note where the steps from one pixel to the next and on to the third are steep the same way, (N,)."""
    for k in range(len(middle)):
        to, on = middle[k] - before[k], after[k] - middle[k]
        found[k] = (min(abs(to), abs(on)) > least) & (to * on > np.float32(0.0))


@compiled(boolean, LINE, int64, int64, int64, int64)
def _bends(flat: Flat32, pixel: int, stride: int, place: int, count: int) -> bool:
    """Tell whether a row or column bends about a pixel, its ``place`` of ``count``.

    It does not in a run of three pixels to which, and on from which, the steps are nearly equal. Those at the ends, to
    which no step leads or from which none leads on, count among such.
    """
    run = 0
    for each in range(max(place - 2, 0), min(place + 3, count)):
        even = True
        if 1 <= each <= count - 2:
            middle = pixel + (each - place) * stride
            to, on = flat[middle] - flat[middle - stride], flat[middle + stride] - flat[middle]
            even = abs(on - to) < _EVEN * max(abs(on), abs(to))
        run = run + 1 if even else 0
        if run == 3:
            return False
    return True


@compiled(MASK, IMAGE, float32, float32)
def slopes(nearness: Image32, least_across: np.float32, least_down: np.float32) -> BoolImage:
    """Return the pixels (h, w) on the slope of a softened edge: they lie on neither of its surfaces.

    A slope goes on in one direction for two steps, which sharp edges and thin things do not, and changes from step to
    step, which planes do not that stretch along the view. Smaller steps than the least are none.
    """
    height, width = nearness.shape
    flat = nearness.ravel()
    across, down = np.zeros(width, dtype=np.bool_), np.zeros(width, dtype=np.bool_)
    found = np.zeros((height, width), dtype=np.bool_)
    for row in range(height):
        line = nearness[row]
        _steep(line[:-2], line[1:-1], line[2:], least_across, across[1:-1])
        if 1 <= row <= height - 2:
            _steep(nearness[row - 1], line, nearness[row + 1], least_down, down)
        else:
            down[:] = False
        for column in range(width):
            pixel = row * width + column
            if across[column]:
                found[row, column] = _bends(flat, pixel, 1, column, width)
            if down[column] and not found[row, column]:
                found[row, column] = _bends(flat, pixel, width, row, height)
    return found
