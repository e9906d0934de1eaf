"""Notices a picture that stands still while a robot in it drives: the camera is frozen, whatever it sends.

A picture that does not change is no proof. Encoders leave out what did not change, and at night nothing does. While a
robot that the camera saw lately says that it drives, the picture must change, or nobody may drive by it. Nor may they
where it changes, but shows a robot standing that drives: that is for others to notice.

Nor is it for ever: robots stand while they get no plans, and then an honest picture of a still place does not change
either. So after the robots have stood for a while they may try again; each try in vain doubles that while.
"""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray

SAME_AFTER_S = 2.0
FROZEN_AFTER_S = 1.0
FIRST_HOLD_S = 5.0
LONGEST_HOLD_S = 60.0
_ROWS = 120
_FARTHEST = 4  # rows: a robot far away is a few rows high


def digest(image: NDArray[np.uint8]) -> int:
    """Return what tells whether a picture (H, W, 3) is the one before: a checksum of every few rows."""
    return zlib.crc32(image[:: min(max(1, len(image) // _ROWS), _FARTHEST)].tobytes())


class ContentWatch:
    """Watches one camera's pictures; all times are seconds of one monotonic clock. Not thread-safe."""

    def __init__(self) -> None:
        self._content: int | None = None
        self._same_since_s = 0.0
        self._moves: tuple[str, float] | None = None  # who, and since when
        self._still_since_s = 0.0
        self._frozen_by: str | None = None
        self._standing = False  # it is shown so, in pictures that may change
        self._hold_s = FIRST_HOLD_S

    def see(self, content: int, now_s: float) -> None:
        """Take the newest picture's :func:`digest`."""
        if content != self._content:
            self._content, self._same_since_s = content, now_s
            if not self._standing:
                self._frozen_by, self._hold_s = None, FIRST_HOLD_S
        elif self._moves is not None and now_s - max(self._same_since_s, self._moves[1]) >= FROZEN_AFTER_S:
            self._frozen_by = self._moves[0]

    def note_motion(self, robot: str | None, now_s: float) -> None:
        """Note which robot drives in the picture; None where none does, or none that says so."""
        if robot is None:
            if self._moves is not None:
                self._moves, self._still_since_s = None, now_s
            elif self._frozen_by is not None and now_s - self._still_since_s >= self._hold_s:
                self._frozen_by, self._standing = None, False
                self._hold_s = min(2.0 * self._hold_s, LONGEST_HOLD_S)
            return
        if self._moves is None:
            self._moves = robot, now_s

    def note_standing(self, robot: str, now_s: float) -> None:
        """Note a robot that the picture shows standing though its odometry has it drive."""
        self._frozen_by, self._standing, self._still_since_s = robot, True, now_s

    def frozen(self, now_s: float) -> str | None:
        """Return why the picture counts as frozen; None where it does not."""
        if self._frozen_by is None:
            return None
        if self._standing:
            return f"{self._frozen_by} drives, but the picture shows it standing: it is frozen, or the wheels slip"
        return f"the picture is frozen: unchanged for {now_s - self._same_since_s:.0f} s, while {self._frozen_by} drove"

    def odd(self, now_s: float) -> str | None:
        """Return what is odd about the picture, though it may be honest."""
        same_s = now_s - self._same_since_s
        if self._content is None or same_s < SAME_AFTER_S:
            return None
        return f"the picture has not changed at all for {same_s:.0f} s"
