"""A robot's last scans with their odometry, so that they can be placed again when the map's frame changes.

Imports numpy only.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from revnm_client.messages import Scan
from revnm_server.calibration.keyframes import Travel

_APART_M, _APART_RAD = 0.15, 0.35
_MOST = 60


class PastScan(NamedTuple):
    """A scan and where odometry had the robot.

    Attributes:
        scan: As it came.
        travel: Odometry at its stamp.
        drive: The drive that the odometry belongs to.
    """

    scan: Scan
    travel: Travel
    drive: int


class ScanTrail:
    """Scans a little way or turn apart, the oldest forgotten."""

    def __init__(self) -> None:
        self._scans: deque[PastScan] = deque(maxlen=_MOST)

    def push(self, past: PastScan) -> None:
        """Keep a scan if the robot has moved since the last one that was kept."""
        if self._scans and self._scans[-1].drive == past.drive:
            last, now = self._scans[-1].travel, past.travel
            if now.way_m - last.way_m < _APART_M and now.turn_rad - last.turn_rad < _APART_RAD:
                return
        self._scans.append(past)

    def all(self) -> list[PastScan]:
        """Return the scans, oldest first."""
        return list(self._scans)
