"""The port: all that the control loop asks of a robot."""

from __future__ import annotations

from typing import Protocol

from revnm_client.messages import Odometry, Scan, Velocity


class RobotDriver(Protocol):
    """LiDAR, odometry and wheels of one robot.

    The control loop calls it from one thread, 20 times a second, and everything else waits meanwhile: no method may
    block for longer than a millisecond or two. A driver that has to wait for its robot does so in a thread of its
    own and keeps the newest measurement. Stamps are in the clock of this machine, as :func:`time.time_ns` gives it.

    Attributes:
        shared: Whether the server hears scans and odometry without this client, as from a Zenoh bridge. Where it does
            not, the client sends them on.
        rejected: How many measurements were dropped because they were malformed.
        last_error: Why the last one was; empty when none was.
    """

    shared: bool

    @property
    def rejected(self) -> int:
        """See above."""
        ...

    @property
    def last_error(self) -> str:
        """See above."""
        ...

    def take_scan(self) -> Scan | None:
        """Return the newest sound scan that was not taken yet, robot frame, or None."""
        ...

    def take_odometry(self) -> Odometry | None:
        """Return the newest sound odometry that was not taken yet, or None."""
        ...

    def drive(self, velocity: Velocity) -> None:
        """Command a velocity; it is sent again at every tick.

        Raises:
            LinkError: It could not be sent. The base must stop by itself after some 0.25 s without one.
        """
        ...

    def trouble(self) -> str | None:
        """Return why the base would not obey now, for a person, such as a pressed bumper; None where all is well."""
        ...

    def close(self) -> None:
        """Give the robot back: command standstill as the last thing, and release what was opened."""
        ...
