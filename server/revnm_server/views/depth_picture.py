"""Colours depth for people: what is near is bright and warm, what is far is dark."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from revnm_server.observation import Image32

_WIDTH_PX = 640
_EGO_PX = 320


def depth_picture(disparity: Image32, *, size_px: tuple[int, int]) -> NDArray[np.uint8]:
    """Return the camera's depth as a picture (h, 640, 3) uint8, RGB, of the camera's proportions.

    Args:
        disparity: (h, w) in [0, 1], 1 is near; it may be squeezed.
        size_px: Width and height of the camera's picture.
    """
    height_px = max(1, round(_WIDTH_PX * size_px[1] / size_px[0]))
    return _coloured(cv2.resize(disparity, (_WIDTH_PX, height_px), interpolation=cv2.INTER_LINEAR))


def ego_picture(depth: Image32) -> NDArray[np.uint8]:
    """Return what a robot is thought to see as a picture (320, 320, 3) uint8, RGB.

    Args:
        depth: (ego_px, ego_px) in [−1, 1], −1 is near, 1 is as far as is looked.
    """
    return _coloured(cv2.resize(0.5 - 0.5 * depth, (_EGO_PX, _EGO_PX), interpolation=cv2.INTER_NEAREST))


def _coloured(nearness: NDArray[np.generic]) -> NDArray[np.uint8]:
    """Colour (h, w) in [0, 1] by a scale of even steps to the eye, also without colour vision."""
    levels = np.rint(255.0 * np.clip(nearness, 0.0, 1.0)).astype(np.uint8)
    coloured = cv2.applyColorMap(levels, cv2.COLORMAP_INFERNO)
    return np.asarray(cv2.cvtColor(coloured, cv2.COLOR_BGR2RGB), dtype=np.uint8)
