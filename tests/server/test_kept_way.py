from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from revnm_client.geometry import Pose2
from revnm_server.mapping.floor_grid import FloorGrid
from revnm_server.planning.kept_way import KeepSettings
from revnm_server.planning.way import length_m

from .floor_scenes import floor, with_obstacles
from .planning import CLOSED_WALL, GOAL, HALF_S, START, TWO_GAPS, plan, planner, y_at


def blurred(boxes, rng: np.random.Generator, noise: float) -> FloorGrid:
    """Log-odds +4 in obstacles, −2.5 on floor, 0 on a cell's width about obstacles, all with noise."""
    stands = floor(12.0, 10.0, *boxes).obstacle > 0.5
    beside = np.zeros_like(stands)
    for axis, shift in ((0, 1), (0, -1), (1, 1), (1, -1)):
        beside |= np.roll(stands, shift, axis)
    odds = np.where(stands, 4.0, np.where(beside, 0.0, -2.5)) + rng.normal(0.0, noise, stands.shape)
    return with_obstacles(1.0 / (1.0 + np.exp(-odds)))


def nowhere(points_m):
    return points_m, np.zeros(len(points_m), dtype=np.bool_)


def sides(keep: KeepSettings) -> set[bool]:
    """On which sides of a wall's middle 50 replans pass, while the map flickers and the robot's place jitters."""
    rng, kept_by = np.random.default_rng(0), planner(keep=keep)
    passed = set()
    for at in range(50):
        pose = Pose2(2.0 + rng.normal(0.0, 0.03), 5.0 + rng.normal(0.0, 0.03), rng.normal(0.0, 0.02))
        passed.add(y_at(plan(kept_by, blurred(TWO_GAPS, rng, 1.0), pose, at=at), 6.1) > 5.0)
    return passed


def test_the_side_stays_while_the_map_flickers():
    assert len(sides(KeepSettings())) == 1
    fickle = KeepSettings(ratio=1.0, margin=0.0, patience=1, same_ratio=1.0)
    assert len(sides(fickle)) == 2  # so the scene is one in which a planner without memory flips


def test_a_clearly_cheaper_way_is_taken_when_it_stays_so():
    kept_by, one_gap = planner(), (TWO_GAPS[0], (6.0, 3.5, 6.2, 10.0))
    robot = Pose2(2.0, 7.0, 0.0)
    assert y_at(plan(kept_by, floor(12.0, 10.0, *one_gap), robot, at=0), 6.1) < 5.0
    both = floor(12.0, 10.0, *TWO_GAPS)
    assert y_at(plan(kept_by, both, robot, at=1), 6.1) < 5.0  # seen once
    assert y_at(plan(kept_by, both, robot, at=2), 6.1) > 5.0  # twice


def test_a_blocked_way_is_left_between_searches():
    kept_by = planner()
    before = plan(kept_by, floor(12.0, 10.0, *TWO_GAPS))
    low = y_at(before, 6.1) < 5.0
    gap = (6.0, 2.5, 6.2, 3.5) if low else (6.0, 6.5, 6.2, 7.5)
    after = kept_by.plan(floor(12.0, 10.0, *TWO_GAPS, gap), START, GOAL, goal_id="a", stamp_ns=1)
    assert (y_at(after, 6.1) < 5.0) != low


def test_a_new_goal_drops_the_way():
    kept_by, grid = planner(), floor(12.0, 10.0, *TWO_GAPS)
    robot = Pose2(2.0, 4.5, 0.0)
    assert y_at(plan(kept_by, grid, robot), 6.1) < 5.0
    moved = Pose2(2.0, 4.9, 0.0)
    assert y_at(plan(kept_by, grid, moved, (10.0, 5.6), name="b"), 6.1) > 5.0


def test_between_searches_the_kept_way_is_followed_and_its_end_follows_the_goal():
    kept_by, grid = planner(), floor(12.0, 10.0, *TWO_GAPS)
    first = plan(kept_by, grid)
    driven = Pose2(*first.way_m[20], 0.3)
    goal = GOAL + np.array([0.1, 0.2])
    later = kept_by.plan(grid, driven, goal, goal_id="a", stamp_ns=HALF_S - 1)
    middle = slice(10, -25)
    apart = np.hypot(*(later.way_m[middle, None] - first.way_m).transpose(2, 0, 1)).min(axis=1)
    assert apart.max() < 0.03
    np.testing.assert_allclose(later.way_m[-1], goal)
    assert length_m(later.way_m) == pytest.approx(length_m(first.way_m) - 1.0, abs=0.2)


def test_without_a_turn_a_way_that_is_due_waits_unless_it_is_blocked_or_there_is_none():
    kept_by, grid = planner(), floor(12.0, 10.0, *TWO_GAPS)
    first = kept_by.plan(grid, START, GOAL, goal_id="a", stamp_ns=0, has_turn=False)
    assert first.way_m is not None
    low = y_at(first, 6.1) < 5.0
    near = (5.0, 2.6, 5.6, 3.5) if low else (5.0, 6.5, 5.6, 7.4)  # not in the way, but in the gap's mouth
    dearer = floor(12.0, 10.0, *TWO_GAPS, near, p=0.9)
    waiting = kept_by.plan(dearer, START, GOAL, goal_id="a", stamp_ns=5 * HALF_S, has_turn=False)
    np.testing.assert_allclose(waiting.way_m, first.way_m, atol=1e-4)
    at_last = kept_by.plan(dearer, START, GOAL, goal_id="a", stamp_ns=5 * HALF_S, has_turn=True)
    assert at_last.cost < waiting.cost - 0.2
    blocked = floor(12.0, 10.0, *TWO_GAPS, (6.0, 2.5, 6.2, 3.5) if low else (6.0, 6.5, 6.2, 7.5))
    after = kept_by.plan(blocked, START, GOAL, goal_id="a", stamp_ns=6 * HALF_S, has_turn=False)
    assert (y_at(after, 6.1) < 5.0) != low


