"""Smooth layers that are dear to compute: taken at the nodes of a coarse grid, and interpolated between them.

Imports numpy and OpenCV only.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from revnm_server.observation import Image32

NODE_STEP = 4
"""Rows or columns from node to node."""


class NodeGrid:
    """Every fourth row and column of a layer, and the last ones."""

    def __init__(self, hw: tuple[int, int]) -> None:
        """Lay the nodes over a layer of a height and a width."""
        rows, columns = (np.unique(np.append(np.arange(0, size, NODE_STEP), size - 1)) for size in hw)
        self.nodes: tuple[NDArray[np.intp], ...] = np.ix_(rows, columns)  # index: layer[nodes]
        down, across = (
            np.interp(np.arange(size), nodes, np.arange(len(nodes))).astype(np.float32)
            for size, nodes in zip(hw, (rows, columns), strict=True)
        )
        self._place = np.meshgrid(across, down)

    def filled(self, values: NDArray[np.floating]) -> Image32:
        """Return the layer (h, w) or (h, w, C) float32 whose values at the nodes are given."""
        return np.asarray(cv2.remap(values.astype(np.float32), *self._place, cv2.INTER_LINEAR))
