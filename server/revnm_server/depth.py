"""Depth of a picture from a bundle's depth network."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from revnm_server.frame import Frame
from revnm_server.observation import Image32

if TYPE_CHECKING:
    from revnm_server.bundle import Bundle, DepthBundle


class OnnxDepth:
    """Monocular disparity."""

    def __init__(self, bundle: Bundle | DepthBundle) -> None:
        """Take the network, its input size and its normalisation from the bundle."""
        self._model = bundle.depth.model
        self._hw = bundle.spec.disparity_hw
        self._mean = np.array(bundle.depth.mean, dtype=np.float32)
        self._std = np.array(bundle.depth.std, dtype=np.float32)

    def disparity(self, frame: Frame) -> Image32:
        """Return the disparity (h, w) float32 of a picture of any size, up to scale and shift."""
        height, width = self._hw
        small = cv2.resize(frame.image, (width, height), interpolation=cv2.INTER_AREA)  # (h, w, 3)
        image = (small.astype(np.float32) / 255.0 - self._mean) / self._std
        batch = np.ascontiguousarray(image.transpose(2, 0, 1)[None])  # (1, 3, h, w)
        return np.asarray(self._model.run(image=batch)["disparity"][0], dtype=np.float32)
