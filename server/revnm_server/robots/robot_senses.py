"""What a robot measures itself, heard by the server: odometry and, where it sends them, scans, in the server's clock.

A robot stamps in its own clock. Its state says by how much the server's is ahead (``clock_offset_ms``), and that is
added. While a robot's state says that it does not know, nothing of it is believed. Robots that tell nothing at all, as
one that has only the ROS 2 bridge, are assumed to keep the server's time (NTP). A stamp more than a second off from
when the message came is refused and counted.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import zenoh

from revnm_client import keys
from revnm_client.cdr import decode_odometry, decode_scan
from revnm_client.control_messages import decode_state
from revnm_client.geometry import IDENTITY, Pose2
from revnm_client.json_payload import Scalar
from revnm_client.link import Inbox, LatestSubscriber
from revnm_client.messages import Odometry, Scan
from revnm_server.ports import Heard

_WAITING = 200  # odometry: 2 s at 100 Hz, should a tick take so long
_MOST_OFF_NS = 1_000_000_000
_STEADY_NS = 20_000_000  # an offset that was estimated anew and differs by less is kept: stamps must not jump
_LARGEST_OFFSET_MS = 1e12
_NS_PER_MS = 1e6
_FARTHEST_MOUNTING = math.tau  # metres, radians

Stamped = TypeVar("Stamped", Odometry, Scan)


class RobotClock:
    """Turns stamps of one robot into the server's clock.

    Attributes:
        offset_ns: Server's clock minus the robot's; None while the robot itself does not know it.
    """

    def __init__(self) -> None:
        self.offset_ns: int | None = 0

    def hear(self, state: dict[str, Scalar]) -> None:
        """Take what the robot says of itself; what says nothing of clocks changes nothing."""
        if "clock_offset_ms" not in state:
            return
        told = state["clock_offset_ms"]
        if isinstance(told, bool | str) or told is None or not abs(told) <= _LARGEST_OFFSET_MS:
            self.offset_ns = None
            return
        offset_ns = round(told * _NS_PER_MS)
        if self.offset_ns is None or abs(offset_ns - self.offset_ns) > _STEADY_NS:
            self.offset_ns = offset_ns


class Mounting:
    """Where a robot's LiDAR sits.

    Attributes:
        robot_from_lidar: As its state tells it (``lidar_x_m``, ``lidar_y_m``, ``lidar_yaw_rad``), else in its middle,
            looking forward.
    """

    def __init__(self) -> None:
        self.robot_from_lidar = IDENTITY

    def hear(self, state: dict[str, Scalar]) -> None:
        """Take what the robot says of itself; what is no mounting changes nothing."""
        told = [state.get(name) for name in ("lidar_x_m", "lidar_y_m", "lidar_yaw_rad")]
        numbers = [float(each) for each in told if isinstance(each, int | float) and abs(each) <= _FARTHEST_MOUNTING]
        if len(numbers) == len(told):
            self.robot_from_lidar = Pose2(*numbers)


class RobotSenses:
    """Hears one robot's odometry and scans; only when :meth:`listen` is called, by one thread."""

    def __init__(self, session: zenoh.Session, robot: str, *, now_ns: Callable[[], int] = time.time_ns) -> None:
        """Begin to hear.

        Args:
            session: The router's.
            robot: Its name.
            now_ns: The server's clock.
        """
        self._now_ns = now_ns
        self._clock, self._mounting = RobotClock(), Mounting()
        self._state = LatestSubscriber(session, keys.state(robot))
        self._odometry = LatestSubscriber(session, keys.odom(robot), waiting=_WAITING)
        self._scans = LatestSubscriber(session, keys.scan(robot))
        self._states = Inbox(self._state, decode_state)
        self._odometries = Inbox(self._odometry, decode_odometry)
        self._scan_inbox = Inbox(self._scans, decode_scan)
        self._misdated = {self._odometry.key: 0, self._scans.key: 0}
        self._listened_ns = now_ns()

    @property
    def rejected(self) -> dict[str, int]:
        """Number of malformed or wrongly stamped payloads by key."""
        return {
            self._odometry.key: self._odometries.rejected + self._misdated[self._odometry.key],
            self._scans.key: self._scan_inbox.rejected + self._misdated[self._scans.key],
        }

    def listen(self) -> Heard:
        """Return what came since the last time."""
        state = self._states.take()
        if state is not None:
            self._clock.hear(state)
            self._mounting.hear(state)
        since_ns = self._listened_ns
        odometry, scans = self._odometries.take_all(), self._scan_inbox.take_all()
        self._listened_ns = self._now_ns()
        mounting = self._mounting.robot_from_lidar
        scans = [replace(scan, robot_from_lidar=mounting) for scan in scans]
        return Heard(
            tuple(self._dated(odometry, self._odometry.key, since_ns)),
            tuple(self._dated(scans, self._scans.key, since_ns)),
            self._clock.offset_ns or 0,
            mounting,
        )

    def close(self) -> None:
        """Leave the keys."""
        for subscriber in (self._state, self._odometry, self._scans):
            subscriber.close()

    def _dated(self, messages: list[Stamped], key: str, since_ns: int) -> list[Stamped]:
        """Return the messages, which came in after ``since_ns``, with stamps in the server's clock."""
        offset_ns = self._clock.offset_ns
        low_ns, high_ns = since_ns - _MOST_OFF_NS, self._listened_ns + _MOST_OFF_NS
        kept = []
        for message in messages:
            stamp_ns = -math.inf if offset_ns is None else message.stamp_ns + offset_ns
            if low_ns <= stamp_ns <= high_ns:
                kept.append(replace(message, stamp_ns=int(stamp_ns)))
            else:
                self._misdated[key] += 1
        return kept
