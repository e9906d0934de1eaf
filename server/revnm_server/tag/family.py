"""The family 36h11: which cells of a tag are white, its upper edge at the robot's front.

The cells come from OpenCV's table, which every installation has, and not from OpenCV's idea of up: up to 5.0.0 it has
the family upside down (opencv/opencv#28823). What a version does is found by looking at one tag.
"""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

FAMILY = "tag36h11"
TAGS = 587
CELLS = 8  # along a side, the black border included, the white rim not
RIM_CELLS = 1  # white around the border that the family asks for

# Tag 0 within its border, # is white: 0xd7e00984b of the AprilTag library's table, in the order of its bits.
_TAG_0 = ("##.#.#", ".###.#", ".##...", "#.#...", ".#.##.", "...#..")


def upright_cells(tag_id: int) -> NDArray[np.bool_]:
    """Return which cells (CELLS, CELLS) of a tag are white, the rows from the robot's front to its rear."""
    cells = _drawn_by_opencv(tag_id)
    return np.asarray(np.rot90(cells, 2) if opencv_is_upside_down() else cells)


@cache
def opencv_is_upside_down() -> bool:
    """Return whether this version of OpenCV takes the rear of a tag for its upper edge.

    Raises:
        RuntimeError: OpenCV's family is not 36h11 any way up.
    """
    upright = np.array([[cell == "#" for cell in row] for row in _TAG_0])
    drawn = _drawn_by_opencv(0)[1:-1, 1:-1]
    if np.array_equal(drawn, upright):
        return False
    if np.array_equal(np.rot90(drawn, 2), upright):
        return True
    raise RuntimeError(f"OpenCV {cv2.__version__}: tag 0 of DICT_APRILTAG_36h11 is not the AprilTag library's")


def _drawn_by_opencv(tag_id: int) -> NDArray[np.bool_]:
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    return np.asarray(cv2.aruco.generateImageMarker(family, tag_id, CELLS)) > 0
