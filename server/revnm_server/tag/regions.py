"""Where in a picture tags are looked for, and how closely: around a place, or piece by piece through all of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from revnm_client.geometry import FloatArray
from revnm_server.tag.library import Gray, Region

WORK_PX = 160_000  # of a piece of a search beside robots that drive: about 20 ms of one core with the AprilTag library
IDLE_WORK_PX = 600_000  # of one while no robot is seen, or expected anywhere
FARTHEST_SIDES = 1.8  # so far around a tag is looked at most, in its sides

# Smaller tags are enlarged twice or three times. 16 px in medium scenes: 39 % were found as they are, 63 % enlarged
# twice, 75 % three times, and four times.
_SMALL_TAG_PX = 24.0
_TINY_TAG_PX = 16.0
# Larger tags are looked for in a picture shrunk until their shortest side is this, their edges refined in all of it: as
# many are found, and as exactly, in medium and hard scenes, from 36 px on. Four times is the most that was measured.
_ENOUGH_TAG_PX = 18.0
_MOST_DECIMATION = 4.0
_SMALLEST_REGION_PX = 32.0  # half the region's side at least
_COARSE_TAG_PX = 15.0  # so large, shrunk, is a tag that a search sees in nine pictures of ten
_WITH_RIM = 1.25 * math.sqrt(2.0)  # a tag's width with its white rim, at any angle, in sides


def region_around(gray: Gray, corners: FloatArray, *, margin_sides: float) -> Region:
    """Cut a tag's surroundings out of a picture (H, W), enlarged if the tag is small; may be empty.

    Args:
        gray: The picture.
        corners: (4, 2) about where the tag's corners are, pixels; may lie outside of the picture.
        margin_sides: How far around it, in its longest side.
    """
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
    first, last = corners.min(axis=0), corners.max(axis=0)
    middle = 0.5 * (first + last)
    reach = np.maximum(0.5 * (last - first) + margin_sides * sides.max(), _SMALLEST_REGION_PX)
    height, width = gray.shape
    left, top = np.clip(middle - reach, 0, (width, height)).astype(int)
    right, bottom = np.clip(middle + reach + 1, 0, (width, height)).astype(int)
    smallest = float(sides.min())
    scale = 3 if smallest < _TINY_TAG_PX else 2 if smallest < _SMALL_TAG_PX else 1
    decimation = min(max(1.0, smallest // _ENOUGH_TAG_PX), _MOST_DECIMATION)
    return _cut(gray, int(left), int(top), int(right), int(bottom), scale=scale, decimation=decimation)


@dataclass(frozen=True, slots=True)
class Look:
    """One way of looking through a picture, in square pieces that overlap.

    Attributes:
        name: ``whole``, ``half``, ``full`` or ``enlarged``.
        decimation: As in :class:`~revnm_server.tag.library.Region`, and so is the next.
        scale: How much pieces are enlarged.
        side_px: Of a piece, in pixels of the picture.
        overlap_px: Of two pieces: a tag that the coarser looks miss lies in one of them.
    """

    name: str
    decimation: float
    scale: int
    side_px: int
    overlap_px: int

    def pieces(self, size_px: tuple[int, int]) -> tuple[int, int]:
        """Return how many pieces a picture of a width and height has across and down."""
        across, down = (
            max(1, math.ceil((size - self.overlap_px) / (self.side_px - self.overlap_px))) for size in size_px
        )
        return across, down

    def piece(self, gray: Gray, number: int) -> Region:
        """Return a piece of a picture (H, W), counted row by row from 0, and again from the first after the last."""
        height, width = gray.shape
        across, down = self.pieces((width, height))
        row, column = divmod(number % (across * down), across)
        left = _begin(width, self.side_px, column, across)
        top = _begin(height, self.side_px, row, down)
        right, bottom = min(width, left + self.side_px), min(height, top + self.side_px)
        return _cut(gray, left, top, right, bottom, scale=self.scale, decimation=self.decimation)


def looks(size_px: tuple[int, int], work_px: int) -> tuple[Look, ...]:
    """Return the ways in which a picture is looked through, whose pieces are about the same work.

    Shrunk as a whole, then, where that is coarse, at half resolution, at full, and enlarged twice: in medium scenes
    nine tags of ten are found from 30 px, 22 px and 18 px on, and from 15 px times what the whole is shrunk by.

    Args:
        size_px: Width and height of the picture.
        work_px: How many pixels, shrunk or enlarged, a piece has.
    """
    whole = max(2, math.ceil(math.sqrt(math.prod(size_px) / work_px)))
    side = math.sqrt(work_px)
    found = [Look("whole", float(whole), 1, max(size_px), 0)]
    if whole > 2:
        found.append(_look("half", 2.0, 1, 2.0 * side, missed_px=_COARSE_TAG_PX * whole))
    found.append(_look("full", 1.0, 1, side, missed_px=2.0 * _COARSE_TAG_PX))
    found.append(_look("enlarged", 1.0, 2, 0.5 * side, missed_px=_SMALL_TAG_PX))
    return tuple(found)


class Sweep:
    """Looks through pictures in all ways by turns, a piece of each picture."""

    def __init__(self) -> None:
        self._turn = 0

    def piece(self, gray: Gray, work_px: int) -> Region:
        """Return the next piece, from a picture (H, W), of about so much work."""
        height, width = gray.shape
        ways = looks((width, height), work_px)
        number, way = divmod(self._turn, len(ways))
        self._turn += 1
        return ways[way].piece(gray, number)


def _look(name: str, decimation: float, scale: int, side_px: float, *, missed_px: float) -> Look:
    return Look(name, decimation, scale, math.ceil(side_px), math.ceil(_WITH_RIM * missed_px))


def _begin(size: int, side: int, number: int, count: int) -> int:
    """Return where a piece begins of so many that are evenly spread over a size."""
    return round(number * max(0, size - side) / max(1, count - 1))


def _cut(gray: Gray, left: int, top: int, right: int, bottom: int, *, scale: int, decimation: float) -> Region:
    part = gray[top:bottom, left:right]
    if part.size > 0 and scale > 1:
        enlarged = cv2.resize(part, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        return Region(np.asarray(enlarged, dtype=np.uint8), left, top, scale, decimation)
    return Region(part, left, top, 1, decimation)
