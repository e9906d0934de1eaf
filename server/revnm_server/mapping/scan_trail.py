"""A robot's last scans with their odometry, so that they can be placed again when the map's frame changes.

Imports numpy only.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from revnm_client.messages import Scan
from revnm_server.calibration.keyframes import Travel

_APART_M, _APART_RAD = 0.15, 0.35
_MOST = 20
_ALIKE_M, _ALIKE_RAD = 0.4, 1.0

_Cell = tuple[int, int, int, int]
_MOST_OLDER = 100


class PastScan(NamedTuple):
    """A scan and where odometry had the robot.

    Attributes:
        scan: As it came.
        travel: Odometry at its stamp.
        drive: The drive that the odometry belongs to.
        times: For how many scans from there it stands.
    """

    scan: Scan
    travel: Travel
    drive: int
    times: int = 1


class ScanTrail:
    """The last scans, a little way or turn apart, and of the older ones the newest of each place and heading."""

    def __init__(self) -> None:
        self._last: deque[PastScan] = deque()
        self._older: dict[_Cell, PastScan] = {}

    def push(self, past: PastScan) -> None:
        """Keep a scan if the robot has moved since the last one that was kept."""
        if self._last and self._last[-1].drive == past.drive:
            last, now = self._last[-1].travel, past.travel
            if now.way_m - last.way_m < _APART_M and now.turn_rad - last.turn_rad < _APART_RAD:
                self._last[-1] = self._last[-1]._replace(times=self._last[-1].times + 1)
                return
        self._last.append(past)
        if len(self._last) > _MOST:
            self._retire(self._last.popleft())

    def all(self) -> list[PastScan]:
        """Return the scans, oldest first."""
        return [*self._older.values(), *self._last]

    def _retire(self, past: PastScan) -> None:
        """Keep an older scan, also for those that saw about the same."""
        cell = _cell(past)
        same = self._older.pop(cell, None)  # so that the new one goes to the end
        self._older[cell] = past._replace(times=past.times + (same.times if same is not None else 0))
        if len(self._older) > _MOST_OLDER:
            del self._older[next(iter(self._older))]


def _cell(past: PastScan) -> _Cell:
    """Return a drive, a place and a heading, as a LiDAR need not see all around."""
    x, y, yaw = past.travel.odom_from_robot
    return past.drive, round(x / _ALIKE_M), round(y / _ALIKE_M), round(yaw / _ALIKE_RAD)
