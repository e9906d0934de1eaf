"""Scans and odometry, for whoever only looks and for drivers: nothing here can move a robot."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Protocol

import zenoh

from revnm_client import cdr, keys
from revnm_client.link import Inbox, LatestSubscriber
from revnm_client.messages import Odometry, Scan


class Senses(Protocol):
    """What is asked of a robot by those who only look; every :class:`revnm_client.drivers.RobotDriver` has it."""

    @property
    def rejected(self) -> int:
        """How many measurements were dropped because they were malformed."""
        ...

    @property
    def last_error(self) -> str:
        """Why the last one was; empty when none was."""
        ...

    def take_scan(self) -> Scan | None:
        """Return the newest sound scan that was not taken yet, robot frame, or None."""
        ...

    def take_odometry(self) -> Odometry | None:
        """Return the newest sound odometry that was not taken yet, or None."""
        ...

    def trouble(self) -> str | None:
        """Return why the base would not obey now, or None."""
        ...

    def close(self) -> None:
        """Release what was opened."""
        ...


class KeySenses:
    """Scan and odometry as they lie on the network: a bridge's, or those that the robot's client sends on."""

    def __init__(self, session: zenoh.Session, *, scan: str, odometry: str) -> None:
        """Subscribe to two keys."""
        with ExitStack() as stack:
            scans = stack.enter_context(LatestSubscriber(session, scan))
            odometries = stack.enter_context(LatestSubscriber(session, odometry))
            self._scans: Inbox[Scan] = Inbox(scans, cdr.decode_scan)
            self._odometry: Inbox[Odometry] = Inbox(odometries, cdr.decode_odometry)
            self._stack = stack.pop_all()

    @staticmethod
    def of(session: zenoh.Session, robot: str) -> KeySenses:
        """Hear what lies under the keys of :mod:`revnm_client.keys`."""
        return KeySenses(session, scan=keys.scan(robot), odometry=keys.odom(robot))

    @property
    def rejected(self) -> int:
        """Number of malformed scans and odometries."""
        return self._scans.rejected + self._odometry.rejected

    @property
    def last_error(self) -> str:
        """Why one of them was dropped last; empty when none was."""
        return self._scans.last_error or self._odometry.last_error

    def take_scan(self) -> Scan | None:
        """Return the newest sound scan that was not taken yet, or None."""
        return self._scans.take()

    def take_odometry(self) -> Odometry | None:
        """Return the newest sound odometry that was not taken yet, or None."""
        return self._odometry.take()

    def trouble(self) -> str | None:
        """Return None: the network does not tell how the base is."""
        return None

    def close(self) -> None:
        """Unsubscribe."""
        self._stack.close()
