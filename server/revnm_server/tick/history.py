"""Keeps the last images of a stream and gives them back at even intervals of time.

Why: the networks see N frames of history at the interval they were trained with, whatever the camera's rate.
Imports numpy only.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from revnm_server.observation import Image32

_NS_PER_S = 1_000_000_000
_LONGEST_GAP_S = 1.0


class ImageHistory:
    """The newest images (h, w) of one stream.

    A break in time starts a new history: a stamp that goes back (a film that loops, a new trial) or a gap of
    more than a second and more than two intervals.
    """

    def __init__(self, *, count: int, interval_s: float) -> None:
        """Keep what ``count`` images at ``interval_s`` need."""
        self._count = count
        self._interval_ns = round(interval_s * _NS_PER_S)
        self._gap_ns = max(round(_LONGEST_GAP_S * _NS_PER_S), 2 * self._interval_ns)
        self._entries: deque[tuple[int, Image32]] = deque()

    def push(self, image: Image32, stamp_ns: int) -> None:
        """Add the newest image; one with the stamp of the last replaces it."""
        if self._entries and not 0 <= stamp_ns - self._entries[-1][0] <= self._gap_ns:
            self._entries.clear()
        if self._entries and self._entries[-1][0] == stamp_ns:
            self._entries.pop()
        self._entries.append((stamp_ns, image))
        needed_ns = stamp_ns - (self._count - 1) * self._interval_ns
        while len(self._entries) > 1 and self._entries[1][0] <= needed_ns:
            self._entries.popleft()

    def stack(self) -> Image32:
        """Return (N, h, w), oldest first, the newest image last.

        Each is the newest one that is at least its number of intervals older than the last; where the stream
        is too young, its oldest image is repeated. At least one image must have been pushed.
        """
        newest_ns = self._entries[-1][0]
        wanted = [newest_ns - back * self._interval_ns for back in range(self._count - 1, -1, -1)]
        return np.stack([self._at(stamp_ns) for stamp_ns in wanted])  # (N, h, w)

    def _at(self, stamp_ns: int) -> Image32:
        older = [image for stamp, image in self._entries if stamp <= stamp_ns]
        return older[-1] if older else self._entries[0][1]
