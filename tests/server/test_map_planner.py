from __future__ import annotations

import math

import numpy as np
import pytest

from revnm_client.geometry import Pose2
from revnm_server.planning.travel_cost import CostSettings
from revnm_server.planning.way import length_m

from .floor_scenes import floor, unseen
from .planning import CLOSED_WALL, GOAL, plan, planner, y_at


def test_waypoints_on_free_floor_by_hand():
    """The goal is 1.5 m straight ahead: waypoints at 0.4, 0.8 and 1.2 m, then the goal itself."""
    result = plan(planner(), floor(12.0, 10.0), Pose2(5.0, 5.0, math.pi), (3.5, 5.0))
    expected = [[0.4, 0.0], [0.8, 0.0], [1.2, 0.0], [1.5, 0.0], [1.5, 0.0]]
    np.testing.assert_allclose(result.waypoints_m, expected, atol=1e-6)
    np.testing.assert_allclose(result.way_m[[0, -1]], [[5.0, 5.0], [3.5, 5.0]], atol=1e-9)
    assert result.cost == pytest.approx(1.5)
    assert result.reason == ""


def test_turning_into_a_way_has_its_price():
    """0.6 m of floor for each radian: a quarter turn."""
    ahead, aside = (
        plan(planner(), floor(12.0, 10.0), Pose2(5.0, 5.0, yaw), (3.5, 5.0)) for yaw in (math.pi, math.pi / 2)
    )
    np.testing.assert_allclose(aside.waypoints_m[0], [0.0, 0.4], atol=1e-6)
    assert aside.cost - ahead.cost == pytest.approx(0.6 * math.pi / 2.0)


def test_a_robot_at_its_goal_stays():
    result = plan(planner(), floor(12.0, 10.0), Pose2(5.0, 5.0, 1.0), (5.0, 5.0))
    np.testing.assert_allclose(result.waypoints_m, np.zeros((5, 2)), atol=1e-9)


def test_unseen_floor_is_avoided_when_the_detour_is_short_and_crossed_when_it_is_long():
    # Across 2 m of unseen floor: 6 + 6 = 12. Round 1.2 m of it to each side: about 8.5. Round 4.8 m: over 12.
    short = plan(planner(), unseen(floor(12.0, 10.0), 5.0, 3.8, 7.0, 6.2))
    assert abs(y_at(short, 6.0) - 5.0) > 1.0
    assert short.cost == pytest.approx(length_m(short.way_m), rel=0.06)  # with turning into it
    long = plan(planner(), unseen(floor(12.0, 10.0), 5.0, 0.2, 7.0, 9.8))
    assert abs(y_at(long, 6.0) - 5.0) < 0.2
    assert long.cost == pytest.approx(12.0, rel=0.02)


def test_a_probable_obstacle_is_crossed_only_if_the_detour_is_long():
    perhaps = (5.8, 4.5, 6.2, 5.5)
    assert abs(y_at(plan(planner(), floor(12.0, 10.0, perhaps, p=0.6)), 6.0) - 5.0) > 0.5
    through = plan(planner(), floor(12.0, 10.0, *CLOSED_WALL, p=0.6))
    assert abs(y_at(through, 6.1) - 5.0) < 0.5
    assert through.reason == ""
    round_it = plan(planner(), floor(12.0, 10.0, (6.0, 1.5, 6.2, 10.0), p=0.8))
    assert y_at(round_it, 6.1) < 1.5


@pytest.mark.parametrize("x", [5.9, 5.97, 6.1])  # 0.15 m and 0.08 m before the nearest cell's middle, and in the wall
def test_a_robot_too_near_to_a_wall_gets_out(x: float):
    grid = floor(12.0, 10.0, *CLOSED_WALL)
    result = plan(planner(), grid, Pose2(x, 5.0, 0.0), (2.0, 5.0))
    assert result.reason == ""
    assert result.waypoints_m[0, 0] < -0.35  # straight back
    beside = plan(planner(), grid, Pose2(x, 5.0, 0.0), (5.9, 8.0))
    out = beside.way_m[:, 0] < 6.05 - 0.22
    assert np.argmax(out) * 0.05 < 0.5
    assert out[np.argmax(out) : -12].all()


def test_a_goal_beside_or_on_an_obstacle_is_approached():
    grid = floor(12.0, 10.0, *CLOSED_WALL)
    beside = plan(planner(), grid, goal=(5.85, 5.0))
    assert beside.reason == ""
    np.testing.assert_allclose(beside.way_m[-1], [5.85, 5.0])
    on_it = plan(planner(), grid, goal=(6.05, 5.0))
    assert "an obstacle stands on the goal" in on_it.reason
    assert 5.6 < on_it.way_m[-1, 0] < 5.85  # as near as the robot fits
    assert abs(on_it.way_m[-1, 1] - 5.0) < 0.1


def test_a_goal_that_is_shut_off_is_approached_as_far_as_it_helps():
    cell = ((9.0, 4.0, 11.0, 4.2), (9.0, 5.8, 11.0, 6.0), (9.0, 4.0, 9.2, 6.0), (10.8, 4.0, 11.0, 6.0))
    grid = floor(12.0, 10.0, *cell)
    result = plan(planner(), grid)
    assert "obstacles shut the goal off: the way ends 1.3 m before it" in result.reason
    assert np.hypot(*(result.way_m[-1] - GOAL)) < 1.5
    there = plan(planner(), grid, Pose2(*result.way_m[-1], 0.0))
    assert there.waypoints_m is None
    assert there.way_m is None
    assert there.cost == math.inf
    assert "obstacles shut the goal off, and the robot is as near as it can get" in there.reason


def test_a_gap_that_the_robot_cannot_pass_is_no_way():
    slit = floor(12.0, 10.0, (6.0, 0.0, 6.2, 4.9), (6.0, 5.1, 6.2, 10.0))
    assert "shut" in plan(planner(), slit).reason
    tight = floor(12.0, 10.0, (6.0, 0.0, 6.2, 4.8), (6.0, 5.2, 6.2, 10.0))
    assert plan(planner(), tight).reason == ""


def test_a_goal_outside_of_the_grid_is_approached_through_the_border():
    result = plan(planner(), floor(12.0, 10.0), goal=(15.0, 5.0))
    assert result.reason == ""
    np.testing.assert_allclose(result.way_m[-1], [15.0, 5.0])
    assert result.cost == pytest.approx(10.0 + 3.0 * 3.0, abs=0.2)  # 10 m inside, 3 m at the price of unseen floor
    outside = plan(planner(), floor(12.0, 10.0), Pose2(-1.0, 5.0, 0.0))
    np.testing.assert_allclose(outside.way_m[[0, -1]], [[-1.0, 5.0], GOAL])
    assert length_m(outside.way_m) == pytest.approx(11.0, rel=0.01)


def test_nothing_closes_farther_than_obstacles_are_known():
    with pytest.raises(ValueError, match="inflation_m"):
        planner(cost=CostSettings(inflation_m=0.15))
