"""What the robot measures: a noisy 2D LiDAR and drifting wheel odometry.

Imports no PyBullet: the LiDAR uses the exact ray caster, the odometry gets wheel angles. Errors are drawn from
the seed, once for systematic ones and per measurement for noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from revnm_client.geometry import Pose2, wrap_angle
from revnm_client.messages import Odometry, Scan, Velocity
from revnm_sim.rays.raycast import cast_scan
from revnm_sim.world import PrimitiveArrays


@dataclass(frozen=True, slots=True)
class LidarSpec:
    """A 2D LiDAR that turns in the plane (noise as in atinfinity/megarover_samples_ros2).

    Attributes:
        beams: Beams of a full turn, the first one straight back.
        rate_hz: Turns per second.
        range_min_m: Shortest range.
        range_max_m: Longest range.
        sigma_m: Standard deviation of a range.
    """

    beams: int = 720
    rate_hz: float = 10.0
    range_min_m: float = 0.05
    range_max_m: float = 12.0
    sigma_m: float = 0.015


class Lidar:
    """Scans a world of primitives; each turn is taken at one instant."""

    def __init__(self, arrays: PrimitiveArrays, height_m: float, spec: LidarSpec, seed: int) -> None:
        self._arrays = arrays
        self._height_m = height_m
        self._spec = spec
        self._rng = np.random.default_rng([seed, 1])
        self._angles = np.linspace(-math.pi, math.pi, spec.beams, endpoint=False)

    def scan(self, world_from_robot: Pose2, stamp_ns: int) -> Scan:
        """Return a scan taken at a pose; beams without a return are inf."""
        spec = self._spec
        exact = cast_scan(
            self._arrays,
            world_from_robot,
            height_m=self._height_m,
            angles_rad=self._angles,
            max_range_m=spec.range_max_m,
        )
        noisy = exact + self._rng.normal(0.0, spec.sigma_m, spec.beams)
        seen = (exact < spec.range_max_m) & (noisy >= spec.range_min_m) & (noisy < spec.range_max_m)
        ranges = np.where(seen, noisy, np.inf).astype(np.float32)
        increment = math.tau / spec.beams
        return Scan(stamp_ns, -math.pi, increment, spec.range_min_m, spec.range_max_m, ranges)


@dataclass(frozen=True, slots=True)
class OdometrySpec:
    """Standard deviations of the systematic errors, each drawn once per run.

    Attributes:
        scale_sigma: Relative error of distances, as of a wrong wheel radius.
        turn_sigma: Relative error of turns, as of a wrong track.
        drift_sigma_radpm: Heading error per metre driven, as of unequal wheels.
    """

    scale_sigma: float = 0.02
    turn_sigma: float = 0.02
    drift_sigma_radpm: float = 0.02


class WheelOdometry:
    """Dead reckoning from wheel angles; its frame begins at the start pose of the robot."""

    def __init__(self, wheel_radius_m: float, track_m: float, spec: OdometrySpec, seed: int) -> None:
        rng = np.random.default_rng([seed, 2])
        scale, turn, drift = np.clip(rng.normal(size=3), -2.0, 2.0)
        self._metres_per_rad = wheel_radius_m * (1.0 + spec.scale_sigma * scale)
        self._turn_per_rad = wheel_radius_m / track_m * (1.0 + spec.turn_sigma * turn)
        self._drift_radpm = spec.drift_sigma_radpm * drift
        self._angles_rad = (0.0, 0.0)
        self._latest = Odometry(0, Pose2(0.0, 0.0, 0.0), Velocity(0.0, 0.0))

    @property
    def latest(self) -> Odometry:
        """The newest odometry."""
        return self._latest

    def update(self, angles_rad: tuple[float, float], stamp_ns: int) -> None:
        """Take the turned angles of the left and the right wheel, measured at ``stamp_ns``."""
        left, right = angles_rad[0] - self._angles_rad[0], angles_rad[1] - self._angles_rad[1]
        dt_s = (stamp_ns - self._latest.stamp_ns) * 1e-9
        distance = self._metres_per_rad * (left + right) / 2.0
        turn = self._turn_per_rad * (right - left) + self._drift_radpm * distance
        pose = self._latest.odom_from_robot
        middle = pose.yaw_rad + turn / 2.0
        moved = Pose2(
            pose.x_m + distance * math.cos(middle),
            pose.y_m + distance * math.sin(middle),
            wrap_angle(pose.yaw_rad + turn),
        )
        self._angles_rad = angles_rad
        self._latest = Odometry(stamp_ns, moved, Velocity(distance / dt_s, turn / dt_s))
