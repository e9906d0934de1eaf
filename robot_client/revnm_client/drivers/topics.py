"""Robots whose scan, odometry and velocity are Zenoh keys with ROS 2 messages: what their drivers share."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import NamedTuple

import zenoh

from revnm_client import cdr
from revnm_client.drivers.opening import DriverContext
from revnm_client.errors import ConfigError, LinkError
from revnm_client.link import control_publisher, open_client
from revnm_client.messages import STANDSTILL, Velocity
from revnm_client.senses import KeySenses


class TopicKeys(NamedTuple):
    """Under which keys a robot speaks and listens."""

    scan: str
    odometry: str
    velocity: str


class TopicDriver(KeySenses):
    """Takes scans and odometry from two keys, and puts velocities to a third.

    Attributes:
        shared: Whether the server hears scan and odometry as they are.
    """

    def __init__(self, context: DriverContext, connect: Sequence[str] | str, keys: TopicKeys, *, shared: bool) -> None:
        """Subscribe.

        Args:
            context: Robot and session.
            connect: Endpoints of a router on the robot; empty is the session to the server.
            keys: Of the robot.
            shared: See above.

        Raises:
            ConfigError: An endpoint is malformed.
            LinkError: Told to stop before the router on the robot answered.
        """
        self.shared = shared
        with ExitStack() as stack:
            session = context.session
            if connect:
                endpoints = (connect,) if isinstance(connect, str) else tuple(connect)
                session = open_client(endpoints, credentials=context.credentials, stop=context.stop)
                stack.enter_context(session)
            super().__init__(session, scan=keys.scan, odometry=keys.odometry)
            stack.callback(super().close)
            self._velocity = stack.enter_context(control_publisher(session, keys.velocity))
            self._opened = stack.pop_all()

    def drive(self, velocity: Velocity) -> None:
        """Publish a velocity.

        Raises:
            LinkError: The session is closed.
        """
        try:
            self._put(velocity)
        except zenoh.ZError as error:
            raise LinkError(f"cannot send a velocity: {error}") from error

    def _put(self, velocity: Velocity) -> None:
        raise NotImplementedError

    def close(self) -> None:
        """Command standstill and unsubscribe."""
        with self._opened:
            self.drive(STANDSTILL)


def velocity_encoder(cmd_vel: str) -> Callable[[Velocity], bytes]:
    """Return what turns a velocity into a message.

    Args:
        cmd_vel: ``twist`` or ``twist_stamped``: what the base listens to.

    Raises:
        ConfigError: It is neither.
    """
    if cmd_vel == "twist":
        return cdr.encode_velocity
    if cmd_vel == "twist_stamped":
        return lambda velocity: cdr.encode_stamped_velocity(velocity, time.time_ns())
    raise ConfigError(f"driver: cmd_vel is {cmd_vel!r}: expected twist or twist_stamped")
