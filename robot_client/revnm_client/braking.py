"""Would the robot touch anything before it could stand still?"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from revnm_client.errors import ConfigError
from revnm_client.geometry import FloatArray
from revnm_client.messages import Velocity
from revnm_client.mppi.config import Footprint

_STEP_S = 0.05
_CLOSER_M = 1e-6  # rounding only: a few millimetres a tick would add up to a touch


@dataclass(frozen=True, slots=True)
class BrakingConfig:
    """How the robot stops.

    Attributes:
        delay_s: From the scan's stamp until the base obeys the command that stops it: one control period,
            and the delays of LiDAR and base.
        braking_mps2: Deceleration that the base reaches for certain.
        braking_radps2: The same for turning.
        margin_m: Kept between the true rectangle and every scan point.
        footprint: The rectangle.
    """

    delay_s: float = 0.15
    braking_mps2: float = 1.0
    braking_radps2: float = 2.0
    margin_m: float = 0.03
    footprint: Footprint = field(default_factory=Footprint)

    def __post_init__(self) -> None:
        if not (self.braking_mps2 > 0.0 and self.braking_radps2 > 0.0 and min(self.delay_s, self.margin_m) >= 0.0):
            raise ConfigError(
                f"braking at {self.braking_mps2} m/s² and {self.braking_radps2} rad/s² after {self.delay_s} s with "
                f"{self.margin_m} m to spare: expected decelerations over 0, delay and margin of 0 or more"
            )


def stopping_poses(command: Velocity, now: Velocity, config: BrakingConfig) -> FloatArray:
    """Return the poses (S, 3), x, y, yaw, that the robot passes if it obeys and then brakes to a standstill.

    During the delay the velocity goes from the present one to the command, then to zero, both within the
    limits: from a steady speed that is v · delay + v² / (2 a). The first pose is the present one.
    """
    poses = [(0.0, 0.0, 0.0)]
    v, w = now.v_mps, now.w_radps
    delay_steps = math.ceil(config.delay_s / _STEP_S - 1e-9)
    while len(poses) <= delay_steps or abs(v) > 1e-9 or abs(w) > 1e-9:
        obeys = len(poses) <= delay_steps
        next_v = _toward(v, command.v_mps if obeys else 0.0, config.braking_mps2 * _STEP_S)
        next_w = _toward(w, command.w_radps if obeys else 0.0, config.braking_radps2 * _STEP_S)
        x, y, yaw = poses[-1]
        turn = 0.5 * (w + next_w) * _STEP_S
        step = 0.5 * (v + next_v) * _STEP_S
        middle = yaw + 0.5 * turn
        poses.append((x + step * math.cos(middle), y + step * math.sin(middle), yaw + turn))
        v, w = next_v, next_w
    return np.array(poses)


def is_collision_course(command: Velocity, now: Velocity, points_m: FloatArray, config: BrakingConfig) -> bool:
    """Tell whether obeying the command brings the rectangle too near to a point before it can stop.

    A point that is too near already forbids only going nearer to it, so that the robot can leave.

    Args:
        command: Velocity to be sent.
        now: Velocity of the robot.
        points_m: (M, 2) obstacle points, robot frame now.
        config: How the robot stops.
    """
    return comes_too_near(stopping_poses(command, now, config), points_m, config)


def comes_too_near(poses: FloatArray, points_m: FloatArray, config: BrakingConfig) -> bool:
    """Tell whether the rectangle, at one of the poses, is nearer to a point than the margin and than at the first pose.

    Args:
        poses: (S, 3), x, y, yaw, robot frame now; the first one is the present.
        points_m: (M, 2) obstacle points, robot frame now.
        config: The margin and the rectangle.
    """
    reach = float(np.hypot(poses[:, 0], poses[:, 1]).max())
    reach += config.footprint.circumscribed_m + config.margin_m
    near = points_m[np.hypot(points_m[:, 0], points_m[:, 1]) <= reach]
    if not len(near):
        return False
    distance = rectangle_distance(near, poses, config.footprint)  # (S, M)
    closest = distance.min(axis=0)
    return bool(((closest < config.margin_m) & (closest < distance[0] - _CLOSER_M)).any())


def rectangle_distance(points_m: FloatArray, poses: FloatArray, footprint: Footprint) -> FloatArray:
    """Return the signed distances (S, M) from the robot's rectangle at poses (S, 3) to points (M, 2).

    Negative inside the rectangle: minus the distance to its nearest side.
    """
    dx = points_m[None, :, 0] - poses[:, 0, None]
    dy = points_m[None, :, 1] - poses[:, 1, None]
    cos, sin = np.cos(poses[:, 2, None]), np.sin(poses[:, 2, None])
    over_x = np.abs(cos * dx + sin * dy - footprint.center_x_m) - footprint.length_m / 2.0
    over_y = np.abs(cos * dy - sin * dx) - footprint.width_m / 2.0
    outside = np.hypot(np.maximum(over_x, 0.0), np.maximum(over_y, 0.0))
    return np.asarray(outside + np.minimum(np.maximum(over_x, over_y), 0.0))


def _toward(value: float, target: float, step: float) -> float:
    return min(max(target, value - step), value + step)
