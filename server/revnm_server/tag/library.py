"""What the detector asks of a tag library, and what libraries have in common."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray

Gray = NDArray[np.uint8]

SMALLEST_PICTURE_PX = 32


class Region(NamedTuple):
    """A part of a picture that is looked through.

    Attributes:
        gray: (h, w) the part, perhaps enlarged; may be empty.
        left: The picture's column of the part's first pixel.
        top: The same of the row.
        scale: How much ``gray`` is enlarged.
        decimation: Quads are looked for in ``gray`` shrunk by this; their edges are refined in all of it.
    """

    gray: Gray
    left: int
    top: int
    scale: int
    decimation: float


class Detection(NamedTuple):
    """A tag in a picture.

    Attributes:
        tag_id: Its number.
        margin: How far its bits are from the threshold between black and white, in gray levels of the library's own.
        pixel: (2,) as in :class:`~revnm_server.frame.RobotSighting`, and so are the next two.
        heading: (2,).
        corners: (4, 2).
    """

    tag_id: int
    margin: float
    pixel: FloatArray
    heading: FloatArray
    corners: FloatArray


class TagLibrary(Protocol):
    """Finds tags; for one thread at a time."""

    @property
    def name(self) -> str:
        """The name that settings call it by."""
        ...

    def detect(self, region: Region) -> list[Detection]:
        """Return the tags that are certain, in pixels of the whole picture; none in a part that is too small."""
        ...


def whole_picture(gray: Gray, *, decimation: float) -> Region:
    """Return a picture (H, W) as a region."""
    return Region(gray, 0, 0, 1, decimation)


def checked_gray(region: Region) -> Gray | None:
    """Return the region's pixels as C code may read them, or None where there are too few."""
    gray = np.ascontiguousarray(region.gray, dtype=np.uint8)
    return gray if gray.ndim == 2 and min(gray.shape) >= SMALLEST_PICTURE_PX else None


def detection_in_picture(
    region: Region, *, tag_id: int, margin: float, homography: FloatArray, corners: FloatArray
) -> Detection:
    """Turn what a library found in a region into a detection in the picture.

    Libraries count pixels from their outer edges, we from their centres: half a pixel less.

    Args:
        region: Where it was found.
        tag_id: Its number.
        margin: As in :class:`Detection`.
        homography: (3, 3) from the tag, x right and y down when it is upright, the border at ±1, to ``region.gray``.
        corners: (4, 2) in ``region.gray``: front left, front right, rear right, rear left.
    """
    offset = np.array([region.left, region.top]) - 0.5
    x, y, w = homography[:, 2]  # the tag's middle
    # Derivative of the projected middle along the tag's up, (0, −1).
    up = -(homography[:2, 1] - homography[2, 1] * np.array([x, y]) / w) / w
    return Detection(
        tag_id=tag_id,
        margin=margin,
        pixel=np.array([x, y]) / w / region.scale + offset,
        heading=np.asarray(up / np.linalg.norm(up)),
        corners=corners / region.scale + offset,
    )
