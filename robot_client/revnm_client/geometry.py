"""Planar rigid motions: the only geometry that the robot needs.

Frames follow REP 103: x forward, y left, yaw counter-clockwise. Names read as products:
``world_from_robot`` takes robot coordinates to world coordinates.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def wrap_angle(angle_rad: float) -> float:
    """Return the angle in (−π, π]."""
    wrapped = math.remainder(angle_rad, math.tau)
    return math.pi if wrapped == -math.pi else wrapped


class Pose2(NamedTuple):
    """A pose in the plane, or the rigid motion that takes its own frame to the parent frame.

    Attributes:
        x_m: Position along the parent's x axis, metres.
        y_m: Position along the parent's y axis, metres.
        yaw_rad: Heading, radians, counter-clockwise from the parent's x axis.
    """

    x_m: float
    y_m: float
    yaw_rad: float

    def __matmul__(self, other: Pose2) -> Pose2:
        """Compose: ``a_from_b @ b_from_c`` is ``a_from_c``."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return Pose2(
            self.x_m + c * other.x_m - s * other.y_m,
            self.y_m + s * other.x_m + c * other.y_m,
            wrap_angle(self.yaw_rad + other.yaw_rad),
        )

    def inverse(self) -> Pose2:
        """Return the inverse motion: of ``a_from_b`` it is ``b_from_a``."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return Pose2(-c * self.x_m - s * self.y_m, s * self.x_m - c * self.y_m, wrap_angle(-self.yaw_rad))

    def apply(self, points_m: FloatArray) -> FloatArray:
        """Move points (..., 2), metres, from this pose's own frame to the parent frame."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        rotation = np.array([[c, s], [-s, c]])
        return np.asarray(points_m @ rotation + np.array([self.x_m, self.y_m]))


IDENTITY = Pose2(0.0, 0.0, 0.0)


def interpolate(a: Pose2, b: Pose2, fraction: float) -> Pose2:
    """Return the pose at ``fraction`` of the way from ``a`` to ``b``, turning the short way round."""
    turn = wrap_angle(b.yaw_rad - a.yaw_rad)
    return Pose2(
        a.x_m + fraction * (b.x_m - a.x_m),
        a.y_m + fraction * (b.y_m - a.y_m),
        wrap_angle(a.yaw_rad + fraction * turn),
    )
