"""Critics against hand arithmetic."""

from __future__ import annotations

import math

import numpy as np
import pytest

from revnm_client.mppi.config import CriticWeights
from revnm_client.mppi.critics import align_cost, follow_cost, heading_cost, obstacle_cost, turning_cost
from revnm_client.mppi.rollout import Rollouts

WEIGHTS = CriticWeights(
    collision=1000.0,
    critical=20.0,
    critical_margin_m=0.1,
    repulsion=4.0,
    repulsion_margin_m=0.3,
    follow=10.0,
    align=10.0,
    heading=2.0,
    turning=0.5,
)


def rollouts(x: list[float], y: list[float], *, yaw: float = 0.0, w: float = 0.0) -> Rollouts:
    one = np.ones((1, len(x)), dtype=np.float32)
    position = [np.array([values], dtype=np.float32) for values in (x, y)]
    return Rollouts(
        one,
        np.float32(w) * one,
        position[0],
        position[1],
        np.float32(math.cos(yaw)) * one,
        np.float32(math.sin(yaw)) * one,
    )


def test_obstacle_adds_collision_critical_and_mean_repulsion() -> None:
    clear = np.array([[0.5, 0.5], [0.2, 0.5], [0.05, 0.3], [-0.05, 0.5]], dtype=np.float32)
    cost = obstacle_cost(clear, 0.4, WEIGHTS)
    # Repulsion is 4 / 2 steps per missing metre below 0.3, critical 20 per missing metre below 0.1:
    # 0; 2*0.1 = 0.2; 20*0.05 + 2*0.25 = 1.5; 1000 + 20*0.15 + 2*0.35 = 1003.7.
    np.testing.assert_allclose(cost, [0.0, 0.2, 1.5, 1003.7], rtol=1e-5)


def test_robot_that_is_too_near_collides_only_by_going_nearer() -> None:
    clear = np.array([[-0.05, 0.02], [-0.08, -0.1]], dtype=np.float32)
    cost = obstacle_cost(clear, -0.05, WEIGHTS)
    assert cost[0] < 100.0
    assert cost[1] > 1000.0


def test_follow_is_half_the_end_and_half_the_mean_distance() -> None:
    drive = rollouts([0.0, 1.0, 2.0], [0.0, 0.0, 0.0])
    # Distances to (2, 0): 2, 1, 0; end 0, mean 1: 5 * (0 + 1).
    assert follow_cost(drive, np.array([2.0, 0.0]), WEIGHTS)[0] == pytest.approx(5.0)
    # To (2, 4): sqrt(20), sqrt(17), 4.
    expected = 5.0 * (4.0 + (math.sqrt(20.0) + math.sqrt(17.0) + 4.0) / 3.0)
    assert follow_cost(drive, np.array([2.0, 4.0]), WEIGHTS)[0] == pytest.approx(expected)


def test_follow_stops_at_the_paths_end() -> None:
    drives = (rollouts(x, [0.0, 0.0, 0.0]) for x in ([0.5, 1.0, 1.0], [0.5, 1.0, 1.5], [0.3, 0.6, 0.9]))
    stops, overshoots, falls_short = (float(follow_cost(drive, np.array([1.0, 0.0]), WEIGHTS)[0]) for drive in drives)
    assert stops < min(overshoots, falls_short)


def test_align_is_the_mean_distance_of_every_third_step() -> None:
    drive = rollouts([9.0, 9.0, 0.5, 9.0, 9.0, 1.0], [9.0, 9.0, 0.2, 9.0, 9.0, 0.4])
    path = np.stack([np.linspace(0.0, 2.0, 21), np.zeros(21)], axis=1)
    assert align_cost(drive, path, WEIGHTS)[0] == pytest.approx(10.0 * (0.2 + 0.4) / 2.0, rel=1e-5)


@pytest.mark.parametrize("yaw", [0.0, 0.5, math.pi / 2.0, math.pi])
def test_heading_is_one_minus_cosine(yaw: float) -> None:
    drive = rollouts([0.0] * 3, [0.0] * 3, yaw=yaw)
    cost = heading_cost(drive, np.array([2.0, 0.0]), WEIGHTS)
    assert cost[0] == pytest.approx(2.0 * (1.0 - math.cos(yaw)), abs=1e-5)


def test_heading_counts_less_close_to_the_target() -> None:
    drive = rollouts([0.0] * 3, [0.0] * 3, yaw=math.pi / 2.0)
    # 0.03 m away: (0.03 - 0) / 0.3 = 0.1, twice.
    assert heading_cost(drive, np.array([0.03, 0.0]), WEIGHTS)[0] == pytest.approx(0.2, abs=1e-5)


def test_turning_is_the_mean_square() -> None:
    assert turning_cost(rollouts([0.0] * 4, [0.0] * 4, w=0.6), WEIGHTS)[0] == pytest.approx(0.5 * 0.36)
