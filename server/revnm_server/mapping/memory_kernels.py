"""Compiled loop over the pixels that a static camera remembers; see :mod:`revnm_server.mapping.disparity_memory`.

Numbers are float32, as the pictures are; times are float64.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import float32, float64
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_server.compiled import FLOATS, IMAGE, MASK, compiled, named_tuple_of, tuple_of
from revnm_server.observation import Image32

_BoolImage = NDArray[np.bool_]
_FOLLOW = np.float32(0.3)  # share by which what may become background follows what is seen
_ONE, _ZERO = np.float32(1.0), np.float32(0.0)


class Background(NamedTuple):
    """What is remembered of each pixel, each (h, w).

    Attributes:
        disparity: float32, the background.
        pictures: float32, those that agreed with it; 0 where there is none.
        candidate: float32, what was seen instead, and may become it.
        since_s: float64, since when that has been seen; inf where it is not.
        seen_s: float64, when the pixel was last seen, on a robot not.
        clipped: bool, whether it was clipped then.
    """

    disparity: Image32
    pictures: Image32
    candidate: Image32
    since_s: FloatArray
    seen_s: FloatArray
    clipped: _BoolImage


_BACKGROUND = named_tuple_of(Background, IMAGE, IMAGE, IMAGE, FLOATS, FLOATS, MASK)
_SHOWN = tuple_of(IMAGE, MASK, IMAGE, MASK)


@compiled(_SHOWN, _BACKGROUND, IMAGE, MASK, MASK, float32, float32, float64, float64)
def learnt(
    memory: Background,
    picture: Image32,
    seen: _BoolImage,
    cut: _BoolImage,
    tolerance: float,
    least_gain: float,
    settle_s: float,
    stamp_s: float,
) -> tuple[Image32, _BoolImage, Image32, _BoolImage]:
    """Learn a picture, in place; return disparity, usable, age and moving, each (h, w), as remembered now.

    Args:
        memory: What is remembered.
        picture: (h, w) disparity in its units.
        seen: (h, w), where no robot is.
        cut: (h, w), where the disparity is clipped.
        tolerance: Difference from the background that is noise.
        least_gain: Share of a picture in the average, however many there were.
        settle_s: What stays so long becomes background.
        stamp_s: Capture time.
    """
    height, width = picture.shape
    shown, age = np.empty_like(picture), np.empty_like(picture)
    usable, moving = np.empty_like(seen), np.zeros_like(seen)
    for row in range(height):
        disparity, count, candidate = memory.disparity[row], memory.pictures[row], memory.candidate[row]
        since_s, seen_s, clipped = memory.since_s[row], memory.seen_s[row], memory.clipped[row]
        for k in range(width):
            now = picture[row, k]
            difference = now - disparity[k]
            if seen[row, k]:
                seen_s[k], clipped[k] = stamp_s, cut[row, k]
                if count[k] > _ZERO and abs(difference) < tolerance:
                    disparity[k] += max(_ONE / (count[k] + _ONE), least_gain) * difference
                    count[k] += _ONE
                    since_s[k] = math.inf
                else:
                    if count[k] > _ZERO:
                        change = now - candidate[k]
                        if since_s[k] < math.inf and abs(change) < tolerance:
                            candidate[k] += _FOLLOW * change
                        else:
                            candidate[k], since_s[k] = now, stamp_s
                        moving[row, k] = stamp_s - since_s[k] < settle_s
                    if not moving[row, k]:
                        disparity[k], count[k], since_s[k] = now, _ONE, math.inf
            shown[row, k] = now if moving[row, k] else disparity[k]
            usable[row, k] = count[k] > _ZERO and not clipped[k]
            age[row, k] = stamp_s - seen_s[k]
    return shown, usable, age, moving
