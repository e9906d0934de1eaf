"""Stamps of a robot's clock in the clock of this machine."""

from __future__ import annotations

import threading
from collections import deque

_WINDOW_NS = 10_000_000_000


class StampClock:
    """Takes the least time from stamp to receipt in ten seconds for the difference of the clocks. Thread-safe.

    That leaves out how long the quickest message took, a few milliseconds in a local network: by so much a stamp is
    late at most, and never later than its receipt. Where one of the clocks is set, stamps look up to ten seconds old
    until the window has passed; the robot stands meanwhile.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._least: deque[tuple[int, int]] = deque()  # receipt and delay: both grow, so the first is the least

    def here_ns(self, stamp_ns: int, received_ns: int) -> int:
        """Return the stamp in this machine's clock.

        Args:
            stamp_ns: Robot's clock.
            received_ns: This machine's clock.
        """
        delay_ns = received_ns - stamp_ns
        with self._lock:
            while self._least and self._least[-1][1] >= delay_ns:
                self._least.pop()
            self._least.append((received_ns, delay_ns))
            while self._least[0][0] < received_ns - _WINDOW_NS:
                self._least.popleft()
            return stamp_ns + self._least[0][1]
