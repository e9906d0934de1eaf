"""Writes the time of capture into a picture, so that whoever sees it decoded can tell how old it is.

A row of dark and bright blocks at the top, one a bit: milliseconds, modulo 2³², and a check.
Blocks survive compression.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_BITS = 32
_CHECK = 8
_BLOCKS = _BITS + _CHECK
_DARK, _BRIGHT = 32, 220
_MODULUS = 1 << _BITS


def burn_time(luma: NDArray[np.uint8], time_ms: int) -> None:
    """Write a time into the top of a picture.

    Args:
        luma: (H, W) brightness, W at least 320; changed.
        time_ms: The time.
    """
    value = time_ms % _MODULUS
    word = value << _CHECK | _check(value)
    side = luma.shape[1] // _BLOCKS
    bits = np.array([word >> place & 1 for place in range(_BLOCKS)], dtype=bool)
    row = np.repeat(np.where(bits, _BRIGHT, _DARK).astype(np.uint8), side)
    luma[:side, : len(row)] = row


def read_age_ms(luma: NDArray[np.uint8], now_ms: int) -> int | None:
    """Return how long ago the time was that stands in a picture (H, W); None where none can be read."""
    side = luma.shape[1] // _BLOCKS
    centres = (np.arange(_BLOCKS) * side + side // 2).tolist()
    blocks = [luma[side // 4 : side - side // 4, x - side // 4 : x + side // 4 + 1].mean() for x in centres]
    word = sum(int(block > (_DARK + _BRIGHT) / 2) << place for place, block in enumerate(blocks))
    value = word >> _CHECK
    if _check(value) != word & (1 << _CHECK) - 1:
        return None
    return (now_ms - value) % _MODULUS


def _check(value: int) -> int:
    return sum(value.to_bytes(4)) * 29 + 7 & 0xFF
