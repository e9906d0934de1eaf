"""Checks at the border: every decoded number, name and array passes through here, and through here only.

Must not import anything of the wire formats.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revnm_client.errors import MessageError

MAX_NAME_LENGTH = 64
_NS_PER_S = 1_000_000_000


def number(value: float, *, what: str, low: float, high: float) -> float:
    """Return ``value`` if it is finite and in [low, high].

    Raises:
        MessageError: It is not; the text names ``what`` and the range.
    """
    if not low <= value <= high:  # False for NaN too
        raise MessageError(f"{what} is {value}: expected {low} to {high}")
    return float(value)


def name(value: str, *, what: str, max_length: int = MAX_NAME_LENGTH) -> str:
    """Return ``value`` if it is printable and at most ``max_length`` characters long; it may be empty.

    Raises:
        MessageError: It is not.
    """
    if len(value) > max_length or not value.isprintable():
        raise MessageError(f"{what} is {value[:80]!r}: expected at most {max_length} printable characters")
    return value


def stamp_ns(sec: int, nanosec: int) -> int:
    """Return the nanoseconds of a builtin_interfaces/Time.

    Raises:
        MessageError: The seconds are negative or the nanoseconds are a second or more.
    """
    if sec < 0 or not 0 <= nanosec < _NS_PER_S:
        raise MessageError(f"stamp is {sec} s + {nanosec} ns: expected 0 s or more and less than 1e9 ns")
    return sec * _NS_PER_S + nanosec


def ranges(values: NDArray[Any], *, low: int, high: int) -> NDArray[np.float32]:
    """Return LiDAR ranges (N,) as float32 metres in native byte order, in memory of their own.

    Raises:
        MessageError: N is outside [low, high], or a range is NaN or negative (inf means no return).
    """
    if not low <= len(values) <= high:
        raise MessageError(f"scan has {len(values)} beams: expected {low} to {high}")
    with np.errstate(over="ignore"):  # what is too far for 32 bits is inf
        metres = np.array(values, dtype=np.float32)
    good = metres >= 0.0  # False for NaN too
    if not good.all():
        index = int(np.flatnonzero(~good)[0])
        raise MessageError(f"range of beam {index} is {metres[index]}: expected 0 or more, or inf")
    return metres


def yaw_rad(x: float, y: float, z: float, w: float) -> float:
    """Return the yaw of a unit quaternion, radians, in (−π, π].

    Raises:
        MessageError: Its length is not 1 to 5 %; the all-zero one, too, is no rotation.
    """
    length = math.sqrt(min(x * x + y * y + z * z + w * w, 1e12))
    number(length, what="length of the orientation quaternion", low=0.95, high=1.05)
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
