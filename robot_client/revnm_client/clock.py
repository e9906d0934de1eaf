"""How far the server's clock is ahead of the robot's, from requests and replies with four time stamps.

Convention: ``server_time = robot_time + offset``. A request leaves at t1 (robot), arrives at t2 (server), its
reply leaves at t3 (server) and arrives at t4 (robot). Neither way takes less than no time, so the true offset
lies in [t3 − t4, t2 − t1]; the estimate is the middle, off by half the round trip at most, however uneven the
two ways are. Source: RFC 5905, section 8.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

_WINDOW = 8
_LEAST_JUMP_NS = 50_000_000
_DRIFT_MARGIN_NS = 2_000_000  # 100 ppm over some 20 s


class _Bounds(NamedTuple):
    """The offset is at least ``low_ns`` and at most ``high_ns``."""

    low_ns: int
    high_ns: int

    @property
    def width_ns(self) -> int:
        return self.high_ns - self.low_ns

    def contradicts(self, other: _Bounds) -> bool:
        gap_ns = max(self.low_ns, other.low_ns) - min(self.high_ns, other.high_ns)
        return gap_ns > _DRIFT_MARGIN_NS


class ClockOffset:
    """Estimates the offset from the exchange with the least round trip among the last eight.

    An exchange that contradicts an older one (their bounds do not overlap) means that somebody set a clock:
    everything older is forgotten at once.
    """

    def __init__(self) -> None:
        self._exchanges: deque[_Bounds] = deque(maxlen=_WINDOW)

    def add(self, t1_ns: int, t2_ns: int, t3_ns: int, t4_ns: int) -> bool:
        """Take one exchange into account.

        Args:
            t1_ns: Request sent, robot's clock.
            t2_ns: Request received, server's clock.
            t3_ns: Reply sent, server's clock.
            t4_ns: Reply received, robot's clock.

        Returns:
            Whether the exchange is possible; one with a negative round trip (a clock was set meanwhile) is
            left out.
        """
        new = _Bounds(t3_ns - t4_ns, t2_ns - t1_ns)
        if new.width_ns < 0:
            return False
        if any(new.contradicts(old) for old in self._exchanges):
            self._exchanges.clear()
        self._exchanges.append(new)
        return True

    def forget(self) -> None:
        """Forget everything: the robot's clock was set."""
        self._exchanges.clear()

    def _best(self) -> _Bounds | None:
        return min(self._exchanges, key=lambda bounds: bounds.width_ns, default=None)

    @property
    def offset_ns(self) -> int | None:
        """Server's clock minus robot's clock, or None while unknown; right to half of ``round_trip_ns``."""
        best = self._best()
        return None if best is None else (best.low_ns + best.high_ns) // 2

    @property
    def round_trip_ns(self) -> int | None:
        """Time on the way, there and back, of the exchange in use; None while there is none."""
        best = self._best()
        return None if best is None else best.width_ns


class ClockJump:
    """Notices that the robot's wall clock was set, by comparing it with the monotonic clock."""

    def __init__(self) -> None:
        self._difference_ns: int | None = None

    def check(self, wall_ns: int, monotonic_ns: int) -> bool:
        """Return whether the two clocks moved apart by 50 ms or more since the last call."""
        before_ns, self._difference_ns = self._difference_ns, wall_ns - monotonic_ns
        return before_ns is not None and abs(self._difference_ns - before_ns) >= _LEAST_JUMP_NS
