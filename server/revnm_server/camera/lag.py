"""Notices pictures that come late: what piles up on its way is old when it is decoded, whatever the clock says then.

The camera's clock and ours have nothing in common, not even their speed: many cameras count so many pictures a second
whatever they send, and some are off by a fifth. So both are compared over some seconds first.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

_BINS = 20
_APART = 5  # bins: over less time a slope is mostly jitter
_STEEPEST = 0.3
_BEGIN_S = 3.0
_PILED = 0.5  # of the time between them


class StreamLag:
    """Compares when pictures come with when the camera says that it took them.

    The least delays of the last twenty seconds lie on a line, whose slope is the difference of the clocks' speeds; what
    is above it is late. A delay that grows as slowly and as steadily as a clock would cannot be told from one.

    Args:
        bin_s: Length of what is called a second here.
    """

    def __init__(self, *, bin_s: float = 1.0) -> None:
        self._bin_s = bin_s
        self._least: deque[tuple[float, float]] = deque(maxlen=_BINS)  # when, and the least of that second
        self._slope, self._intercept_s = 0.0, 0.0
        self._begun_s = math.nan
        self._before: tuple[float, float] | None = None

    def piled_up(self, media_s: float, now_s: float) -> bool:
        """Return whether a picture was taken before the connection: many cameras begin with those since a key frame.

        They come faster than they were taken. So nothing is known of the first, and it counts as one of them. After
        the first seconds none does.

        Args:
            media_s: When it was taken, the stream's clock.
            now_s: When it came, monotonic clock.
        """
        before, self._before = self._before, (media_s, now_s)
        if before is None:
            self._begun_s = now_s
            return True
        return now_s - self._begun_s < _BEGIN_S and now_s - before[1] < _PILED * (media_s - before[0])

    def note(self, media_s: float, now_s: float) -> float:
        """Return by how many seconds a picture is late; 0 during the first seconds of a connection.

        Args:
            media_s: When it was taken, the stream's clock.
            now_s: When it came, monotonic clock.
        """
        offset_s = now_s - media_s
        if not self._least or now_s - self._least[-1][0] >= self._bin_s:
            if len(self._least) > _APART:
                self._fit()
            self._least.append((now_s, offset_s))
        elif offset_s < self._least[-1][1]:
            self._least[-1] = self._least[-1][0], offset_s
        if len(self._least) <= _APART + 1:
            return 0.0
        late_s = offset_s - self._slope * now_s - self._intercept_s  # of the camera's seconds
        return max(0.0, late_s / (1.0 - self._slope))

    def _fit(self) -> None:
        """Lay the line below the least delays: its slope is the median of those between seconds that are apart."""
        at_s, offset_s = np.array(self._least).T
        later, earlier = np.tril_indices(len(at_s), -_APART)
        slopes = (offset_s[later] - offset_s[earlier]) / (at_s[later] - at_s[earlier])
        self._slope = float(np.clip(np.median(slopes), -_STEEPEST, _STEEPEST))
        self._intercept_s = float((offset_s - self._slope * at_s).min())
