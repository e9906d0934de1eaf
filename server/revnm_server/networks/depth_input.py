"""How a camera's picture becomes the input of a depth network.

Networks differ in size, in what they do with the picture's shape and in the numbers of a pixel. All of that is data,
and the functions are pure; nothing here knows a model's name. Symbols: H W of the network's input.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from revnm_server.networks.manifest import PerChannel

Mode = Literal["fixed", "letterbox", "longest", "shortest"]
Range = Literal["unit", "byte"]

MAX_SIDE_PX = 4096
_FREE_SIDE_PX = (
    2048  # of an input whose shape the picture decides: no camera's picture may ask for any amount of memory
)
_BORDER = (124, 116, 104)  # ImageNet's mean, in bytes: next to nothing after the usual normalisation


@dataclass(frozen=True, slots=True)
class DepthInput:
    """What a depth network takes.

    Attributes:
        name: Of the input.
        size_hw: H and W; with ``longest`` and ``shortest`` both are the length that this side of the picture gets.
        mode: ``fixed`` squeezes the picture into H × W, ``letterbox`` keeps its shape and adds a border.
        multiple_of: H and W are multiples of it, with ``longest`` and ``shortest`` by rounding.
        range: Whether a channel is in [0, 1] or in [0, 255] before mean and std.
        mean: Per channel, RGB, subtracted.
        std: Per channel, divides what is left.
        dtype: ``float32``, ``float16`` or ``uint8``.
        views: Whether there is an axis for several views between batch and channels.
    """

    name: str
    size_hw: tuple[int, int]
    mode: Mode
    mean: PerChannel
    std: PerChannel
    multiple_of: int = 1
    range: Range = "unit"
    dtype: str = "float32"
    views: bool = False


@dataclass(frozen=True, slots=True)
class Placement:
    """Where the picture lies in the network's input.

    Attributes:
        hw: H and W.
        top: Rows of border above the picture.
        left: Columns of border left of it.
        inner_hw: Height and width of the picture, in pixels of the input.
    """

    hw: tuple[int, int]
    top: int
    left: int
    inner_hw: tuple[int, int]


def place(picture_hw: tuple[int, int], takes: DepthInput) -> Placement:
    """Return where a picture of some size goes in the input."""
    if takes.mode == "fixed":
        return Placement(takes.size_hw, 0, 0, takes.size_hw)
    if takes.mode == "letterbox":
        return _letterbox(picture_hw, takes.size_hw)
    side = max(picture_hw) if takes.mode == "longest" else min(picture_hw)
    scale = takes.size_hw[0] / side
    height, width = (_rounded(length * scale, takes.multiple_of) for length in picture_hw)
    return Placement((height, width), 0, 0, (height, width))


def batch(image: NDArray[np.uint8], placement: Placement, takes: DepthInput) -> NDArray[Any]:
    """Return the network's input.

    Args:
        image: (h, w, 3) RGB.
        placement: Of :func:`place`.
        takes: What the network takes.

    Returns:
        (1, 3, H, W), or (1, 1, 3, H, W) with views.
    """
    whole = _framed(_resized(image, placement.inner_hw), placement)  # (H, W, 3) uint8
    if takes.dtype == "uint8":
        pixels: NDArray[Any] = whole
    else:
        unit = np.float32(255.0 if takes.range == "unit" else 1.0)
        mean, std = (np.array(each, dtype=np.float32) for each in (takes.mean, takes.std))
        pixels = ((whole.astype(np.float32) / unit - mean) / std).astype(takes.dtype, copy=False)
    planes = np.ascontiguousarray(pixels.transpose(2, 0, 1)[None])  # (1, 3, H, W)
    return planes[None] if takes.views else planes


def _letterbox(picture_hw: tuple[int, int], hw: tuple[int, int]) -> Placement:
    scale = min(hw[0] / picture_hw[0], hw[1] / picture_hw[1])
    height, width = (max(1, min(whole, round(n * scale))) for n, whole in zip(picture_hw, hw, strict=True))
    return Placement(hw, (hw[0] - height) // 2, (hw[1] - width) // 2, (height, width))


def _rounded(length: float, multiple: int) -> int:
    """Return the nearest multiple; at least one, and no more than the memory for it."""
    return multiple * min(max(1, round(length / multiple)), max(1, _FREE_SIDE_PX // multiple))


def _resized(image: NDArray[np.uint8], hw: tuple[int, int]) -> NDArray[np.uint8]:
    smaller = hw[0] <= image.shape[0] and hw[1] <= image.shape[1]
    method = cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, (hw[1], hw[0]), interpolation=method), dtype=np.uint8)


def _framed(inner: NDArray[np.uint8], placement: Placement) -> NDArray[np.uint8]:
    if placement.inner_hw == placement.hw:
        return inner
    whole = np.full((*placement.hw, 3), _BORDER, dtype=np.uint8)
    (height, width), top, left = placement.inner_hw, placement.top, placement.left
    whole[top : top + height, left : left + width] = inner
    return whole
