"""Where robots are in a depth picture: their pixels tell nothing of the room. Imports numpy and OpenCV only."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_server.floor_camera import FloorCamera
from revnm_server.floor_map import Body
from revnm_server.floor_view import grid_from_picture
from revnm_server.frame import RobotSighting

_MARGIN_M = 0.06
_TAG_TO_BODY = 2.4  # a body is not much longer than so many of its tags
_EDGE_CELLS = 2  # depth networks blur edges over about so much


def robot_mask(
    hw: tuple[int, ...],
    size_px: tuple[int, int],
    camera: FloorCamera | None,
    bodies: Mapping[str, Body],
    sightings: Sequence[RobotSighting],
) -> NDArray[np.bool_]:
    """Return the robots' pixels.

    Args:
        hw: Height and width of the depth picture.
        size_px: Width and height of the camera's picture.
        camera: The calibration, if there is one.
        bodies: Robots whose place is known.
        sightings: The last ones of all robots; those without a body are masked about their tag.

    Returns:
        (h, w), True on a robot.
    """
    mask = np.zeros(hw, dtype=np.uint8)
    outlines = [_outline(camera, body) for body in bodies.values()] if camera is not None else []
    placed = set(bodies) if camera is not None else set()
    outlines += [_around_tag(sighting) for sighting in sightings if sighting.robot not in placed]
    for outline in outlines:
        cells = grid_from_picture(outline, size_px, (hw[0], hw[1]))
        hull = cv2.convexHull(np.rint(np.clip(cells, -10_000.0, 10_000.0)).astype(np.int32))
        cv2.fillConvexPoly(mask, hull, 1)
    kernel = np.ones((2 * _EDGE_CELLS + 1,) * 2, dtype=np.uint8)
    return np.asarray(cv2.dilate(mask, kernel) > 0)


def _outline(camera: FloorCamera, body: Body) -> FloatArray:
    """Return the pixels (8, 2) of a body's corners."""
    x, y = 0.5 * body.length_m + _MARGIN_M, 0.5 * body.width_m + _MARGIN_M
    ground = body.floor_from_robot.apply(np.array([[x, y], [x, -y], [-x, -y], [-x, y]]))
    low, high = (np.column_stack([ground, np.full(4, height)]) for height in (0.0, body.height_m + _MARGIN_M))
    pixels, _ = camera.project(np.concatenate([low, high]))
    return pixels


def _around_tag(sighting: RobotSighting) -> FloatArray:
    return np.asarray(sighting.pixel + _TAG_TO_BODY * (sighting.corners - sighting.pixel))
