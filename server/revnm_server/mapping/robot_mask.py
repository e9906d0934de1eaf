"""Where robots are in the picture, from their poses or their tags: what the disparity memory must not learn.

Imports numpy and OpenCV only.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_server.frame import RobotSighting
from revnm_server.mapping.floor_map import Body
from revnm_server.mapping.floor_view import FloorView, grid_from_picture

_LEAST_DEPTH_M = 0.1
_TAG_TO_BODY = 2.4  # a body is not much longer than so many of its tags


def robot_mask(view: FloorView, bodies: tuple[Body, ...], *, grow_px: int = 2) -> NDArray[np.bool_]:
    """Return the pixels (h, w) that robots cover, as boxes, or may cover.

    Args:
        view: The calibrated camera.
        bodies: Where the robots are, and how large.
        grow_px: So many pixels of the grid more on every side, for errors of pose and edges of the depth.
    """
    outlines = []
    for body in bodies:
        pixels, depth = view.camera.project(_corners_m(body))
        outlines.append(pixels[depth > _LEAST_DEPTH_M])
    return _filled(outlines, view.camera.size_px, view.hw, grow_px)


def tag_mask(
    sightings: Sequence[RobotSighting], size_px: tuple[int, int], hw: tuple[int, int], *, grow_px: int = 2
) -> NDArray[np.bool_]:
    """Return the pixels (h, w) about tags that robots may cover, where no calibration tells more.

    Args:
        sightings: Where the tags are.
        size_px: Width and height of the camera's picture.
        hw: Height and width of the grid.
        grow_px: So many pixels of the grid more on every side.
    """
    outlines = [sighting.pixel + _TAG_TO_BODY * (sighting.corners - sighting.pixel) for sighting in sightings]
    return _filled(outlines, size_px, hw, grow_px)


def _filled(
    outlines: Sequence[FloatArray], size_px: tuple[int, int], hw: tuple[int, int], grow_px: int
) -> NDArray[np.bool_]:
    """Return the pixels (h, w) in the hulls of outlines (M, 2), pixels of the picture, grown."""
    mask, limit = np.zeros(hw, dtype=np.uint8), 4.0 * max(hw)
    for outline in outlines:
        if len(outline) >= 3:
            place = np.clip(grid_from_picture(outline, size_px, hw), -limit, limit)
            cv2.fillConvexPoly(mask, cv2.convexHull(np.rint(place).astype(np.int32)), 1)
    side = 2 * grow_px + 1
    return np.asarray(cv2.dilate(mask, np.ones((side, side), dtype=np.uint8)) > 0)


def _corners_m(body: Body) -> NDArray[np.float64]:
    """Return the corners (8, 3), floor frame."""
    half = 0.5 * np.array([body.length_m, body.width_m])
    footprint = body.floor_from_robot.apply(half * np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]]))
    heights = np.repeat([0.0, body.height_m], 4)[:, None]
    return np.concatenate([np.tile(footprint, (2, 1)), heights], axis=1)
