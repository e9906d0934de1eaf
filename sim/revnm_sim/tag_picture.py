"""The AprilTag on the robot's back, as a texture and warped into a picture.

Why the tag is not a texture of PyBullet's software renderer: that samples the nearest texel without smoothing, so a tag
of 20 px would be noise.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_server.tag.family import CELLS, RIM_CELLS, upright_cells

INK, _PAPER = 0.04, 1.0  # reflectances
_MAX_CELL_PX = 64
_FINE_SIDE_PX, _MAX_FINE = 512, 6  # pictures are drawn finer up to about this side, then averaged


class TagPicture:
    """A tag of the family 36h11, upright as the AprilTag library prints it: its upper edge lies forward."""

    def __init__(self, tag_id: int) -> None:
        cells = np.pad(upright_cells(tag_id), RIM_CELLS, constant_values=True)
        reflectance = np.where(cells, _PAPER, INK)
        self._cells = reflectance.astype(np.float32)  # (CELLS + 2, CELLS + 2)

    def warped(self, corners: FloatArray, size_px: tuple[int, int]) -> NDArray[np.float32]:
        """Return the tag's reflectance as seen in a picture, every pixel the mean over its area; 1 outside.

        Args:
            corners: (4, 2) pixels of the black border: front left, front right, rear right, rear left.
            size_px: Width and height of the picture.

        Returns:
            (height, width) in (0, 1].
        """
        fine = int(np.clip(_FINE_SIDE_PX // max(size_px), 1, _MAX_FINE))
        enlarged = (corners + 0.5) * fine - 0.5
        side = float(np.linalg.norm(enlarged - np.roll(enlarged, 1, axis=0), axis=1).max())
        # About one texel a pixel: fewer blur the tag, more alias.
        cell_px = int(np.clip(round(side / CELLS), 2, _MAX_CELL_PX))
        texture = np.kron(self._cells, np.ones((cell_px, cell_px), dtype=np.float32))
        near, far = cell_px - 0.5, (CELLS + 1) * cell_px - 0.5
        source = np.array([[near, near], [far, near], [far, far], [near, far]], dtype=np.float32)
        warped = cv2.warpPerspective(
            texture,
            cv2.getPerspectiveTransform(source, enlarged.astype(np.float32)),
            (size_px[0] * fine, size_px[1] * fine),
            flags=cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=_PAPER,
        )
        return np.asarray(cv2.resize(warped, size_px, interpolation=cv2.INTER_AREA), dtype=np.float32)
