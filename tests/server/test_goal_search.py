from __future__ import annotations

import math

import numpy as np
import pytest

from revnm_server.planning.goal_search import TRUSTED_M, GoalSearch

GOAL = np.array([4.0, 1.0])
HIDDEN_M = TRUSTED_M + 1.0
S = 1_000_000_000


def target(search: GoalSearch, robot_m, *, hidden_m: float = HIDDEN_M, at_s: float = 0.0, goal: str = "a"):
    return search.target_m(goal, GOAL, np.asarray(robot_m), hidden_m=hidden_m, stamp_ns=int(at_s * S))


def test_a_robot_on_its_way_is_led_to_the_goal():
    search = GoalSearch()
    np.testing.assert_array_equal(target(search, (0.0, 0.0)), GOAL)
    assert not search.searching


def test_a_robot_that_was_just_seen_is_where_its_odometry_has_it():
    search = GoalSearch()
    np.testing.assert_array_equal(target(search, GOAL, hidden_m=TRUSTED_M), GOAL)
    assert not search.searching


def test_a_robot_that_should_be_there_goes_round_in_growing_rings_and_then_gives_up():
    search, place, places = GoalSearch(), GOAL, []
    while (found := target(search, place)) is not None:
        place = found
        places.append(place)
        assert len(places) < 100
    rings = [round(math.dist(each, GOAL), 6) for each in places]
    assert search.searching
    assert rings == sorted(rings)
    assert rings[0] == pytest.approx(0.6)
    assert rings[-1] == pytest.approx(1.2)
    steps = np.hypot(*np.diff(places, axis=0).T)
    assert steps.max() < 1.0
    every_direction = np.sort([math.atan2(*(each - GOAL)[::-1]) for each in places])
    assert np.diff(every_direction).max() < 0.9
    assert target(search, GOAL) is None  # once all was tried it stays so


def test_a_place_that_cannot_be_reached_is_left_out():
    search = GoalSearch()
    first = target(search, GOAL)
    stuck = GOAL + 0.2 * (first - GOAL)
    np.testing.assert_array_equal(target(search, stuck, at_s=1.0), first)
    np.testing.assert_array_equal(target(search, stuck, at_s=8.5), first)
    assert not np.allclose(target(search, stuck, at_s=9.5), first)


def test_who_still_comes_nearer_is_not_stuck():
    search = GoalSearch()
    first = target(search, GOAL)
    for step in range(4):
        np.testing.assert_array_equal(target(search, GOAL + 0.1 * step * (first - GOAL), at_s=7.0 * step), first)


@pytest.mark.parametrize("change", [{"goal": "b", "robot_m": (0.0, 0.0)}, {"hidden_m": 0.1, "robot_m": (3.5, 1.0)}])
def test_a_new_goal_and_the_robot_s_sight_end_the_search(change):
    search = GoalSearch()
    target(search, GOAL)
    assert search.searching
    np.testing.assert_array_equal(target(search, **change), GOAL)
    assert not search.searching