def test_between_searches_a_way_costs_what_it_costs_on_the_whole_map():
    """Only the floor about the way is looked at then; what stands beside it and far from it must tell the same."""
    beside, far = (4.0, 3.6, 4.4, 4.4), (11.5, 0.5, 11.8, 0.8)
    kept_by, grid = planner(), floor(12.0, 10.0, *TWO_GAPS, beside, far)
    first = plan(kept_by, grid)
    later = kept_by.plan(grid, START, GOAL, goal_id="a", stamp_ns=1)
    np.testing.assert_allclose(later.way_m, first.way_m, atol=1e-4)
    assert later.cost == pytest.approx(first.cost, abs=1e-3)
    assert first.cost > length_m(first.way_m) + 0.2


def test_the_side_stays_when_the_frame_changes():
    """A new calibration turns and stretches the map; the way past the wall is as long on the other side."""
    grid = floor(12.0, 10.0, *TWO_GAPS)
    kept_by, robot = planner(), Pose2(2.0, 5.1, 0.0)
    low = plan(kept_by, grid, Pose2(2.0, 4.9, 0.0))
    assert y_at(low, 6.1) < 5.0
    assert y_at(plan(planner(), grid, robot), 6.1) > 5.0  # who knows of no way goes the other one
    kept_by.carry(lambda points_m: (points_m * np.array([1.0, 1.02]), np.ones(len(points_m), dtype=np.bool_)))
    after = kept_by.plan(grid, robot, GOAL, goal_id="a", stamp_ns=1)
    assert y_at(after, 6.1) < 5.0
    np.testing.assert_allclose(after.way_m[-1], GOAL)


def test_a_way_that_does_not_lie_in_the_new_frame_is_dropped():
    grid, kept_by = floor(12.0, 10.0, *TWO_GAPS), planner()
    plan(kept_by, grid, Pose2(2.0, 4.9, 0.0))
    kept_by.carry(nowhere)
    assert y_at(kept_by.plan(grid, Pose2(2.0, 5.1, 0.0), GOAL, goal_id="a", stamp_ns=1), 6.1) > 5.0


def test_after_a_new_frame_the_way_is_looked_for_at_once():
    kept_by, robot = planner(), Pose2(5.0, 5.0, 0.0)
    opened = floor(12.0, 10.0, *TWO_GAPS)
    assert "shut" in plan(kept_by, floor(12.0, 10.0, *CLOSED_WALL), robot).reason
    assert "shut" in kept_by.plan(opened, robot, GOAL, goal_id="a", stamp_ns=1).reason
    kept_by.carry(lambda points_m: (points_m, np.ones(len(points_m), dtype=np.bool_)))
    assert kept_by.plan(opened, robot, GOAL, goal_id="a", stamp_ns=2).reason == ""


def test_a_robot_beside_its_way_is_led_back_smoothly():
    kept_by, grid = planner(), floor(12.0, 10.0)
    plan(kept_by, grid)
    result = kept_by.plan(grid, Pose2(3.0, 5.3, 0.0), GOAL, goal_id="a", stamp_ns=1)
    heading = np.arctan2(*np.diff(result.way_m, axis=0)[:, ::-1].T)
    assert abs(heading[0]) < 0.05  # along the way, not across
    assert heading.min() > -0.65
    # Over 3 · 0.3 m the way has come back to y = 5: in the robot's frame 0.3 m to the right.
    np.testing.assert_allclose(result.waypoints_m[2:, 1], -0.3, atol=0.01)


def test_a_robot_far_from_its_way_gets_a_new_one():
    kept_by, grid = planner(), floor(12.0, 10.0)
    plan(kept_by, grid)
    result = kept_by.plan(grid, Pose2(3.0, 7.0, 0.0), GOAL, goal_id="a", stamp_ns=1)
    assert length_m(result.way_m) == pytest.approx(math.hypot(7.0, 2.0), rel=0.01)


def test_a_dead_end_that_opens_is_replanned():
    kept_by, robot = planner(), Pose2(5.0, 5.0, 0.0)
    assert "shut" in plan(kept_by, floor(12.0, 10.0, *CLOSED_WALL), robot).reason
    assert "shut" in plan(kept_by, floor(12.0, 10.0, *CLOSED_WALL), robot, at=1).reason
    opened = plan(kept_by, floor(12.0, 10.0, *TWO_GAPS), robot, at=2)
    assert opened.reason == ""
    np.testing.assert_allclose(opened.way_m[-1], GOAL)


def test_a_grid_of_another_size_or_a_clock_that_runs_backwards_is_no_matter():
    kept_by = planner()
    plan(kept_by, floor(12.0, 10.0, *TWO_GAPS), at=5)
    larger = plan(kept_by, floor(13.0, 11.0, *TWO_GAPS), at=4)
    assert larger.reason == ""
    kept_by.carry(nowhere)
    assert plan(kept_by, replace(floor(12.0, 10.0), cell_m=0.1), at=0).cost == pytest.approx(8.0, rel=0.01)
