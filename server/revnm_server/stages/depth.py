"""The pipeline's disparity, from a depth network."""

from __future__ import annotations

from typing import TYPE_CHECKING

from revnm_server.frame import Frame
from revnm_server.networks.depth_output import resized
from revnm_server.observation import Image32

if TYPE_CHECKING:
    from revnm_server.networks.bundle import Bundle, DepthBundle


class OnnxDepth:
    """Monocular disparity."""

    def __init__(self, bundle: Bundle | DepthBundle) -> None:
        """Take the network and the size of the disparity from the bundle."""
        self._network = bundle.depth
        self._hw = bundle.spec.disparity_hw

    def disparity(self, frame: Frame) -> Image32:
        """Return the disparity (h, w) float32 of a picture of any size, up to scale and shift."""
        return resized(self._network.disparity(frame.image), self._hw)
