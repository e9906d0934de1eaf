"""Odometry in time, and plans carried along by it; the memory of what the LiDAR saw."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from revnm_client.geometry import Pose2
from revnm_client.messages import Mounting, Odometry, Plan, Scan, Velocity
from revnm_client.obstacle_memory import ObstacleMemory
from revnm_client.plan_tracking import OdometryBuffer, track, travelled

MS = 1_000_000
BEAMS = 360


def odometry(stamp_ms: int, x: float, *, yaw: float = 0.0, v: float = 0.5, w: float = 0.0) -> Odometry:
    return Odometry(stamp_ms * MS, Pose2(x, 0.0, yaw), Velocity(v, w))


def filled() -> OdometryBuffer:
    buffer = OdometryBuffer()
    for k in range(11):
        assert buffer.add(odometry(1000 + 50 * k, 0.025 * k))
    return buffer


def test_pose_is_interpolated_between_measurements() -> None:
    assert filled().at(1125 * MS) == pytest.approx((0.0625, 0.0, 0.0))


def test_pose_is_carried_on_for_100_ms_and_no_longer() -> None:
    buffer = filled()
    assert buffer.at(1600 * MS) == pytest.approx((0.30, 0.0, 0.0))
    assert buffer.at(1601 * MS) is None
    assert buffer.latest(1900 * MS) == pytest.approx((0.30, 0.0, 0.0))
    assert buffer.at(900 * MS) == pytest.approx((0.0, 0.0, 0.0))
    assert buffer.at(899 * MS) is None


def test_nothing_known_before_the_first_measurement() -> None:
    buffer = OdometryBuffer()
    assert buffer.at(0) is None
    assert buffer.latest(0) is None
    assert buffer.velocity == Velocity(0.0, 0.0)


def test_interpolation_turns_the_short_way() -> None:
    buffer = OdometryBuffer()
    buffer.add(odometry(0, 0.0, yaw=math.pi - 0.1))
    buffer.add(odometry(100, 0.0, yaw=-math.pi + 0.1))
    pose = buffer.at(50 * MS)
    assert pose is not None
    assert abs(pose.yaw_rad) == pytest.approx(math.pi)


def test_old_measurements_are_dropped_and_late_ones_ignored() -> None:
    buffer = OdometryBuffer()
    for k in range(200):
        buffer.add(odometry(50 * k, 0.01 * k))
    assert buffer.at(50 * 100 * MS) is None
    assert buffer.add(odometry(9500, 7.0))  # half a second late
    assert buffer.latest(9950 * MS) == pytest.approx((1.99, 0.0, 0.0))


@pytest.mark.parametrize("item", [odometry(1550, 5.0), odometry(100, 0.25), odometry(1550, 0.25, yaw=2.0)])
def test_a_jump_begins_anew(item: Odometry) -> None:
    buffer = filled()
    assert not buffer.add(item)
    assert buffer.at(1300 * MS) is None
    assert buffer.newest_ns == item.stamp_ns


def test_travelled_is_an_arc() -> None:
    # A quarter circle of radius 1 m: w = pi/2 rad/s, v = pi/2 m/s, for 1 s.
    assert travelled(Velocity(math.pi / 2, math.pi / 2), 1.0) == pytest.approx((1.0, 1.0, math.pi / 2))


def test_plan_stays_where_it_was_in_the_world() -> None:
    plan = Plan(0, np.array([[1.0, 0.0], [2.0, 0.0]]), 0, 1, "goal")
    tracked = track(plan, Pose2(3.0, 1.0, math.pi / 2), 0)
    # Captured at (3, 1) looking along y: waypoints at (3, 2) and (3, 3). Now at (3, 2) looking along x.
    now = tracked.path_m(Pose2(3.0, 2.0, 0.0))
    np.testing.assert_allclose(now, [[0.0, -1.0], [0.0, 0.0], [0.0, 1.0]], atol=1e-12)


def scan(ranges: np.ndarray, stamp_ms: int) -> Scan:
    return Scan(stamp_ms * MS, -math.pi, math.tau / BEAMS, 0.05, 10.0, ranges.astype(np.float32))


def with_beam(range_m: float, bearing_deg: int, spread: int = 3) -> np.ndarray:
    ranges = np.full(BEAMS, np.inf)
    ranges[BEAMS // 2 + bearing_deg - spread : BEAMS // 2 + bearing_deg + spread + 1] = range_m
    return ranges


def test_memory_moves_points_with_the_robot() -> None:
    memory = ObstacleMemory()
    memory.add(scan(with_beam(2.0, 0, spread=0), 0), Pose2(1.0, 0.0, 0.0))
    np.testing.assert_allclose(memory.points_m(Pose2(3.0, 1.0, 0.0)), [[0.0, -1.0]], atol=1e-6)


def test_what_is_gone_leaves_no_ghost() -> None:
    memory = ObstacleMemory()
    memory.add(scan(with_beam(1.0, 0), 0), Pose2(0.0, 0.0, 0.0))
    memory.add(scan(np.full(BEAMS, np.inf), 100), Pose2(0.0, 0.0, 0.0))
    assert len(memory.points_m(Pose2(0.0, 0.0, 0.0))) == 0


def test_what_is_hidden_is_remembered_for_two_seconds() -> None:
    memory = ObstacleMemory()
    here = Pose2(0.0, 0.0, 0.0)
    memory.add(scan(with_beam(2.0, 0, spread=1), 0), here)
    near = with_beam(0.5, 0, spread=5)
    memory.add(scan(near, 1900), here)
    assert len(memory.points_m(here)) == 11 + 3
    memory.add(scan(near, 2000), here)
    assert len(memory.points_m(here)) == 11


@pytest.mark.parametrize("blind", [0.0, np.nan])
def test_masked_beams_see_nothing(blind: float) -> None:
    memory = ObstacleMemory()
    here = Pose2(0.0, 0.0, 0.0)
    memory.add(scan(with_beam(1.0, 0), 0), here)
    memory.add(scan(with_beam(blind, 0), 100), here)
    assert len(memory.points_m(here)) == 7


def test_places_outside_a_half_scan_are_remembered() -> None:
    memory = ObstacleMemory()
    ranges = np.full(180, np.inf, dtype=np.float32)
    ranges[90] = 1.0  # straight ahead
    half = Scan(0, -math.pi / 2, math.pi / 180, 0.05, 10.0, ranges)
    memory.add(half, Pose2(0.0, 0.0, 0.0))
    empty = Scan(100 * MS, -math.pi / 2, math.pi / 180, 0.05, 10.0, np.full(180, np.inf, dtype=np.float32))
    memory.add(empty, Pose2(0.0, 0.0, math.pi))  # turned round: the point lies behind now
    np.testing.assert_allclose(memory.points_m(Pose2(0.0, 0.0, math.pi)), [[-1.0, 0.0]], atol=1e-6)


def test_beams_that_all_look_the_same_way_leave_the_rest_unseen() -> None:
    memory = ObstacleMemory()
    here = Pose2(0.0, 0.0, 0.0)
    memory.add(scan(with_beam(1.0, 90, spread=0), 0), here)
    needle = replace(scan(np.full(BEAMS, 5.0), 100), angle_increment_rad=1e-45)  # a turn is more steps than 2^63
    memory.add(needle, here)
    np.testing.assert_allclose(memory.points_m(here), [[0.0, 1.0]], atol=1e-6)


BACKWARDS = Pose2(0.2, 0.0, math.pi)  # a LiDAR on the nose that looks behind


def test_points_lie_where_the_lidar_sits() -> None:
    memory = ObstacleMemory()
    memory.add(replace(scan(with_beam(1.0, 0, spread=0), 0), robot_from_lidar=BACKWARDS), Pose2(5.0, 0.0, 0.0))
    np.testing.assert_allclose(memory.points_m(Pose2(5.0, 0.0, 0.0)), [[-0.8, 0.0]], atol=1e-6)


def test_zeros_may_mean_that_nothing_is_there() -> None:
    memory = ObstacleMemory()
    here = Pose2(0.0, 0.0, 0.0)
    memory.add(scan(with_beam(1.0, 0), 0), here)
    zeros = scan(np.zeros(BEAMS), 100)
    memory.add(Mounting().place(zeros), here)
    assert len(memory.points_m(here)) == 7  # it cannot see there
    memory.add(Mounting(zero_is_open=True).place(zeros), here)
    assert len(memory.points_m(here)) == 0


def test_what_hides_is_judged_from_where_the_lidar_sits() -> None:
    memory = ObstacleMemory()
    here = Pose2(0.0, 0.0, 0.0)
    memory.add(replace(scan(with_beam(2.0, 0, spread=0), 0), robot_from_lidar=BACKWARDS), here)
    hides = replace(scan(with_beam(0.5, 0), 100), robot_from_lidar=BACKWARDS)
    memory.add(hides, here)
    assert np.abs(memory.points_m(here) - [-1.8, 0.0]).max(axis=1).min() < 1e-6
    memory.add(
        replace(scan(with_beam(0.5, 180), 200), robot_from_lidar=BACKWARDS), here
    )  # the other side: seen through
    assert np.abs(memory.points_m(here) - [-1.8, 0.0]).max(axis=1).min() > 0.5
