"""Notices a robot that the picture shows standing while its odometry has it drive: nobody may steer by such a picture.

It is frozen, though encoders that keep to a bit rate may change it a little all the time; or the robot's wheels slip.
"""

from __future__ import annotations

import math

import numpy as np

from revnm_client.geometry import FloatArray, Pose2
from revnm_server.frame import RobotSighting

_STILL_PX = 1.5  # corners of a tag that stands are found again more exactly
# Far more than odometry runs ahead of a picture that is late.
_DRIVEN_M = 0.4
_TURNED_RAD = 0.8


class StandingTag:
    """Watches one robot's tag."""

    def __init__(self) -> None:
        self._since: tuple[FloatArray, Pose2, int] | None = None

    def note(self, sighting: RobotSighting, odom_from_robot: Pose2, drive: int) -> bool:
        """Take a sighting; return whether the tag stands in the picture though the robot drove. It begins anew then.

        Args:
            sighting: Of this robot.
            odom_from_robot: Where its odometry had it then.
            drive: Number of the drive, whose odometry goes together.
        """
        since, self._since = self._since, (sighting.corners, odom_from_robot, drive)
        if since is None or since[2] != drive or np.abs(sighting.corners - since[0]).max() > _STILL_PX:
            return False
        driven = since[1].inverse() @ odom_from_robot
        if math.hypot(driven.x_m, driven.y_m) > _DRIVEN_M or abs(driven.yaw_rad) > _TURNED_RAD:
            return True
        self._since = since
        return False
