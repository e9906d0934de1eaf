"""JPEG to and from pictures; a picture's size is read from its header before anything is decoded."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from revnm_client.errors import MessageError

MAX_PIXELS = 33_177_600
"""8K UHD; what claims to be bigger is refused."""

MIN_SIDE_PX = 32
_NO_FRAME_MARKERS = {0xC4, 0xC8, 0xCC}  # Huffman tables, reserved, arithmetic coding: among the SOF numbers
QUALITY = 80
"""Of pictures that are shown to people, in [1, 100]."""


def check_size(width: int, height: int) -> None:
    """Check that a picture is neither tiny nor absurdly big.

    Raises:
        MessageError: It is.
    """
    if min(width, height) < MIN_SIDE_PX or width * height > MAX_PIXELS:
        raise MessageError(
            f"picture of {width} x {height}: expected sides >= {MIN_SIDE_PX}, {MAX_PIXELS} pixels in all"
        )


def jpeg_size(data: bytes) -> tuple[int, int]:
    """Return width and height from the header (ITU-T T.81, annex B).

    Raises:
        MessageError: There is no start-of-frame segment where one must be.
    """
    place = 2
    while place + 9 <= len(data) and data[place] == 0xFF:
        marker = data[place + 1]
        if marker == 0xFF:  # fill byte
            place += 1
            continue
        if 0xC0 <= marker <= 0xCF and marker not in _NO_FRAME_MARKERS:
            height = int.from_bytes(data[place + 5 : place + 7])
            width = int.from_bytes(data[place + 7 : place + 9])
            return width, height
        place += 2 + max(int.from_bytes(data[place + 2 : place + 4]), 2)
    raise MessageError(f"JPEG of {len(data)} bytes has no frame header")


def decode_jpeg(data: bytes) -> NDArray[np.uint8]:
    """Return the picture (H, W, 3) RGB.

    Raises:
        MessageError: It is no JPEG, too big, too small or broken.
    """
    if not data.startswith(b"\xff\xd8"):
        raise MessageError(f"picture starts with {data[:4].hex(' ')}: expected a JPEG")
    width, height = jpeg_size(data)
    check_size(width, height)
    flags = cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags)
    except cv2.error as error:
        raise MessageError(f"JPEG of {len(data)} bytes cannot be decoded: {error.err}") from error
    if image is None or image.shape != (height, width, 3):
        raise MessageError(f"JPEG of {len(data)} bytes cannot be decoded")
    return np.asarray(image, dtype=np.uint8)


def encode_jpeg(image: NDArray[np.uint8], *, quality: int = QUALITY) -> bytes:
    """Return the picture (H, W, 3) RGB as JPEG of a quality in [1, 100]."""
    _, data = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality])
    return data.tobytes()
