"""Pictures with a tag in them, drawn from a known homography."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_server.frame import Frame
from revnm_server.tag.family import upright_cells

_CELLS = 8
_CELL_PX = 16
_SUPERSAMPLING = 4


def upright_tag(tag_id: int) -> NDArray[np.uint8]:
    """Return the cells (10, 10) of a tag with its white rim, as AprilRobotics/apriltag-imgs prints it."""
    return np.pad(upright_cells(tag_id).astype(np.uint8) * 255, 1, constant_values=255)


def picture_from_tag(*, centre: tuple[float, float], side_px: float, turn_rad: float, tilt: float = 0.0) -> FloatArray:
    """Return a homography (3, 3) that takes the tag to the picture.

    Args:
        centre: Where the tag's middle goes, pixels, pixel centres at integers.
        side_px: Side of the black border.
        turn_rad: Turn of the tag's up from the picture's up, clockwise as seen.
        tilt: Perspective: 0 looks straight down, towards 1 the picture's upper part lies far away.

    Returns:
        Maps tag coordinates, x right and y up, the black border at ±0.5, to pixels.
    """
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    turned = np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, 1.0]])  # y up becomes v down
    tilted = np.array([[1.0, 0.0, 0.0], [0.0, 1.0 - 0.6 * tilt, 0.0], [0.0, -tilt, 1.0]])
    placed = np.array([[side_px, 0.0, centre[0]], [0.0, side_px, centre[1]], [0.0, 0.0, 1.0]])
    return np.asarray(placed @ tilted @ turned)


def project(homography: FloatArray, points: FloatArray) -> FloatArray:
    """Map points (M, 2) of the tag to pixels (M, 2)."""
    mapped = np.column_stack([points, np.ones(len(points))]) @ homography.T
    return np.asarray(mapped[:, :2] / mapped[:, 2:])


def draw_tag(
    gray: NDArray[np.uint8], tag_id: int, homography: FloatArray, *, ink: float = 20.0, paper: float = 230.0
) -> NDArray[np.uint8]:
    """Draw a tag into a gray picture; returns a new picture. Supersampled, so that edges are smooth."""
    texture = np.kron(upright_tag(tag_id), np.ones((_CELL_PX, _CELL_PX))) / 255.0 * (paper - ink) + ink
    cells, k = _CELLS + 2, _SUPERSAMPLING
    # Texture pixel (edges at integers minus a half) -> tag: the rim is a cell wide on each side.
    unit = 1.0 / (_CELLS * _CELL_PX)
    middle = cells * _CELL_PX / 2.0
    tag_from_texture = np.array(
        [[unit, 0.0, (0.5 - middle) * unit], [0.0, -unit, (middle - 0.5) * unit], [0.0, 0.0, 1.0]]
    )
    # Only the tag's surroundings are drawn: picture -> part of it, supersampled, pixel centres at integers.
    rim = project(homography, np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * cells / _CELLS / 2)
    left, top = np.clip(np.floor(rim.min(axis=0)) - 1, 0, None).astype(int).tolist()
    right, bottom = np.clip(np.ceil(rim.max(axis=0)) + 2, 0, gray.shape[::-1]).astype(int).tolist()
    fine = np.array([[k, 0.0, (k - 1) / 2.0 - k * left], [0.0, k, (k - 1) / 2.0 - k * top], [0.0, 0.0, 1.0]])
    size = ((right - left) * k, (bottom - top) * k)
    matrix = fine @ homography @ tag_from_texture
    colour, cover = (
        cv2.resize(
            cv2.warpPerspective(part, matrix, size, flags=cv2.INTER_LINEAR, borderValue=0.0),
            (right - left, bottom - top),
            interpolation=cv2.INTER_AREA,
        )
        for part in (texture, np.ones_like(texture))
    )
    drawn = gray.copy()
    window = drawn[top:bottom, left:right]
    window[:] = np.clip(window * (1.0 - cover) + colour, 0, 255)
    return drawn


def frame_of(gray: NDArray[np.uint8], *, stamp_ns: int = 0) -> Frame:
    """Return a frame that shows the gray picture."""
    return Frame(np.repeat(gray[:, :, None], 3, axis=2), stamp_ns, stamp_ns)


def floor(seed: int = 0, *, size: tuple[int, int] = (640, 480)) -> NDArray[np.uint8]:
    """Return a cluttered, noisy gray picture."""
    rng = np.random.default_rng(seed)
    gray = np.full((size[1], size[0]), 120, np.uint8)
    for _ in range(60):
        corner = rng.integers(0, size)
        opposite = corner + rng.integers(5, 80, 2)
        cv2.rectangle(gray, corner.tolist(), opposite.tolist(), int(rng.integers(0, 255)), -1)
    return np.clip(gray + rng.normal(0, 3, gray.shape), 0, 255).astype(np.uint8)


def blur_and_noise(gray: NDArray[np.uint8], seed: int = 0) -> NDArray[np.uint8]:
    """Return the gray picture as a camera takes it."""
    noise = np.random.default_rng(seed).normal(0, 3, gray.shape)
    return np.clip(cv2.GaussianBlur(gray, (0, 0), 0.5) + noise, 0, 255).astype(np.uint8)
