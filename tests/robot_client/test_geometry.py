from __future__ import annotations

import math

import numpy as np
import pytest

from revnm_client.geometry import Pose2, interpolate, wrap_angle

IDENTITY = Pose2(0.0, 0.0, 0.0)


def random_poses(count: int, seed: int = 7) -> list[Pose2]:
    rng = np.random.default_rng(seed)
    return [Pose2(*rng.uniform((-20, -20, -math.pi), (20, 20, math.pi))) for _ in range(count)]


def matrix(pose: Pose2) -> np.ndarray:
    """The same motion as a homogeneous matrix (3, 3), written independently."""
    c, s = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
    return np.array([[c, -s, pose.x_m], [s, c, pose.y_m], [0, 0, 1]])


def assert_same(a: Pose2, b: Pose2) -> None:
    np.testing.assert_allclose(matrix(a), matrix(b), atol=1e-9)


@pytest.mark.parametrize("turns", range(-3, 4))
@pytest.mark.parametrize("angle_rad", [-3.0, -0.1, 0.0, 1.0, 3.1, math.pi])
def test_wrapping_takes_off_whole_turns(angle_rad, turns):
    assert wrap_angle(angle_rad + turns * math.tau) == pytest.approx(angle_rad, abs=1e-12)


def test_wrapping_has_one_name_for_half_a_turn():
    assert wrap_angle(math.pi) == math.pi
    assert wrap_angle(-math.pi) == math.pi


def test_group_axioms():
    poses = random_poses(60)
    for a, b, c in zip(poses, poses[1:], poses[2:], strict=False):
        assert_same((a @ b) @ c, a @ (b @ c))
        assert_same(a @ IDENTITY, a)
        assert_same(IDENTITY @ a, a)
        assert_same(a @ a.inverse(), IDENTITY)
        assert_same(a.inverse() @ a, IDENTITY)
        assert_same((a @ b).inverse(), b.inverse() @ a.inverse())


def test_composition_is_the_product_of_matrices():
    for a, b in zip(random_poses(30, seed=1), random_poses(30, seed=2), strict=True):
        np.testing.assert_allclose(matrix(a @ b), matrix(a) @ matrix(b), atol=1e-9)
        assert -math.pi < (a @ b).yaw_rad <= math.pi


def test_points_move_as_with_matrices():
    rng = np.random.default_rng(3)
    points = rng.uniform(-5, 5, (4, 6, 2))
    homogeneous = np.concatenate([points, np.ones((4, 6, 1))], axis=-1)
    for pose in random_poses(20):
        expected = (homogeneous @ matrix(pose).T)[..., :2]
        np.testing.assert_allclose(pose.apply(points), expected, atol=1e-9)


def test_x_is_forward_and_y_is_left():
    # A robot at (1, 2) that looks along the world's y: what is 1 m ahead lies at (1, 3), 1 m left at (0, 2).
    world_from_robot = Pose2(1.0, 2.0, math.pi / 2)
    moved = world_from_robot.apply(np.array([[1.0, 0.0], [0.0, 1.0]]))
    np.testing.assert_allclose(moved, [[1.0, 3.0], [0.0, 2.0]], atol=1e-12)


def test_interpolation_turns_the_short_way():
    a, b = Pose2(0.0, 0.0, math.radians(170)), Pose2(2.0, -4.0, math.radians(-170))
    half = interpolate(a, b, 0.5)
    assert half[:2] == (1.0, -2.0)
    assert abs(half.yaw_rad) == pytest.approx(math.pi)
    quarter = interpolate(a, b, 0.25)
    assert math.degrees(quarter.yaw_rad) == pytest.approx(175.0)
    assert_same(interpolate(a, b, 0.0), a)
    assert_same(interpolate(a, b, 1.0), b)
