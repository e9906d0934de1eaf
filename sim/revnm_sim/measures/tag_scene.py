"""Pictures of a tag as a camera on a wall takes them: tilted, blurred, noisy, before clutter; with the truth.

For measuring detectors. The picture is made as a lens and a chip make it: every pixel the mean over its area,
then blur, then noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_server.tag.family import CELLS, RIM_CELLS
from revnm_sim.measures.tag_clutter import cluttered
from revnm_sim.tag_picture import INK, TagPicture

_FOCAL_PX = 600.0  # how strong perspective is
_FINE = 8  # how much finer the tag's outline is drawn
_WINDOW_MARGIN_PX = 3
_RIM = (CELLS + 2 * RIM_CELLS) / CELLS  # side of the white rim, in sides of the border


@dataclass(frozen=True, slots=True)
class Difficulty:
    """How bad the pictures are.

    Attributes:
        max_tilt_deg: Tilts are uniform up to this, about any axis.
        blur_px: Standard deviation of the lens's blur.
        noise: Standard deviation of the chip's noise, gray levels.
        ink: Gray level of black.
        paper: Gray level of white.
    """

    max_tilt_deg: float
    blur_px: float
    noise: float
    ink: float
    paper: float


DIFFICULTIES = {
    "easy": Difficulty(30.0, 0.5, 3.0, 30.0, 220.0),
    "medium": Difficulty(50.0, 0.8, 6.0, 60.0, 190.0),
    "hard": Difficulty(60.0, 1.2, 10.0, 60.0, 190.0),
}


@dataclass(frozen=True, slots=True)
class TagScene:
    """A picture with one tag.

    Attributes:
        clean: (H, W) float32 gray levels before blur and noise.
        corners: (4, 2) the black border's corners, pixels: front left, front right, rear right, rear left.
        pixel: (2,) the tag's middle.
    """

    clean: NDArray[np.float32]
    corners: FloatArray
    pixel: FloatArray

    def taken(self, difficulty: Difficulty, rng: np.random.Generator) -> NDArray[np.uint8]:
        """Return one picture (H, W) uint8 of the scene; another call has other noise."""
        return taken(self.clean, difficulty, rng)


def taken(clean: NDArray[np.float32], difficulty: Difficulty, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return what a camera makes of gray levels (H, W): blurred, noisy, uint8."""
    blurred = cv2.GaussianBlur(clean, (0, 0), difficulty.blur_px)
    noise = rng.standard_normal(clean.shape, dtype=np.float32) * np.float32(difficulty.noise)
    return np.clip(np.rint(blurred + noise), 0, 255).astype(np.uint8)


def tag_scene(
    tag: TagPicture, *, side_px: float, size_px: tuple[int, int], difficulty: Difficulty, rng: np.random.Generator
) -> TagScene:
    """Draw a tag at a random place, roll and tilt before clutter.

    Args:
        tag: What is drawn.
        side_px: Side of the black border were it seen face on.
        size_px: Width and height of the picture.
        difficulty: Bounds the tilt; its gray levels are the tag's.
        rng: Draws the scene.
    """
    reach = 0.5 * math.sqrt(2.0) * side_px * _RIM * 1.3 + 4.0
    place = np.array([rng.uniform(reach, extent - 1 - reach) for extent in size_px])
    turn = _rotation(rng, max_tilt_deg=difficulty.max_tilt_deg)
    clean = cluttered(rng, size_px).astype(np.float32)
    corners = _projected(turn, place, side_px, half=0.5)
    _draw(clean, tag, corners, _projected(turn, place, side_px, half=0.5 * _RIM), difficulty)
    return TagScene(clean, corners, place)


def _rotation(rng: np.random.Generator, *, max_tilt_deg: float) -> FloatArray:
    """Return a rotation (3, 3) of the tag: a roll in its plane, then a tilt about an axis in the picture."""
    roll, axis = rng.uniform(0.0, math.tau, 2)
    tilt = math.radians(rng.uniform(0.0, max_tilt_deg))
    in_plane, _ = cv2.Rodrigues(np.array([0.0, 0.0, roll]))
    out_of_plane, _ = cv2.Rodrigues(tilt * np.array([math.cos(axis), math.sin(axis), 0.0]))
    return np.asarray(out_of_plane @ in_plane, dtype=np.float64)


def _projected(turn: FloatArray, place: FloatArray, side_px: float, *, half: float) -> FloatArray:
    """Return the corners (4, 2) of a square, ``half`` of whose side is given in sides of the tag, pixels.

    The tag's x points right and its y down when it is upright.
    """
    square = np.array([[-half, -half, 0.0], [half, -half, 0.0], [half, half, 0.0], [-half, half, 0.0]]) * side_px
    points = square @ turn.T
    return np.asarray(place + points[:, :2] * (_FOCAL_PX / (_FOCAL_PX + points[:, 2:])))


def _draw(
    gray: NDArray[np.float32], tag: TagPicture, corners: FloatArray, rim: FloatArray, difficulty: Difficulty
) -> None:
    """Draw the tag with its white rim into gray levels (H, W)."""
    left, top = (np.floor(rim.min(axis=0)).astype(int) - _WINDOW_MARGIN_PX).tolist()
    right, bottom = (np.ceil(rim.max(axis=0)).astype(int) + _WINDOW_MARGIN_PX + 1).tolist()
    window = gray[top:bottom, left:right]
    size = (right - left, bottom - top)
    reflectance = tag.warped(corners - [left, top], size)
    shade = difficulty.ink + (reflectance - INK) / (1.0 - INK) * (difficulty.paper - difficulty.ink)
    fine = np.zeros((size[1] * _FINE, size[0] * _FINE), np.float32)
    outline = (rim - [left, top] + 0.5) * _FINE - 0.5
    cv2.fillConvexPoly(fine, np.rint(outline * 16).astype(np.int32), 1.0, shift=4)
    cover = cv2.resize(fine, size, interpolation=cv2.INTER_AREA)
    window += cover * (shade - window)
