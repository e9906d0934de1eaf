"""How fast may the robot go for what its LiDAR can see? Never so fast that it could not stop within that.

What a beam hits limits nothing here: the controller avoids it, and the supervisor judges it. What limits is a LiDAR of
short range, or one that is blind ahead.
"""

from __future__ import annotations

import math

import numpy as np

from revnm_client.braking import BrakingConfig
from revnm_client.messages import Scan
from revnm_client.mppi.config import Footprint
from revnm_client.obstacle_memory import beams_at

_BEARING_STEP_RAD = 0.01
_DROPPED_RAD = 0.1  # fewer beams without a measurement than this are dropped ones: 4 cm at the robot's front


def speed_limit_mps(scan: Scan, top_mps: float, braking: BrakingConfig) -> float:
    """Return the greatest speed, up to ``top_mps``, from which the robot stops within what the scan has seen."""
    stop_m = top_mps * braking.delay_s + top_mps**2 / (2.0 * braking.braking_mps2)
    return min(top_mps, speed_to_stop_within_mps(seen_ahead_m(scan, braking.footprint, stop_m), braking))


def seen_ahead_m(scan: Scan, footprint: Footprint, stop_m: float) -> float:
    """Return how far ahead of the robot's front the scan sees the lane that it drives in.

    Args:
        scan: The newest.
        footprint: Of the robot.
        stop_m: Where the lane is looked at: so far ahead of the front the robot could stop from its top speed.

    Returns:
        The LiDAR's range, also where a beam has no return or hits something; 0 where a sector across the lane has no
        measurement at all: beams that the driver masks (0, or no number), or outside of the field of view.
    """
    far_m = footprint.front_x_m + stop_m
    half_rad = math.atan2(footprint.width_m / 2.0, far_m)
    bearings = np.linspace(-half_rad, half_rad, 2 * math.ceil(half_rad / _BEARING_STEP_RAD) + 1)
    lane = far_m * np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
    beam, inside = beams_at(scan.robot_from_lidar.inverse().apply(lane), scan)
    blind = ~(inside & scan.sees[beam])
    edges = np.flatnonzero(np.diff(blind, prepend=False, append=False))  # begin and end of each blind sector
    if np.diff(edges)[::2].max(initial=0) * _BEARING_STEP_RAD > _DROPPED_RAD:
        return 0.0
    return max(scan.robot_from_lidar.x_m + scan.range_max_m - footprint.front_x_m, 0.0)


def speed_to_stop_within_mps(distance_m: float, braking: BrakingConfig) -> float:
    """Return the greatest v with v · delay + v² / (2 a) + margin ≤ distance; 0 where there is none."""
    free_m = max(distance_m - braking.margin_m, 0.0)
    a, delay_s = braking.braking_mps2, braking.delay_s
    return a * (math.sqrt(delay_s**2 + 2.0 * free_m / a) - delay_s)
