"""Where robots are in the picture, from their poses: what the disparity memory must not learn.

Imports numpy and OpenCV only.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from revnm_server.floor_map import Body
from revnm_server.floor_view import FloorView, grid_from_picture

_LEAST_DEPTH_M = 0.1


def robot_mask(view: FloorView, bodies: tuple[Body, ...], *, grow_px: int = 2) -> NDArray[np.bool_]:
    """Return the pixels (h, w) that robots cover, as boxes, or may cover.

    Args:
        view: The calibrated camera.
        bodies: Where the robots are, and how large.
        grow_px: So many pixels of the grid more on every side, for errors of pose and edges of the depth.
    """
    mask = np.zeros(view.hw, dtype=np.uint8)
    for body in bodies:
        pixels, depth = view.camera.project(_corners_m(body))
        place = grid_from_picture(pixels, view.camera.size_px, view.hw)[depth > _LEAST_DEPTH_M]
        if len(place) >= 3:
            limit = 4.0 * max(view.hw)
            hull = cv2.convexHull(np.rint(np.clip(place, -limit, limit)).astype(np.int32))
            cv2.fillConvexPoly(mask, hull, 1)
    side = 2 * grow_px + 1
    return np.asarray(cv2.dilate(mask, np.ones((side, side), dtype=np.uint8)) > 0)


def _corners_m(body: Body) -> NDArray[np.float64]:
    """Return the corners (8, 3), floor frame."""
    half = 0.5 * np.array([body.length_m, body.width_m])
    footprint = body.floor_from_robot.apply(half * np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]]))
    heights = np.repeat([0.0, body.height_m], 4)[:, None]
    return np.concatenate([np.tile(footprint, (2, 1)), heights], axis=1)
