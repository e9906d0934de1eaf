from __future__ import annotations

import math

import numpy as np
import pytest

from revnm_client.geometry import Pose2
from revnm_sim.sensors import Lidar, LidarSpec, OdometrySpec, WheelOdometry
from revnm_sim.world import Primitive, Shape, primitive_arrays

# A room of 6 m × 4 m around the origin.
WALLS = tuple(
    Primitive(Shape.BOX, centre, size, 0.0, (200, 200, 200))
    for centre, size in [
        ((3.05, 0.0, 1.0), (0.1, 4.2, 2.0)),
        ((-3.05, 0.0, 1.0), (0.1, 4.2, 2.0)),
        ((0.0, 2.05, 1.0), (6.2, 0.1, 2.0)),
        ((0.0, -2.05, 1.0), (6.2, 0.1, 2.0)),
    ]
)
RADIUS_M, TRACK_M = 0.05, 0.30
EXACT = OdometrySpec(0.0, 0.0, 0.0)


def test_scan_is_the_room_with_noise() -> None:
    spec = LidarSpec()
    pose = Pose2(0.5, -0.4, 0.7)
    scan = Lidar(primitive_arrays(WALLS), 0.2155, spec, seed=1).scan(pose, 42)
    assert (scan.stamp_ns, scan.ranges_m.shape, scan.ranges_m.dtype) == (42, (720,), np.float32)
    angles = scan.angle_min_rad + scan.angle_increment_rad * np.arange(720) + pose.yaw_rad
    with np.errstate(divide="ignore"):
        to_x = np.where(np.cos(angles) > 0, 3.0 - 0.5, -3.0 - 0.5) / np.cos(angles)
        to_y = np.where(np.sin(angles) > 0, 2.0 + 0.4, -2.0 + 0.4) / np.sin(angles)
    errors = scan.ranges_m - np.minimum(to_x, to_y)
    assert np.std(errors) == pytest.approx(spec.sigma_m, rel=0.15)
    assert abs(np.mean(errors)) < 0.003
    assert np.abs(pose.apply(scan.points_m())[:, 0]).max() < 3.1  # the points lie on the walls


def test_beam_without_a_return_is_infinite() -> None:
    scan = Lidar(primitive_arrays(WALLS[:1]), 0.2155, LidarSpec(), seed=1).scan(Pose2(0.0, 0.0, 0.0), 0)
    assert np.isinf(scan.ranges_m[0])  # straight back: nothing there
    assert scan.ranges_m[360] == pytest.approx(3.0, abs=0.1)  # straight ahead
    far = Lidar(primitive_arrays(WALLS[:1]), 0.2155, LidarSpec(range_max_m=2.0), seed=1)
    assert np.isinf(far.scan(Pose2(0.0, 0.0, 0.0), 0).ranges_m).all()


def test_lidar_noise_follows_the_seed() -> None:
    def ranges(seed: int) -> list[float]:
        lidar = Lidar(primitive_arrays(WALLS), 0.2155, LidarSpec(), seed)
        return lidar.scan(Pose2(0.0, 0.0, 0.0), 0).ranges_m.tolist()

    assert ranges(1) == ranges(1)
    assert ranges(1) != ranges(2)


def test_exact_odometry_follows_a_circle() -> None:
    # v = 0.5, w = 0.5: a circle of radius 1 about (0, 1); wheels at (v ∓ w · track / 2) / radius.
    odometry = WheelOdometry(RADIUS_M, TRACK_M, EXACT, seed=0)
    for step in range(1, 401):
        time_s = step * 0.01
        angles = ((0.5 - 0.075) / RADIUS_M * time_s, (0.5 + 0.075) / RADIUS_M * time_s)
        odometry.update(angles, step * 10_000_000)
    latest = odometry.latest
    assert latest.stamp_ns == 4_000_000_000
    assert latest.odom_from_robot == pytest.approx((math.sin(2.0), 1.0 - math.cos(2.0), 2.0), abs=1e-4)
    assert latest.velocity.v_mps == pytest.approx(0.5)
    assert latest.velocity.w_radps == pytest.approx(0.5)


def straight_drive(seed: int) -> Pose2:
    """Drive 5 m straight ahead with the errors of a seed."""
    odometry = WheelOdometry(RADIUS_M, TRACK_M, OdometrySpec(), seed)
    for step in range(1, 501):
        odometry.update((step * 0.01 / RADIUS_M,) * 2, step * 20_000_000)
    return odometry.latest.odom_from_robot


def test_odometry_drifts_by_a_few_percent() -> None:
    poses = [straight_drive(seed) for seed in range(200)]
    lengths = np.array([math.hypot(pose.x_m, pose.y_m) for pose in poses])
    headings = np.array([pose.yaw_rad for pose in poses])
    assert np.std(lengths / 5.0) == pytest.approx(0.02, rel=0.25)
    assert np.std(headings / 5.0) == pytest.approx(0.02, rel=0.25)
    assert np.abs(lengths / 5.0 - 1.0).max() < 0.05


def test_odometry_errors_follow_the_seed() -> None:
    assert straight_drive(3) == straight_drive(3)
    assert straight_drive(3) != straight_drive(4)
