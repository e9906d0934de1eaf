"""How a depth network's output becomes the disparity that the pipeline wants: larger is nearer, up to scale and shift.

The functions are pure. Symbols: h w of the network's output.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from revnm_client.errors import ContractError
from revnm_server.networks.depth_input import Placement
from revnm_server.observation import Image32

Kind = Literal["disparity", "depth", "metric_canonical"]

_LEAST_DEPTH = 1e-6  # networks that give depth give 0 or less for "none"
_WIDEST = 100.0  # nothing in a picture is nearer than this fraction of the median depth: that would be a glitch
_SKY = 0.5


@dataclass(frozen=True, slots=True)
class DepthOutput:
    """What a depth network gives.

    Attributes:
        name: Of the output with an image of depth or disparity.
        kind: ``disparity`` is larger where things are nearer; ``depth`` is larger where they are farther, up to scale;
            ``metric_canonical`` is depth in metres of a camera with another focal length.
        sky: Name of the output that is over 0.5 where the picture shows the sky, if there is one.
    """

    name: str
    kind: Kind
    sky: str | None = None


def as_image(what: str, array: NDArray[Any]) -> Image32:
    """Drop the axes of batch, views and channels, which must be of length 1.

    Raises:
        ContractError: What is left has not two axes.
    """
    if array.ndim < 2 or any(length != 1 for length in array.shape[:-2]):
        raise ContractError(f"{what}: expected one image (1, h, w), got {list(array.shape)}")
    return array.reshape(array.shape[-2:]).astype(np.float32, copy=False)


def without_border(image: Image32, placement: Placement) -> Image32:
    """Cut off what shows the border of the input; the output may be of another size than the input.

    Args:
        image: (h, w) of the whole input.
        placement: Where the picture lies in the input.
    """
    rows = _part(placement.top, placement.inner_hw[0], image.shape[0] / placement.hw[0])
    columns = _part(placement.left, placement.inner_hw[1], image.shape[1] / placement.hw[1])
    return image[rows, columns]


def disparity_from_depth(depth: Image32, sky: Image32 | None = None) -> Image32:
    """Return 1 / depth, and 0, infinitely far, where the network has no depth to give.

    Args:
        depth: (h, w) in any unit; values that are 0, negative or not finite are none.
        sky: (h, w), over 0.5 where the depth means nothing.

    Raises:
        ContractError: There is no depth anywhere.
    """
    given = np.isfinite(depth) & (depth > _LEAST_DEPTH)
    if sky is not None:
        given &= sky < _SKY
    if not given.any():
        raise ContractError("no depth anywhere: all of it is 0, negative, not finite or sky")
    nearest = np.float32(np.median(depth[given]) / _WIDEST)
    disparity = np.zeros(depth.shape, dtype=np.float32)
    disparity[given] = 1.0 / np.maximum(depth[given], nearest)
    return disparity


def resized(disparity: Image32, hw: tuple[int, int]) -> Image32:
    """Return the disparity in another size (h, w)."""
    if disparity.shape == hw:
        return disparity
    smaller = hw[0] <= disparity.shape[0] and hw[1] <= disparity.shape[1]
    method = cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(disparity, (hw[1], hw[0]), interpolation=method), dtype=np.float32)


def _part(start: int, length: int, scale: float) -> slice:
    return slice(round(start * scale), max(round((start + length) * scale), round(start * scale) + 1))
