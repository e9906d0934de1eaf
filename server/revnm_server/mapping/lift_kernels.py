"""Compiled loops over the pixels of a picture that is lifted, and over the guesses where its floor is.

Numbers are float32, as the pictures are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import boolean, float32, int64, uint8
from numpy.typing import NDArray

from revnm_server.compiled import IMAGE, LINE, MASK, compiled, named_tuple_of, tuple_of
from revnm_server.observation import Image32

_ON = np.float32(2.0)  # tolerances
_BELOW = np.float32(-2.5)  # what is so far below a line speaks against it
_EVEN = np.float32(0.25)  # of a step, by which it may differ from the next on a plane, by noise

_UNDER = np.float32(-2.0)  # tolerances; what lies so far under the floor is none
_ONE, _ZERO = np.float32(1.0), np.float32(0.0)

FLOOR, OBSTACLE = 1, 2
"""Kinds of pixels, as of :class:`revnm_server.mapping.lift.Kind`."""

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


class Rays(NamedTuple):
    """What a calibration says about every pixel, each (h, w).

    Attributes:
        nearness: float32, of the floor, 1/m.
        floor_m: float32, depth of the floor along the view.
        tolerance_m: float32, what rises less over the floor is floor.
        below: bool, whether floor may be seen there.
        x: float32, how far along x a ray goes for each metre of depth along the view.
        y: float32, the same along y.
    """

    nearness: Image32
    floor_m: Image32
    tolerance_m: Image32
    below: BoolImage
    x: Image32
    y: Image32


_RAYS = named_tuple_of(Rays, IMAGE, IMAGE, IMAGE, MASK, IMAGE, IMAGE)
_PLACED = tuple_of(uint8[:, ::1], IMAGE, IMAGE, IMAGE, IMAGE)


@compiled(_PLACED, IMAGE, MASK, _RAYS, float32, float32, float32, float32)
def placed(
    nearness: Image32,
    usable: BoolImage,
    rays: Rays,
    camera_m: np.float32,
    farthest: np.float32,
    least: np.float32,
    most_tolerance_m: np.float32,
) -> tuple[NDArray[np.uint8], Image32, Image32, Image32, Image32]:
    """Return kind, places along x and y, height and grade, each (h, w): :class:`revnm_server.mapping.lift.Lifted`.

    Args:
        nearness: (h, w), of what is seen, 1/m.
        usable: (h, w), where that is so.
        rays: Of the pixels.
        camera_m: Height of the camera.
        farthest: Nearness beyond which nothing is said of what stands.
        least: Nearness that counts as none.
        most_tolerance_m: Where the tolerance is wider, what looks like floor is unknown.
    """
    kind = np.zeros(nearness.shape, dtype=np.uint8)
    x, y = np.empty_like(nearness), np.empty_like(nearness)
    height, grade = np.empty_like(nearness), np.empty_like(nearness)
    rows, columns = nearness.shape
    for row in range(rows):
        for column in range(columns):
            near, tolerance = nearness[row, column], rays.tolerance_m[row, column]
            depth = _ONE / max(near, least)
            above = camera_m * (_ONE - depth * rays.nearness[row, column])
            seen = usable[row, column]
            stands = seen and near > farthest and above > tolerance
            lies = seen and rays.below[row, column] and not stands
            lies = lies and tolerance < most_tolerance_m and above > _UNDER * tolerance
            depth = rays.floor_m[row, column] if lies else depth
            x[row, column], y[row, column] = depth * rays.x[row, column], depth * rays.y[row, column]
            height[row, column] = above
            sure = min(max(above / tolerance - _ONE, -_ONE), _ONE)
            grade[row, column] = sure if stands or lies else _ZERO
            kind[row, column] = OBSTACLE if stands else FLOOR if lies else 0
    return kind, x, y, height, grade
