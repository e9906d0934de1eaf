"""Tag-free pictures that tempt a tag detector: shapes, checkerboards, print, grids of random cells."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Gray = NDArray[np.uint8]

_SHAPES_PER_MPX = 220  # as many as a full room shows


def cluttered(rng: np.random.Generator, size_px: tuple[int, int]) -> Gray:
    """Return a picture (H, W) of random boxes, discs and lines on an uneven ground."""
    width, height = size_px
    small = rng.integers(60, 190, (6, 8)).astype(np.uint8)
    gray = np.asarray(cv2.resize(small, size_px, interpolation=cv2.INTER_CUBIC), dtype=np.uint8)
    for _ in range(max(8, int(_SHAPES_PER_MPX * width * height / 1e6))):
        _draw_shape(gray, rng)
    return gray


def _draw_shape(gray: Gray, rng: np.random.Generator) -> None:
    height, width = gray.shape
    level = int(rng.integers(0, 256))
    centre = (int(rng.integers(0, width)), int(rng.integers(0, height)))
    extent = rng.uniform(5.0, 90.0, 2)
    turned = cv2.boxPoints((centre, extent.tolist(), float(rng.uniform(0.0, 180.0)))).astype(np.int32)
    match rng.integers(0, 4):
        case 0 | 1:
            cv2.fillConvexPoly(gray, turned, level, cv2.LINE_AA)
        case 2:
            cv2.circle(gray, centre, int(extent[0] / 2), level, int(rng.integers(-1, 1)) or 2, cv2.LINE_AA)
        case _:
            cv2.polylines(gray, [turned], True, level, int(rng.integers(1, 5)), cv2.LINE_AA)  # noqa: FBT003
