"""ROS 2 robots behind zenoh-bridge-ros2dds, and whatever else uses its keys."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack

import zenoh

from revnm_client import cdr, keys
from revnm_client.drivers.opening import DriverContext
from revnm_client.errors import ConfigError, LinkError
from revnm_client.link import Inbox, LatestSubscriber, control_publisher, open_client
from revnm_client.messages import STANDSTILL, Odometry, Scan, Velocity


class ZenohDriver:
    """Scan, odometry and velocity under the keys of :mod:`revnm_client.keys`.

    Attributes:
        shared: The server hears what the bridge publishes.
    """

    def __init__(self, context: DriverContext, *, cmd_vel: str = "twist", connect: Sequence[str] | str = ()) -> None:
        """Subscribe.

        Args:
            context: Robot and session.
            cmd_vel: ``twist`` or ``twist_stamped``: what the base listens to.
            connect: Endpoints of a router on the robot, so that neither scan nor velocity crosses the network; empty
                is the session to the server.

        Raises:
            ConfigError: ``cmd_vel`` or an endpoint is wrong.
        """
        self.shared = True
        self._encode = _encoder(cmd_vel)
        with ExitStack() as stack:
            session = context.session
            endpoints = (connect,) if isinstance(connect, str) else tuple(connect)
            if endpoints:
                session = stack.enter_context(open_client(endpoints))
            scan = stack.enter_context(LatestSubscriber(session, keys.scan(context.robot)))
            odometry = stack.enter_context(LatestSubscriber(session, keys.odom(context.robot)))
            self._scans: Inbox[Scan] = Inbox(scan, cdr.decode_scan)
            self._odometry: Inbox[Odometry] = Inbox(odometry, cdr.decode_odometry)
            self._velocity = stack.enter_context(control_publisher(session, keys.cmd_vel(context.robot)))
            self._stack = stack.pop_all()

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

    def drive(self, velocity: Velocity) -> None:
        """Publish a velocity.

        Raises:
            LinkError: The session is closed.
        """
        try:
            self._velocity.put(self._encode(velocity))
        except zenoh.ZError as error:
            raise LinkError(f"cannot send a velocity: {error}") from error

    def trouble(self) -> str | None:
        """Return None: a bridge does not tell how its base is."""
        return None

    def close(self) -> None:
        """Command standstill and unsubscribe."""
        with self._stack:
            self.drive(STANDSTILL)


def _encoder(cmd_vel: str) -> Callable[[Velocity], bytes]:
    if cmd_vel == "twist":
        return cdr.encode_velocity
    if cmd_vel == "twist_stamped":
        return lambda velocity: cdr.encode_stamped_velocity(velocity, time.time_ns())
    raise ConfigError(f"driver zenoh: cmd_vel is {cmd_vel!r}: expected twist or twist_stamped")
