"""Where in a picture tags are looked for, and how closely: around a last place, or a search through all of it."""

from __future__ import annotations

import cv2
import numpy as np

from revnm_client.geometry import FloatArray
from revnm_server.tag.library import Gray, Region, whole_picture

# Smaller tags are enlarged twice or three times. 16 px in medium scenes: 39 % were found as they are, 63 % enlarged
# twice, 75 % three times, and four times.
_SMALL_TAG_PX = 24.0
_TINY_TAG_PX = 16.0
_LARGE_TAG_PX = 80.0  # what is larger is looked for at half resolution; its edges are refined at full
_REGION_SIDES = 2.0  # half the region's side, in sides of the tag, which moves 0.2 a picture at 0.5 m/s
_SMALLEST_REGION_PX = 32.0  # half the region's side at least
SEARCHES = ("half", "full", "strip")  # how the three kinds of search look, in their turn
_STRIPS = 6  # of the picture, each as much work enlarged twice as all of it at full resolution
_OVERLAP_PX = 48  # of two strips: a tag that needs them, with its white rim, at any angle


def region_around(gray: Gray, corners: FloatArray) -> Region:
    """Cut a tag's surroundings out of a picture (H, W), enlarged if the tag is small; may be empty.

    Args:
        gray: The picture.
        corners: (4, 2) the tag's last corners, pixels.
    """
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
    reach = max(_REGION_SIDES * float(sides.max()), _SMALLEST_REGION_PX)
    middle = corners.mean(axis=0)
    height, width = gray.shape
    left, top = np.clip(middle - reach, 0, (width, height)).astype(int)
    right, bottom = np.clip(middle + reach + 1, 0, (width, height)).astype(int)
    smallest = float(sides.min())
    scale = 3 if smallest < _TINY_TAG_PX else 2 if smallest < _SMALL_TAG_PX else 1
    decimation = 2.0 if smallest > _LARGE_TAG_PX else 1.0
    return _cut(gray, int(left), int(top), int(right), int(bottom), scale=scale, decimation=decimation)


def search_region(gray: Gray, number: int) -> Region:
    """Return what the search of a number, counted from 0, looks through; three kinds take turns.

    All of the picture at half resolution, then at full, then a strip enlarged twice. Measured in medium scenes: nine
    tags of ten are found from 30 px, 22 px and 18 px on; the first takes a fifth of the second's time, a strip two
    thirds of it.
    """
    turn, kind = divmod(number, len(SEARCHES))
    if kind < 2:
        return whole_picture(gray, decimation=(2.0, 1.0)[kind])
    height, width = gray.shape
    first = turn % _STRIPS
    top = max(0, height * first // _STRIPS - _OVERLAP_PX // 2)
    bottom = min(height, height * (first + 1) // _STRIPS + _OVERLAP_PX // 2)
    return _cut(gray, 0, top, width, bottom, scale=2, decimation=1.0)


def _cut(gray: Gray, left: int, top: int, right: int, bottom: int, *, scale: int, decimation: float) -> Region:
    part = gray[top:bottom, left:right]
    if part.size > 0 and scale > 1:
        enlarged = cv2.resize(part, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        return Region(np.asarray(enlarged, dtype=np.uint8), left, top, scale, decimation)
    return Region(part, left, top, 1, decimation)
