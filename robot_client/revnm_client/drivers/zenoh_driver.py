"""ROS 2 robots behind zenoh-bridge-ros2dds, and whatever else uses its keys."""

from __future__ import annotations

from collections.abc import Sequence

from revnm_client import keys
from revnm_client.drivers.opening import DriverContext
from revnm_client.drivers.topics import TopicDriver, TopicKeys, velocity_encoder
from revnm_client.messages import Velocity


class ZenohDriver(TopicDriver):
    """Scan, odometry and velocity under the keys of :mod:`revnm_client.keys`; the server hears them from the bridge."""

    def __init__(self, context: DriverContext, *, cmd_vel: str = "twist", connect: Sequence[str] | str = ()) -> None:
        """Subscribe.

        Args:
            context: Robot and session.
            cmd_vel: ``twist`` or ``twist_stamped``: what the base listens to.
            connect: Endpoints of a router on the robot, so that the control loop needs no network; empty
                is the session to the server.

        Raises:
            ConfigError: ``cmd_vel`` or an endpoint is wrong.
            LinkError: Told to stop before the router on the robot answered.
        """
        self._encode = velocity_encoder(cmd_vel)
        robot = context.robot
        topics = TopicKeys(keys.scan(robot), keys.odom(robot), keys.cmd_vel(robot))
        super().__init__(context, connect, topics, shared=True)

    def _put(self, velocity: Velocity) -> None:
        self._velocity.put(self._encode(velocity))
